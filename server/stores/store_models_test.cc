// SPDX-License-Identifier: Apache-2.0

// The tests, for every kind of store, of models and large records.
#include <gtest/gtest.h>

#include <string>

#include "server/stores/common/store.h"
#include "server/stores/store_fixtures_testing.h"

namespace evpose::server {
namespace {

using absl::StatusCode;

class StoreModelsSuite : public StoreSuite {
 protected:
  bool Has(const std::string& tenant, const std::string& name) { return store_->HasModel(tenant, name).value(); }
};

INSTANTIATE_TEST_SUITE_P(Stores, StoreModelsSuite, kTestedStores, NameOfTestedStore);

TEST_P(StoreModelsSuite, KeepsModelsOfTenantsApart) {
  ASSERT_TRUE(store_->PutModel(Model("models/b", "", "b of none")).ok());
  ASSERT_TRUE(store_->PutModel(Model("models/b", "tenant", "b of tenant")).ok());
  ASSERT_TRUE(store_->PutModel(Model("models/a", "tenant", std::string("a\0a", 3))).ok());
  ASSERT_TRUE(store_->PutModel(Model("models/b", "", "another")).ok()) << "replaces the model";
  if (fixture_->keeps()) Reopen();
  const auto models = store_->ListModels().value();
  ASSERT_EQ(models.size(), 3u);
  EXPECT_EQ(models[0].name, "models/a");
  EXPECT_EQ(std::pair(models[1].tenant, models[1].summary), std::pair(std::string(), std::string("summary")));
  EXPECT_EQ(models[2].tenant, "tenant");
  EXPECT_TRUE(models[1].file_bytes == 7 && models[1].bytes == nullptr) << "a list does not read the files";
  const ModelRecord model = store_->ReadModel("", "models/b").value();
  EXPECT_EQ(std::string(model.bytes->begin(), model.bytes->end()) + model.prepared,
            std::string("another\0prepared", 16));
  EXPECT_EQ(model.reading, Model("", "", "").reading);
  EXPECT_EQ(model.create_time, Model("", "", "").create_time);
  EXPECT_EQ(store_->ReadModel("tenant", "models/a")->bytes->size(), 3u);
  EXPECT_EQ(store_->ReadModel("", "models/a").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(Has("", "models/b"), true);
  EXPECT_EQ(Has("tenant", "models/b"), true);
  EXPECT_EQ(Has("", "models/a"), false);
  EXPECT_TRUE(store_->DeleteModel("tenant", "models/b").ok());
  EXPECT_TRUE(store_->DeleteModel("tenant", "models/b").ok());
  EXPECT_EQ(store_->ReadModel("tenant", "models/b").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(Has("tenant", "models/b"), false);
  EXPECT_TRUE(store_->ReadModel("", "models/b").ok());
  EXPECT_EQ(Has("", "models/b"), true);
}

TEST_P(StoreModelsSuite, KeepsLargeBytesWhole) {
  const std::string file = Noise(64u << 20, 1);
  ASSERT_EQ(store_->PutModel(Model("models/large", "", file)), absl::OkStatus());
  auto lease = store_->CreateSession(Record("sessions/a"), "").value();
  for (uint64_t i = 1; i <= 5; ++i) {
    ASSERT_TRUE(CommitNow(*lease, {.checkpoint = Noise((5u << 20) + i, i),
                                   .poses = {{.first_pose_seq = i, .last_pose_seq = i, .bytes = Noise(1u << 20, i)}}})
                    .ok());
  }
  if (fixture_->keeps()) Reopen();
  const StoredSession session = store_->ReadSession("sessions/a").value();
  EXPECT_TRUE(session.checkpoint == Noise((5u << 20) + 5, 5));
  ASSERT_EQ(session.poses.size(), 5u);
  EXPECT_TRUE(session.poses[2].bytes == Noise(1u << 20, 3));
  const ModelRecord model = store_->ReadModel("", "models/large").value();
  EXPECT_TRUE(std::string(model.bytes->begin(), model.bytes->end()) == file);
}

}  // namespace
}  // namespace evpose::server
