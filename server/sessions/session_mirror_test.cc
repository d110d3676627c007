// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_mirror.h"

#include <gtest/gtest.h>

#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "server/runtime/errors.h"
#include "server/runtime/failing_allocations_testing.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

constexpr size_t kCapacity = 100;

std::vector<StoredPose> Poses(uint64_t first, uint64_t last) {
  std::vector<StoredPose> poses;
  for (uint64_t seq = first; seq <= last; ++seq) poses.push_back({.pose_seq = seq});
  return poses;
}

std::string Range(const std::vector<StoredPose>& poses) {
  return poses.empty() ? "" : absl::StrCat(poses.front().pose_seq, "-", poses.back().pose_seq);
}

// A fake of the stored state of a session that another server processes.
class OtherServer {
 public:
  OtherServer() {
    stored_.record.name = "sessions/a";
    stored_.info.config = SomeConfig();
    stored_.info.snapshot.state = SessionState::kAttached;
  }

  // `fails_after_read`: the first allocation after the next read, on the thread of the read, fails.
  void MakePoses(uint64_t first, uint64_t last, bool fails_after_read = false) {
    const std::lock_guard lock(mutex_);
    fails_after_read_ = fails_after_read;
    for (const StoredPose& pose : Poses(first, last)) stored_.poses.push_back(pose);
    stored_.info.snapshot.health.poses = last;
  }
  void ForgetPosesBefore(uint64_t seq) {
    const std::lock_guard lock(mutex_);
    std::erase_if(stored_.poses, [&](const StoredPose& pose) { return pose.pose_seq < seq; });
  }
  void End() {
    const std::lock_guard lock(mutex_);
    stored_.info.snapshot.state = SessionState::kEnded;
  }
  void LoseItems(uint64_t from_seq) {
    const std::lock_guard lock(mutex_);
    stored_.lifecycle.lost_from_seq = from_seq;
  }
  void SetError(const absl::Status& error) {
    const std::lock_guard lock(mutex_);
    error_ = error;
  }
  // Returns whole segments of ten poses, as the store does, so that some poses are repeated.
  absl::StatusOr<SessionFactory::Stored> Read(uint64_t after_pose_seq) {
    const std::lock_guard lock(mutex_);
    ++num_reads_;
    read_.notify_all();
    if (!error_.ok()) return error_;
    SessionFactory::Stored stored = stored_;
    std::erase_if(stored.poses,
                  [&](const StoredPose& pose) { return (pose.pose_seq + 9) / 10 * 10 <= after_pose_seq; });
    if (std::exchange(fails_after_read_, false)) ThisThreadsFailingAllocation().successes_before = 0;
    return stored;
  }
  // The second read starts only after the mirror has applied the result of the first one.
  void WaitForTwoReads() {
    std::unique_lock lock(mutex_);
    const int until = num_reads_ + 2;
    read_.wait(lock, [&] { return num_reads_ >= until; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable read_;
  int num_reads_ = 0;
  SessionFactory::Stored stored_;
  absl::Status error_;
  bool fails_after_read_ = false;
};

class SessionMirrorTest : public testing::Test {
 protected:
  ~SessionMirrorTest() override {
    mirror_.reset();
    pool_.Join();
  }
  void Start() {
    mirror_ = SessionMirror::Start(
        *other_.Read(0), [this](uint64_t after) { return other_.Read(after); }, kCapacity, absl::Milliseconds(1),
        pool_);
    mirror_->AddWatcher(listener_);
  }
  void WaitForPose(uint64_t seq) {
    listener_->WaitUntil([&] { return mirror_->Watch().last_pose_seq >= seq; });
  }
  void WaitForStatus() {
    listener_->WaitUntil([&] { return !mirror_->Watch().status.ok(); });
  }

  WorkerPool pool_{1};
  OtherServer other_;
  const std::shared_ptr<WaitingListener> listener_ = std::make_shared<WaitingListener>();
  std::shared_ptr<SessionMirror> mirror_;
};

TEST_F(SessionMirrorTest, ShowsStoredAndLaterPoses) {
  other_.MakePoses(1, 15);
  Start();
  EXPECT_EQ(Range(mirror_->ReadPoses(0, 100)), "1-15");
  EXPECT_EQ(mirror_->health().poses, 15u);
  other_.MakePoses(16, 40);
  WaitForPose(40);
  EXPECT_EQ(Range(mirror_->ReadPoses(15, 100)), "16-40");
  EXPECT_EQ(Range(mirror_->ReadPoses(15, 3)), "16-18");
  EXPECT_EQ(mirror_->health().poses, 40u);
  EXPECT_FALSE(mirror_->Watch().has_ended);
  other_.End();
  listener_->WaitUntil([&] { return mirror_->Watch().has_ended; });
  EXPECT_EQ(mirror_->Watch().status, absl::OkStatus());
}

TEST_F(SessionMirrorTest, ASessionWithoutPosesBeginsWithTheFirst) {
  Start();
  EXPECT_EQ(mirror_->Watch().last_pose_seq, 0u);
  other_.MakePoses(1, 1);
  WaitForPose(1);
  EXPECT_EQ(Range(mirror_->ReadPoses(0, 100)), "1-1");
}

TEST_F(SessionMirrorTest, ReadsGoOnAfterAFailedAllocation) {
  Start();
  other_.MakePoses(1, 15, /*fails_after_read=*/true);
  WaitForPose(15);
  EXPECT_EQ(Range(mirror_->ReadPoses(0, 100)), "1-15");
}

TEST_F(SessionMirrorTest, PosesDeletedBetweenReadsAreMissing) {
  other_.MakePoses(1, 20);
  other_.ForgetPosesBefore(11);
  Start();
  EXPECT_EQ(Range(mirror_->ReadPoses(0, 100)), "11-20");
  other_.SetError(absl::UnavailableError("the network"));
  other_.WaitForTwoReads();
  other_.MakePoses(21, 60);
  other_.ForgetPosesBefore(41);
  other_.SetError(absl::OkStatus());
  WaitForPose(60);
  EXPECT_EQ(Range(mirror_->ReadPoses(20, 100)), "41-60");
}

TEST_F(SessionMirrorTest, KeepsTheLastPosesOnly) {
  other_.MakePoses(1, 250);
  Start();
  EXPECT_EQ(Range(mirror_->ReadPoses(0, 1000)), "151-250");
  EXPECT_EQ(mirror_->max_poses_behind(), kCapacity);
}

TEST_F(SessionMirrorTest, AnUnreachableStoreChangesNothing) {
  other_.MakePoses(1, 5);
  Start();
  other_.SetError(absl::UnavailableError("the network"));
  other_.WaitForTwoReads();
  EXPECT_EQ(mirror_->Watch().status, absl::OkStatus());
  EXPECT_EQ(Range(mirror_->ReadPoses(0, 100)), "1-5");
  other_.MakePoses(6, 7);
  other_.SetError(absl::OkStatus());
  WaitForPose(7);
}

TEST_F(SessionMirrorTest, EndsWhenTheSessionIsDeleted) {
  Start();
  other_.SetError(SessionNotFound("sessions/a"));
  WaitForStatus();
  EXPECT_EQ(mirror_->Watch().status.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(GetErrorDetails(mirror_->Watch().status).reason, "SESSION_DELETED");
}

TEST_F(SessionMirrorTest, EndsWhenStoreAndClientHaveLostItems) {
  other_.MakePoses(1, 15);
  Start();
  other_.MakePoses(16, 20);
  other_.LoseItems(7);
  WaitForStatus();
  EXPECT_EQ(mirror_->Watch().status.code(), absl::StatusCode::kDataLoss);
  EXPECT_EQ(GetErrorDetails(mirror_->Watch().status).reason, "ROLLED_BACK");
  EXPECT_EQ(Range(mirror_->ReadPoses(0, 100)), "1-20");
}

TEST_F(SessionMirrorTest, EndsWhenTheSessionIsDamaged) {
  Start();
  other_.SetError(WithReason(absl::DataLossError("bad"), v1::SESSION_DAMAGED));
  WaitForStatus();
  EXPECT_EQ(GetErrorDetails(mirror_->Watch().status).reason, "SESSION_DAMAGED");
}

}  // namespace
}  // namespace evpose::server
