// SPDX-License-Identifier: Apache-2.0
#include "client/bench/load_run.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <ctime>
#include <iterator>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/bench/virtual_user.h"
#include "client/lib/channel.h"
#include "client/lib/messages/conversion.h"
#include "core/base/status_macros.h"
#include "core/experiments/speed/measured_time.h"

namespace evpose::client {
namespace {

using Time = VirtualUser::Time;

// Connections to a server: the proxy of deploy/haproxy accepts 128 at a time from one address.
constexpr size_t kMaxConnections = 64;
// The thread wakes at most this often, for a group of users.
constexpr std::chrono::microseconds kLeastStep{500};
// Time for the work that on_begin and on_end start.
constexpr std::chrono::seconds kReadTimeout{30};
// Time for the summaries after the last events, and then for the cancelled calls.
constexpr std::chrono::seconds kFinishTimeout{60};
constexpr std::chrono::seconds kProgressPeriod{1};

class LoadRun {
 public:
  LoadRun(const LoadOptions& options, const LoadRecording& recording,
          const std::function<bool(double, const LoadCounts&)>& on_progress)
      : options_(options),
        on_progress_(on_progress),
        chunk_(recording.chunk_us()),
        target_{.recording = recording, .config = ToProto(options.config), .stubs = {}, .watch_hz = options.watch_hz} {}

  absl::StatusOr<LoadResult> Run() {
    EVPOSE_RETURN_IF_ERROR(Connect());
    const auto num = static_cast<size_t>(options_.sessions);
    for (size_t i = 0; i < num; ++i) {
      const size_t watchers =
          static_cast<size_t>(options_.watchers) / num + (i < static_cast<size_t>(options_.watchers) % num ? 1 : 0);
      users_.push_back(std::make_unique<VirtualUser>(target_, i, watchers));
    }
    step_ = std::max<std::chrono::microseconds>(kLeastStep, chunk_ / static_cast<int64_t>(num));
    begin_ = progress_at_ = std::chrono::steady_clock::now();
    const absl::Status started = Start();
    if (started.ok()) Measure();
    for (const auto& user : users_) user->Finish();
    const Time finish_by = std::chrono::steady_clock::now() + kFinishTimeout;
    is_interruptible_ = false;
    // Without a test there are no summaries to wait for.
    if (started.ok()) Until([&](Time now) { return IsIdle() || now >= finish_by; }, 1.0);
    for (const auto& user : users_) user->Cancel();
    Until([&](Time) { return IsIdle(); }, 1.0);
    EVPOSE_RETURN_IF_ERROR(started);
    result_.counts = Counts();
    result_.counts.LimitTo(counts_at_begin_, counts_at_end_);
    return result_;
  }

 private:
  absl::Status Connect() {
    const size_t num = std::min(kMaxConnections, static_cast<size_t>(options_.sessions));
    for (const std::string& address : std::vector<std::string>(absl::StrSplit(options_.addresses, ','))) {
      target_.stubs.emplace_back();
      for (size_t i = 0; i < num; ++i) {
        EVPOSE_ASSIGN_OR_RETURN(const auto channel, MakeChannel(address, options_.client, /*shares_connection=*/false));
        target_.stubs.back().push_back(v1::SessionService::NewStub(channel));
      }
    }
    return absl::OkStatus();
  }

  // Waits until every session was created or refused.
  absl::Status Start() {
    ptrdiff_t num_responses = 0;
    Time responded_at = begin_;
    bool is_unreachable = false;
    const auto is_over = [&](Time now) {
      if (const ptrdiff_t num = NumResponses(); num > num_responses) {
        num_responses = num;
        responded_at = now;
      }
      is_unreachable = now - responded_at >= absl::ToChronoMicroseconds(options_.max_outage);
      return is_unreachable || num_responses == std::ssize(users_);
    };
    if (!Until(is_over, 0.0)) return absl::CancelledError("interrupted");
    if (num_responses == std::ssize(users_)) return absl::OkStatus();
    return absl::UnavailableError(absl::StrCat(options_.addresses, ": ", users_.size() - num_responses, " of ",
                                               users_.size(), " sessions were neither created nor refused within ",
                                               absl::FormatDuration(options_.max_outage),
                                               "; check that the servers run and can be reached"));
  }

  // The test itself, after the start.
  void Measure() {
    CallAndWait(options_.on_begin, 0.0);
    const double cpu_begin_s = SecondsOfClock(CLOCK_PROCESS_CPUTIME_ID);
    const Time begin = std::chrono::steady_clock::now();
    const auto length =
        std::chrono::duration_cast<Time::duration>(std::chrono::duration<double, std::ratio<60>>(options_.minutes));
    for (const auto& user : users_) user->BeginMeasuring();
    counts_at_begin_ = Counts();
    lateness_ = server::LatencyHistogram();
    result_.late_max_us = 0;
    uint64_t num_replaced = 0;
    Until(
        [&](Time now) {
          const std::chrono::duration<double, std::ratio<60>> minutes = now - begin;
          const auto replaced = static_cast<uint64_t>(minutes.count() * options_.churn_per_minute);
          for (; num_replaced < replaced && now < begin + length; ++num_replaced) {
            users_[num_replaced % users_.size()]->Replace();
          }
          ratio_ = std::min(1.0, minutes.count() / options_.minutes);
          return now >= begin + length;
        },
        0.0);
    result_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    result_.cpu_s = SecondsOfClock(CLOCK_PROCESS_CPUTIME_ID) - cpu_begin_s;
    result_.late_p99_us = lateness_.Percentile(0.99);
    counts_at_end_ = Counts();
    is_interruptible_ = false;
    CallAndWait(options_.on_end, 1.0);
  }

  // Calls `start`, and goes on until is_read() returns true.
  void CallAndWait(const std::function<void()>& start, double ratio) {
    if (!start) return;
    start();
    const Time read_by = std::chrono::steady_clock::now() + kReadTimeout;
    if (options_.is_read) Until([&](Time now) { return options_.is_read() || now >= read_by; }, ratio);
  }

  // Acts for all users, each once per chunk, until `is_over(now)`. Returns false after an interrupt.
  bool Until(const std::function<bool(Time)>& is_over, double ratio) {
    ratio_ = ratio;
    const size_t num_groups = std::max<size_t>(1, static_cast<size_t>(chunk_ / step_));
    while (true) {
      for (size_t group = 0; group < num_groups; ++group) {
        const Time due = begin_ + num_rounds_ * chunk_ + static_cast<int64_t>(group) * step_;
        std::this_thread::sleep_until(due);
        const Time now = std::chrono::steady_clock::now();
        const int64_t late_us = std::chrono::duration_cast<std::chrono::microseconds>(now - due).count();
        lateness_.Add(late_us);
        result_.late_max_us = std::max(result_.late_max_us, late_us);
        for (size_t i = group; i < users_.size(); i += num_groups) users_[i]->Act(due);
      }
      ++num_rounds_;
      const Time now = std::chrono::steady_clock::now();
      if (!ReportProgress(now) && is_interruptible_) return false;
      if (is_over(now)) return true;
    }
  }

  bool ReportProgress(Time now) {
    if (now < progress_at_) return true;
    progress_at_ = now + kProgressPeriod;
    return on_progress_(ratio_, Counts());
  }
  ptrdiff_t NumResponses() const {
    return std::count_if(users_.begin(), users_.end(), [](const auto& user) { return user->HasResponse(); });
  }
  bool IsIdle() const {
    return std::all_of(users_.begin(), users_.end(), [](const auto& user) { return user->IsIdle(); });
  }
  LoadCounts Counts() const {
    LoadCounts sum;
    for (const auto& user : users_) sum.Add(user->counts());
    return sum;
  }

  const LoadOptions& options_;
  const std::function<bool(double, const LoadCounts&)>& on_progress_;
  const std::chrono::microseconds chunk_;
  std::chrono::microseconds step_{};
  LoadTarget target_;
  std::vector<std::unique_ptr<VirtualUser>> users_;  // are destroyed before the target
  Time begin_, progress_at_;
  int64_t num_rounds_ = 0;
  bool is_interruptible_ = true;
  double ratio_ = 0.0;
  server::LatencyHistogram lateness_;
  LoadCounts counts_at_begin_, counts_at_end_;  // of the test
  LoadResult result_;
};

}  // namespace

absl::StatusOr<LoadResult> RunLoad(const LoadOptions& options, const LoadRecording& recording,
                                   const std::function<bool(double ratio, const LoadCounts& counts)>& on_progress) {
  return LoadRun(options, recording, on_progress).Run();
}

}  // namespace evpose::client
