// SPDX-License-Identifier: Apache-2.0
#include "server/models/outdated_models.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "core/models/cube_files_testing.h"
#include "server/runtime/worker_pool.h"
#include "server/stores/memory/memory_store.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

TEST(PreparationProgressTest, IsReportedAtABoundedRateAndAtTheEnd) {
  std::chrono::steady_clock::time_point now{};
  PreparationProgress progress(5, [&now] { return now; });
  const auto record_after = [&](int seconds) {
    now += std::chrono::seconds(seconds);
    const auto report = progress.RecordDone();
    return report.has_value() ? std::pair(report->done, report->left) : std::pair<size_t, size_t>();
  };
  const std::pair<size_t, size_t> nothing;
  EXPECT_EQ(record_after(9), nothing);
  EXPECT_EQ(record_after(1), std::pair(size_t{2}, size_t{3}));
  EXPECT_EQ(record_after(9), nothing);
  EXPECT_EQ(record_after(9), std::pair(size_t{4}, size_t{1}));
  EXPECT_EQ(record_after(0), std::pair(size_t{5}, size_t{0})) << "the end";
}

class OutdatedModelsTest : public testing::Test {
 protected:
  std::unique_ptr<ModelRegistry> Open() {
    return ModelRegistry::Create({.preparer = MakeModelPreparer()}, *store_).value();
  }
  // Returns the lines of a start.
  std::string Start() {
    const auto models = Open();
    captured_log.Take();
    WorkerPool pool(1);
    PrepareOutdatedModels(*models, pool.preparations());
    pool.Join();
    EXPECT_TRUE(models->Outdated().empty());
    return captured_log.Take();
  }

  const std::unique_ptr<Store> store_ = MakeMemoryStore();
};

TEST_F(OutdatedModelsTest, AreReportedInTheLog) {
  const std::string obj = Cube();
  const auto file = std::make_shared<const std::vector<uint8_t>>(obj.begin(), obj.end());
  const std::string name = Open()->Upload("lab", {}, "", file).value().name;
  EXPECT_EQ(Start(), "") << "without outdated models";
  ModelRecord record = store_->ReadModel("lab", name).value();
  record.summary.clear();
  record.prepared.clear();
  ASSERT_TRUE(store_->PutModel(record).ok());
  EXPECT_EQ(Start(), "info models_outdated models=1\ninfo models_prepared done=1 left=0\n");
}

}  // namespace
}  // namespace evpose::server
