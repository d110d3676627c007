// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/stores/commit_replay.h"

#include <algorithm>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <queue>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "tests/bench/stores/in_parallel.h"

namespace evpose::server {
namespace {

using Clock = std::chrono::steady_clock;
using Time = Clock::time_point;
using std::chrono::microseconds;

// The pause before a commit is repeated, as SessionCommitter::Backoff::first.
constexpr std::chrono::milliseconds kRetryPause{100};

struct Replayed {
  std::unique_ptr<SessionLease> lease;
  Time begin;
  size_t next = 0;  // index of the next commit
};

class CommitReplay {
 public:
  CommitReplay(Store& store, const SessionRecording& recording, const ReplayOptions& options)
      : store_(store), recording_(recording), options_(options), length_(recording.commits.back().at) {}

  absl::StatusOr<ReplayResult> Run() {
    result_.bytes_before = BytesInUse();
    EVPOSE_RETURN_IF_ERROR(Create());
    MeasureIdle();
    Time begin = Clock::now();
    for (size_t i = 0; i < sessions_.size(); ++i) {
      sessions_[i].begin = begin + options_.spread * static_cast<int64_t>(i) / static_cast<int64_t>(sessions_.size());
      due_.push({sessions_[i].begin + recording_.commits.front().at, i});
    }
    from_ = begin + options_.spread + options_.warm_up;
    until_ = begin + length_;
    std::jthread writer([this] { WriteDue(); });
    Measure();
    writer.join();
    Finish();
    EVPOSE_RETURN_IF_ERROR(Delete());
    return result_;
  }

 private:
  struct Due {
    Time at;
    size_t session = 0;
    friend bool operator<(const Due& a, const Due& b) { return a.at > b.at; }  // the earliest is on top
  };

  absl::Status Create() {
    sessions_.resize(static_cast<size_t>(options_.sessions));
    return InParallel(sessions_.size(), [this](size_t i) -> absl::Status {
      SessionRecord record = recording_.record;
      record.request_id.clear();
      EVPOSE_ASSIGN_OR_RETURN(record.name, store_.NewSessionName(record.tenant, record.request_id));
      EVPOSE_ASSIGN_OR_RETURN(sessions_[i].lease, store_.CreateSession(record, recording_.lifecycle));
      const std::lock_guard lock(mutex_);
      names_.push_back(record.name);
      return absl::OkStatus();
    });
  }

  absl::Status Delete() {
    if (!options_.deletes_sessions) return absl::OkStatus();
    const std::lock_guard lock(mutex_);
    return InParallel(names_.size(),
                      [this](size_t i) ABSL_NO_THREAD_SAFETY_ANALYSIS { return store_.DeleteSession(names_[i]); });
  }

  std::optional<uint64_t> BytesInUse() const {
    const std::optional<StoreUsage> usage = store_.Usage();
    return usage.has_value() ? std::optional(usage->bytes) : std::nullopt;
  }

  // The processor cores that the store has used from now until `end`.
  std::optional<double> CoresUntil(Time end) const {
    const std::optional<StoreUsage> before = store_.Usage();
    const Time begin = Clock::now();
    std::this_thread::sleep_until(end);
    const std::optional<StoreUsage> after = store_.Usage();
    if (!before.has_value() || !after.has_value() || !before->cpu_s.has_value() || !after->cpu_s.has_value()) {
      return std::nullopt;
    }
    return (*after->cpu_s - *before->cpu_s) / std::chrono::duration<double>(Clock::now() - begin).count();
  }

  void MeasureIdle() {
    if (options_.idle.count() > 0) result_.idle_cores = CoresUntil(Clock::now() + options_.idle);
  }

  void Measure() {
    std::this_thread::sleep_until(from_);
    const std::optional<double> cores = CoresUntil(until_);
    const std::optional<uint64_t> bytes = BytesInUse();
    const std::lock_guard lock(mutex_);
    result_.seconds = std::chrono::duration<double>(until_ - from_).count();
    result_.cores = cores;
    result_.bytes_after = bytes;
  }

  // Begins each commit when it is due, until the end of the measurement, and waits for those that are under way.
  void WriteDue() {
    std::unique_lock lock(mutex_);
    while (Clock::now() < until_) {
      if (due_.empty() || due_.top().at > Clock::now()) {
        changed_.wait_until(lock, due_.empty() ? until_ : std::min(until_, due_.top().at));
        continue;
      }
      const size_t session = due_.top().session;
      due_.pop();
      ++num_in_flight_;
      const SessionCommit& commit = recording_.commits[sessions_[session].next].commit;
      lock.unlock();
      // The recorded session went on; the last commit must not mark these sessions as ended either.
      SessionCommit copy = commit;
      copy.ended_at.reset();
      sessions_[session].lease->Commit(std::move(copy),
                                       [this, session](const absl::Status& status) { OnDone(session, status); });
      lock.lock();
    }
    changed_.wait(lock, [this]() ABSL_NO_THREAD_SAFETY_ANALYSIS { return num_in_flight_ == 0; });
  }

  void OnDone(size_t index, const absl::Status& status) {
    const std::lock_guard lock(mutex_);
    --num_in_flight_;
    changed_.notify_all();
    Replayed& session = sessions_[index];
    if (absl::IsUnavailable(status)) {
      ++result_.repeated;
      return due_.push({Clock::now() + kRetryPause, index});
    }
    if (!status.ok()) {
      ++result_.errors[absl::StatusCodeToString(status.code())];
      return;
    }
    const RecordedCommit& recorded = recording_.commits[session.next];
    const Time due = session.begin + recorded.at;
    const Time now = Clock::now();
    if (IsMeasured(now)) {
      ++result_.written;
      result_.bytes += SizeBytes(recorded.commit);
    }
    if (IsMeasured(due)) {
      ++result_.commits;
      AddLatency(now - due);
    }
    if (++session.next < recording_.commits.size()) {
      due_.push({session.begin + recording_.commits[session.next].at, index});
    }
  }

  // Counts the commits that were due and were not begun.
  void Finish() {
    const std::lock_guard lock(mutex_);
    for (; !due_.empty(); due_.pop()) {
      const Replayed& session = sessions_[due_.top().session];
      for (size_t i = session.next; i < recording_.commits.size(); ++i) {
        const Time due = session.begin + recording_.commits[i].at;
        if (!IsMeasured(due)) continue;
        ++result_.unwritten;
        AddLatency(until_ - due);
      }
    }
  }

  bool IsMeasured(Time time) const { return time >= from_ && time < until_; }

  void AddLatency(Clock::duration latency) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const int64_t latency_us = std::chrono::duration_cast<microseconds>(latency).count();
    result_.latency.Add(latency_us);
    result_.max_latency_us = std::max(result_.max_latency_us, latency_us);
  }

  Store& store_;
  const SessionRecording& recording_;
  const ReplayOptions& options_;
  const microseconds length_;
  Time from_, until_;               // the measurement
  std::vector<Replayed> sessions_;  // each one is used by one thread at a time
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> names_ ABSL_GUARDED_BY(mutex_);
  std::priority_queue<Due> due_ ABSL_GUARDED_BY(mutex_);
  size_t num_in_flight_ ABSL_GUARDED_BY(mutex_) = 0;
  ReplayResult result_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

absl::StatusOr<ReplayResult> Replay(Store& store, const SessionRecording& recording, const ReplayOptions& options) {
  if (recording.commits.empty() || recording.commits.back().at <= options.spread + options.warm_up) {
    return absl::InvalidArgumentError("the recording is not longer than the spread and the warm-up together");
  }
  return CommitReplay(store, recording, options).Run();
}

}  // namespace evpose::server
