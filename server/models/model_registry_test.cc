// SPDX-License-Identifier: Apache-2.0
#include "server/models/model_registry.h"

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <functional>
#include <memory>
#include <thread>
#include <utility>

#include "core/models/cube_files_testing.h"
#include "evpose/storage/v1/model.pb.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/models/prepared_model.h"
#include "server/runtime/errors.h"
#include "server/runtime/slow_work_beside_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

// Counts the preparations; `next` replaces the result of the next one.
class CountingPreparer : public ModelPreparer {
 public:
  absl::StatusOr<std::string> Prepare(const std::vector<uint8_t>& file, ModelFormat format, const ModelOptions& options,
                                      const Cancellation& cancellation) const override {
    ++count;
    if (while_preparing) std::exchange(while_preparing, nullptr)();
    if (!next.ok()) return next;
    return MakeModelPreparer()->Prepare(file, format, options, cancellation);
  }
  mutable std::atomic<int> count = 0;
  mutable std::function<void()> while_preparing;  // for the next preparation
  absl::Status next;
};

class ModelRegistryTest : public testing::Test {
 protected:
  std::unique_ptr<ModelRegistry> Open() { return ModelRegistry::Create({.preparer = preparer_}, *store_).value(); }
  static std::shared_ptr<const std::vector<uint8_t>> CubeFile() {
    const std::string obj = Cube();
    return std::make_shared<const std::vector<uint8_t>>(obj.begin(), obj.end());
  }

  // Stores a model that another version has prepared. Returns its name.
  std::string StoreOutdated() {
    ModelRecord record = store_->ReadModel("lab", Open()->Upload("lab", {}, "", CubeFile())->name).value();
    record.summary.clear();
    record.prepared.clear();
    EXPECT_TRUE(store_->PutModel(record).ok());
    return record.name;
  }

  const std::shared_ptr<CountingPreparer> preparer_ = std::make_shared<CountingPreparer>();
  const std::unique_ptr<Store> store_ = MakeMemoryStore();
};

TEST_F(ModelRegistryTest, AStartLoadsNothingAndAUsePreparesNothingAgain) {
  const ModelInfo uploaded = Open()->Upload("lab", {}, "", CubeFile()).value();
  EXPECT_EQ(preparer_->count, 1);
  const auto restarted = Open();
  const ModelInfo info = restarted->Get("lab", uploaded.name).value();
  EXPECT_EQ(info.num_faces, 12u);
  EXPECT_EQ(info.num_lines, 12u);
  EXPECT_EQ(info.num_symmetries, 24u);
  EXPECT_EQ(info.diameter_m, uploaded.diameter_m);
  EXPECT_EQ(info.sha256_hex, uploaded.sha256_hex);
  EXPECT_EQ(info.size_bytes, CubeFile()->size());
  EXPECT_EQ(restarted->Use("lab", uploaded.name)->model, nullptr) << "it is loaded when a session uses it";
  EXPECT_TRUE(restarted->Outdated().empty());
  const ModelUse use = restarted->UseStored("lab", uploaded.name).value();
  EXPECT_EQ(use.model->lines.size(), 12u);
  EXPECT_EQ(restarted->UseStored("lab", uploaded.name)->model, use.model) << "sessions share it";
  EXPECT_EQ(restarted->Upload("lab", {}, "", CubeFile())->name, uploaded.name);
  EXPECT_EQ(preparer_->count, 1);
}

TEST_F(ModelRegistryTest, AModelKeepsTheNameOfItsFirstFile) {
  const ModelInfo uploaded = Open()->Upload("lab", {}, "", CubeFile(), Cancellation(), "cube.obj").value();
  EXPECT_EQ(uploaded.file_name, "cube.obj");
  const auto restarted = Open();
  EXPECT_EQ(restarted->Upload("lab", {}, "", CubeFile(), Cancellation(), "copy.obj")->file_name, "cube.obj");
  // The name is kept when another version prepares the model again.
  ModelRecord record = store_->ReadModel("lab", uploaded.name).value();
  storage::v1::ModelSummary summary;
  ASSERT_TRUE(summary.ParseFromString(record.summary));
  summary.set_version(summary.version() - 1);
  record.summary = summary.SerializeAsString();
  ASSERT_TRUE(store_->PutModel(record).ok());
  const auto later = Open();
  EXPECT_EQ(later->Get("lab", uploaded.name)->file_name, "cube.obj");
  ASSERT_TRUE(later->UseStored("lab", uploaded.name).ok());
  EXPECT_EQ(later->Get("lab", uploaded.name)->file_name, "cube.obj");
  EXPECT_EQ(later->Get("lab", uploaded.name)->num_lines, 12u);
}

TEST_F(ModelRegistryTest, TheStoreIsFullOfFilesAndOfWhatWasDerivedFromThem) {
  const ModelInfo cube = Open()->Upload("lab", {}, "", CubeFile()).value();
  const uint64_t prepared_bytes = store_->ReadModel("lab", cube.name)->prepared.size();
  ModelReading other;
  other.metres_per_unit = 2.0;
  const auto upload = [&](uint64_t max_store_bytes) {
    ModelRegistry::Options options = {.preparer = preparer_};
    options.limits.max_store_bytes = max_store_bytes;
    return ModelRegistry::Create(options, *store_).value()->Upload("lab", other, "", CubeFile()).status();
  };
  const uint64_t taken = cube.size_bytes + prepared_bytes;
  EXPECT_EQ(GetErrorDetails(upload(taken + prepared_bytes / 2)).reason, "MODEL_STORE_FULL");
  EXPECT_EQ(store_->ListModels()->size(), 1u) << "a refused model is not stored";
  EXPECT_TRUE(upload(taken + 2 * prepared_bytes).ok());
}

TEST_F(ModelRegistryTest, NamesOfSmoothModelsAreThoseOfEarlierServers) {
  const std::vector<uint8_t> bytes = {'x'};
  EXPECT_EQ(ModelName({}, bytes), "models/68cbc6bc67a5a4bce92c4500e25f24f06c31c2ed11d5856d130aba57502a9e1b");
  EXPECT_NE(ModelName({.is_smooth = false}, bytes), ModelName({}, bytes));
}

TEST_F(ModelRegistryTest, AModelIsReleasedWithItsLastSession) {
  const auto models = Open();
  const std::string name = models->Upload("lab", {}, "", CubeFile()).value().name;
  EXPECT_NE(models->UseStored("lab", name)->model, nullptr);
  EXPECT_EQ(models->Use("lab", name)->model, nullptr);
  EXPECT_TRUE(models->Delete("lab", name).ok());
}

TEST_F(ModelRegistryTest, AModelOfAnotherVersionIsPreparedOnceMore) {
  const std::string name = StoreOutdated();
  const auto restarted = Open();
  EXPECT_THAT(restarted->Outdated(), testing::ElementsAre(std::pair(std::string("lab"), name)));
  EXPECT_EQ(restarted->Get("lab", name)->size_bytes, CubeFile()->size());
  EXPECT_EQ(restarted->UseStored("lab", name)->model->symmetries.size(), 24u);
  EXPECT_EQ(restarted->Get("lab", name)->num_symmetries, 24u);
  EXPECT_TRUE(restarted->Outdated().empty());
  EXPECT_EQ(preparer_->count, 2);
  EXPECT_TRUE(Open()->UseStored("lab", name).ok());
  EXPECT_EQ(preparer_->count, 2) << "the store has the new result";
}

TEST_F(ModelRegistryTest, WhileASessionWaitsForAPreparationItemsOfOtherTenantsBegin) {
  const std::string name = StoreOutdated();
  const auto registry = Open();
  boost::asio::io_context threads;
  SlowExecutor slow(threads.get_executor(), {.running = 1, .long_items = 1});
  bool has_other_run = false, has_run_meanwhile = false;
  slow.Post("lab", [&](const absl::Status&) {
    slow.Post("other", [&](const absl::Status&) { has_other_run = true; });
    preparer_->while_preparing = [&] {
      threads.poll_one();  // as another thread would
      has_run_meanwhile = has_other_run;
    };
    EXPECT_TRUE(registry->UseStored("lab", name).ok());
  });
  threads.run();
  EXPECT_TRUE(has_run_meanwhile);
}

TEST_F(ModelRegistryTest, SessionsThatBeginAtTheSameTimeLoadTheirModelOnce) {
  const std::string name = StoreOutdated();
  const auto registry = Open();
  absl::StatusOr<ModelUse> second;
  SlowWorkBeside other;
  preparer_->count = 0;
  preparer_->while_preparing = [&] { other.BeginUntilItWaits([&] { second = registry->UseStored("lab", name); }); };
  const auto first = registry->UseStored("lab", name);
  other.Join();
  EXPECT_EQ(second->model, first->model);
  EXPECT_EQ(preparer_->count, 1);
}

TEST_F(ModelRegistryTest, ASessionThatWaitedForItsModelEndsWithItsCall) {
  const std::string name = StoreOutdated();
  const auto registry = Open();
  absl::Status waited;
  SlowWorkBeside other;
  const auto cancellation = std::make_shared<Cancellation>();
  preparer_->while_preparing = [&] {
    other.BeginUntilItWaits([&] { waited = registry->UseStored("lab", name).status(); }, cancellation);
    cancellation->Cancel();
  };
  EXPECT_TRUE(registry->UseStored("lab", name).ok());
  other.Join();
  EXPECT_TRUE(absl::IsCancelled(waited)) << waited;
}

TEST_F(ModelRegistryTest, AFailedPreparationLeavesNothing) {
  const auto models = Open();
  preparer_->next = absl::CancelledError("the call was cancelled");
  EXPECT_TRUE(absl::IsCancelled(models->Upload("lab", {}, "", CubeFile()).status()));
  preparer_->next = WithReason(absl::InvalidArgumentError("too expensive"), v1::MODEL_TOO_EXPENSIVE);
  EXPECT_EQ(GetErrorDetails(models->Upload("lab", {}, "", CubeFile()).status()).reason, "MODEL_TOO_EXPENSIVE");
  EXPECT_TRUE(models->List("lab", "", 10).empty());
  EXPECT_TRUE(store_->ListModels()->empty());
  preparer_->next = absl::OkStatus();
  EXPECT_TRUE(models->Upload("lab", {}, "", CubeFile()).ok());
}

TEST_F(ModelRegistryTest, TheCallAndTheEndOfTheServerEndPreparationsForSessions) {
  const std::string name = ModelName({}, *CubeFile());
  ASSERT_TRUE(store_->PutModel({.name = name, .tenant = "lab", .bytes = CubeFile()}).ok());
  const auto models = Open();
  boost::asio::io_context threads;
  SlowExecutor slow(threads.get_executor(), {.running = 1});
  const auto use = [&](const std::shared_ptr<Cancellation>& cancellation, const std::function<void()>& meanwhile) {
    absl::Status used;
    slow.Post(
        "lab",
        [&](const absl::Status&) {
          meanwhile();
          used = models->UseStored("lab", name).status();
        },
        cancellation);
    threads.restart();
    threads.run();
    return used;
  };
  const auto cancellation = std::make_shared<Cancellation>();
  EXPECT_TRUE(absl::IsCancelled(use(cancellation, [&] { cancellation->Cancel(); })));
  EXPECT_EQ(GetErrorDetails(use(std::make_shared<Cancellation>(), [&] { slow.Stop(); })).reason, "DRAINING");
}

}  // namespace
}  // namespace evpose::server
