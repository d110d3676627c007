// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_factory.h"

#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "server/runtime/errors.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

class CountingStore : public FaultInjectingStore {
 public:
  CountingStore() : FaultInjectingStore(MakeMemoryStore(), std::make_shared<InjectedFault>()) {}
  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    ++num_read;
    return FaultInjectingStore::ReadModel(tenant, name);
  }
  mutable int num_read = 0;
};

TEST(SessionFactoryTest, NoMoreModelsAreLoadedThanFitIntoTheMemory) {
  CountingStore store;
  SessionConfig config;
  {
    const auto uploads = ModelRegistry::Create({}, store).value();
    for (int i = 0; i < 16; ++i) {
      const std::string file = absl::StrCat(kCubeObj, "# ", i, "\n");
      const auto bytes = std::make_shared<const std::vector<uint8_t>>(file.begin(), file.end());
      const std::string model = uploads->Upload("lab", {}, "", bytes).value().name;
      if (i == 0) config = SomeConfig({"object0"}, model);
      if (i > 0) config.objects.push_back({.object_id = absl::StrCat("object", i), .model = model});
    }
  }
  // A server that has not loaded any of them.
  const auto models = ModelRegistry::Create({}, store).value();
  const uint64_t one_bytes =
      MemoryOfModels({models->UseStored("lab", config.objects[0].model).value().model}).front().bytes;
  ASSERT_GT(one_bytes, 0u);
  store.num_read = 0;
  WorkerPool pool(1);
  const auto memory = MemoryBudget::Create({.max_bytes = 2 * one_bytes + one_bytes / 2});
  const SessionFactory factory({.make_tracker = FakeTrackers(), .memory = memory}, store, *models, pool);
  const absl::Status refused = factory.MakeNew("lab", config, "").status();
  EXPECT_EQ(GetErrorDetails(refused).reason, "SESSION_MEMORY") << refused;
  EXPECT_EQ(store.num_read, 3) << "the third one does not fit";
  EXPECT_EQ(memory->charged_bytes(), 0u);
  pool.Join();
}

}  // namespace
}  // namespace evpose::server
