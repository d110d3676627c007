#include "server/stores/memory_store.h"

#include <algorithm>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"

namespace evpose::server {
namespace {

class MemoryPoseLog : public PoseLog {
 public:
  explicit MemoryPoseLog(size_t capacity) : capacity_(capacity) {}
  // The last reader may let go on a thread of gRPC: the lock shows to tools that the others are done.
  ~MemoryPoseLog() override { const std::lock_guard lock(mutex_); }

  absl::Status Append(absl::Span<const StoredPose> poses) override {
    const std::lock_guard lock(mutex_);
    for (const StoredPose& pose : poses) {
      if (pose.pose_seq != next_seq_) {
        return absl::FailedPreconditionError(
            absl::StrCat("pose ", pose.pose_seq, " does not continue the log, which expects ", next_seq_));
      }
      poses_.push_back(pose);
      ++next_seq_;
      if (poses_.size() > capacity_) poses_.pop_front();
    }
    return absl::OkStatus();
  }

  absl::StatusOr<std::vector<StoredPose>> Read(uint64_t after_pose_seq, size_t max_poses) const override {
    const std::lock_guard lock(mutex_);
    if (after_pose_seq >= next_seq_ - 1) return std::vector<StoredPose>();
    const uint64_t first = std::max(after_pose_seq + 1, FirstSeq());
    const auto begin = poses_.begin() + static_cast<ptrdiff_t>(first - FirstSeq());
    const size_t count = std::min<size_t>(max_poses, next_seq_ - first);
    return std::vector<StoredPose>(begin, begin + static_cast<ptrdiff_t>(count));
  }

  uint64_t first_pose_seq() const override {
    const std::lock_guard lock(mutex_);
    return FirstSeq();
  }

 private:
  uint64_t FirstSeq() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { return next_seq_ - poses_.size(); }

  const size_t capacity_;
  mutable std::mutex mutex_;
  uint64_t next_seq_ ABSL_GUARDED_BY(mutex_) = 1;
  std::deque<StoredPose> poses_ ABSL_GUARDED_BY(mutex_);
};

class MemoryStore : public Store {
 public:
  explicit MemoryStore(size_t pose_log_capacity) : pose_log_capacity_(pose_log_capacity) {}

  absl::string_view kind() const override { return "memory"; }
  size_t pose_log_capacity() const override { return pose_log_capacity_; }

  absl::StatusOr<std::vector<ModelRecord>> ReadModels() const override {
    const std::lock_guard lock(mutex_);
    std::vector<ModelRecord> models;
    models.reserve(models_.size());
    for (const auto& [name, model] : models_) models.push_back(model);
    return models;
  }

  absl::Status PutModel(const ModelRecord& model) override {
    const std::lock_guard lock(mutex_);
    models_.emplace(model.name, model);
    return absl::OkStatus();
  }

  absl::Status DeleteModel(absl::string_view name) override {
    const std::lock_guard lock(mutex_);
    if (const auto found = models_.find(name); found != models_.end()) models_.erase(found);
    return absl::OkStatus();
  }

  absl::StatusOr<std::shared_ptr<PoseLog>> CreatePoseLog(const std::string& session) override {
    const std::lock_guard lock(mutex_);
    const auto [log, inserted] = logs_.try_emplace(session);
    if (!inserted) return absl::AlreadyExistsError(absl::StrCat("poses of ", session, " are stored already"));
    log->second = std::make_shared<MemoryPoseLog>(pose_log_capacity_);
    return log->second;
  }

  absl::Status DeletePoseLog(absl::string_view session) override {
    const std::lock_guard lock(mutex_);
    if (const auto found = logs_.find(session); found != logs_.end()) logs_.erase(found);
    return absl::OkStatus();
  }

 private:
  const size_t pose_log_capacity_;
  mutable std::mutex mutex_;
  std::map<std::string, ModelRecord, std::less<>> models_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, std::shared_ptr<PoseLog>, std::less<>> logs_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

std::unique_ptr<Store> MakeMemoryStore(size_t pose_log_capacity) {
  return std::make_unique<MemoryStore>(std::max<size_t>(pose_log_capacity, 1));
}

}  // namespace evpose::server
