#include "server/stores/memory_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::server {
namespace {

std::vector<StoredPose> Poses(uint64_t first, uint64_t last) {
  std::vector<StoredPose> poses;
  for (uint64_t seq = first; seq <= last; ++seq) {
    StoredPose pose;
    pose.pose_seq = seq;
    pose.estimate.t_us = static_cast<int64_t>(1000 * seq);
    poses.push_back(pose);
  }
  return poses;
}

std::vector<uint64_t> Numbers(const absl::StatusOr<std::vector<StoredPose>>& poses) {
  std::vector<uint64_t> numbers;
  for (const StoredPose& pose : poses.value()) numbers.push_back(pose.pose_seq);
  return numbers;
}

TEST(MemoryPoseLogTest, GivesPosesAfterANumberInPages) {
  const auto store = MakeMemoryStore(100);
  const auto log = store->CreatePoseLog("sessions/a").value();
  EXPECT_EQ(log->first_pose_seq(), 1u);
  EXPECT_TRUE(log->Read(0, 10)->empty());
  ASSERT_TRUE(log->Append(Poses(1, 3)).ok());
  ASSERT_TRUE(log->Append(Poses(4, 5)).ok());
  EXPECT_THAT(Numbers(log->Read(0, 2)), testing::ElementsAre(1, 2));
  EXPECT_THAT(Numbers(log->Read(2, 10)), testing::ElementsAre(3, 4, 5));
  EXPECT_TRUE(log->Read(5, 10)->empty());
  EXPECT_TRUE(log->Read(99, 10)->empty());
  EXPECT_EQ(log->Read(3, 1)->front().estimate.t_us, 4000);
}

TEST(MemoryPoseLogTest, ForgetsTheOldestBeyondItsCapacity) {
  const auto store = MakeMemoryStore(3);
  const auto log = store->CreatePoseLog("sessions/a").value();
  ASSERT_TRUE(log->Append(Poses(1, 5)).ok());
  EXPECT_EQ(log->first_pose_seq(), 3u);
  EXPECT_THAT(Numbers(log->Read(0, 10)), testing::ElementsAre(3, 4, 5));
  EXPECT_THAT(Numbers(log->Read(4, 10)), testing::ElementsAre(5));
}

TEST(MemoryPoseLogTest, RefusesAGapAndARepetition) {
  const auto store = MakeMemoryStore(3);
  const auto log = store->CreatePoseLog("sessions/a").value();
  ASSERT_TRUE(log->Append(Poses(1, 2)).ok());
  EXPECT_EQ(log->Append(Poses(4, 4)).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(log->Append(Poses(2, 2)).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(Numbers(log->Read(0, 10)), testing::ElementsAre(1, 2));
}

TEST(MemoryStoreTest, LogsBelongToSessions) {
  const auto store = MakeMemoryStore(3);
  const auto log = store->CreatePoseLog("sessions/a").value();
  EXPECT_EQ(store->CreatePoseLog("sessions/a").status().code(), absl::StatusCode::kAlreadyExists);
  EXPECT_TRUE(store->CreatePoseLog("sessions/b").ok());
  ASSERT_TRUE(log->Append(Poses(1, 1)).ok());
  EXPECT_TRUE(store->DeletePoseLog("sessions/a").ok());
  EXPECT_TRUE(store->DeletePoseLog("sessions/a").ok());
  EXPECT_EQ(log->Read(0, 10)->size(), 1u) << "who holds the log may read on";
  EXPECT_TRUE(store->CreatePoseLog("sessions/a").value()->Read(0, 10)->empty());
}

TEST(MemoryStoreTest, KeepsModelsByName) {
  const auto store = MakeMemoryStore(3);
  ModelRecord model;
  model.name = "models/b";
  model.metres_per_unit = 0.001;
  ASSERT_TRUE(store->PutModel(model).ok());
  model.metres_per_unit = 1.0;
  ASSERT_TRUE(store->PutModel(model).ok());
  model.name = "models/a";
  ASSERT_TRUE(store->PutModel(model).ok());
  const auto models = store->ReadModels().value();
  ASSERT_EQ(models.size(), 2u);
  EXPECT_EQ(models[0].name, "models/a");
  EXPECT_EQ(models[1].metres_per_unit, 0.001) << "putting a name again changes nothing";
  EXPECT_TRUE(store->DeleteModel("models/b").ok());
  EXPECT_TRUE(store->DeleteModel("models/b").ok());
  EXPECT_EQ(store->ReadModels()->size(), 1u);
}

}  // namespace
}  // namespace evpose::server
