// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/watch/watch_reactors.h"

#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "server/rpc/common/call_alarm.h"
#include "server/rpc/common/conversion.h"
#include "server/rpc/watch/watch_reactor.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

// Maximum number of poses in a response: about 40 KB, which bounds the memory of a stalled reader.
constexpr size_t kPosesPerResponse = 64;
constexpr absl::Duration kDefaultPeriod = absl::Seconds(1);  // of reports of health, as the API states
// A shorter one would cost processor time without new information.
constexpr absl::Duration kMinPeriod = absl::Milliseconds(10);

// Reads the session's log at the pace of the client, so that a slow reader needs the memory of one response and no
// queue.
class WatchPosesReactor : public WatchReactor<v1::WatchPosesResponse> {
 public:
  using WatchReactor::WatchReactor;

  absl::Status Begin(const Caller& caller, const v1::WatchPosesRequest& request) {
    if (request.has_max_rate_hz()) {
      const double rate_hz = request.max_rate_hz();
      if (!(rate_hz > 0.0) || !std::isfinite(rate_hz)) {
        return InvalidField("max_rate_hz", absl::StrCat("is ", rate_hz, "; it must be positive"));
      }
      min_interval_us_ = 1e6 / rate_hz;
    }
    cursor_ = request.after_pose_seq();
    return FindSession(caller, request.session());
  }

 private:
  absl::Status OnFound() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    live_from_ = session().Watch().last_pose_seq;
    last_t_us_.assign(session().config().objects.size(), std::numeric_limits<int64_t>::min());
    return WatchReactor::OnFound();
  }

  bool PickResponse(const WatchView& view, v1::WatchPosesResponse& response, bool& is_last) override
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (std::exchange(is_first_, false) && cursor_ > view.last_pose_seq) {
      response.set_continues_after_pose_seq(view.last_pose_seq);
      return true;
    }
    while (cursor_ < view.last_pose_seq && response.poses().empty()) {
      uint64_t skipped = 0;
      if (cursor_ >= live_from_ && view.last_pose_seq - cursor_ > session().max_poses_behind()) {
        skipped = view.last_pose_seq - session().max_poses_behind() - cursor_;
        cursor_ += skipped;
      }
      const auto page = session().ReadPoses(cursor_, kPosesPerResponse);
      if (page.empty()) return false;
      skipped += page.front().pose_seq - cursor_ - 1;
      response.set_num_skipped(response.num_skipped() + skipped);
      cursor_ = page.back().pose_seq;
      for (const StoredPose& pose : page) {
        if (IsDue(pose)) *response.add_poses() = ToProto(pose, session().config());
      }
    }
    is_last = view.has_ended && cursor_ >= view.last_pose_seq;
    return !response.poses().empty() || response.num_skipped() > 0;
  }

  bool IsDue(const StoredPose& pose) {
    int64_t& last_t_us = last_t_us_[pose.object_index];
    const int64_t t_us = pose.estimate.t_us;
    if (last_t_us != std::numeric_limits<int64_t>::min() && static_cast<double>(t_us - last_t_us) < min_interval_us_) {
      return false;
    }
    last_t_us = t_us;
    return true;
  }

  double min_interval_us_ = 0.0;
  uint64_t cursor_ = 0;     // number of the last pose that was sent or omitted
  uint64_t live_from_ = 0;  // number of the last pose that existed when the reader started
  bool is_first_ = true;    // no response has been picked
  std::vector<int64_t> last_t_us_;
};

class WatchHealthReactor : public WatchReactor<v1::WatchHealthResponse> {
 public:
  using WatchReactor::WatchReactor;

  absl::Status Begin(const Caller& caller, const v1::WatchHealthRequest& request) {
    if (request.has_period()) {
      period_ = FromProto(request.period());
      if (period_ < kMinPeriod) {
        return InvalidField("period", absl::StrCat("is ", absl::FormatDuration(period_), "; at least ",
                                                   absl::FormatDuration(kMinPeriod), " is required"));
      }
    }
    tenant_ = caller.tenant;
    health_reservation_ = quotas().AddHealthWatcher(tenant_);
    return FindSession(caller, request.session());
  }

 private:
  bool PickResponse(const WatchView& view, v1::WatchHealthResponse& response, bool& is_last) override
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    is_last = view.has_ended && final_was_sent_;
    if (is_last || !(is_due_ || view.has_ended)) return false;
    is_due_ = false;
    final_was_sent_ = view.has_ended;
    *response.mutable_health() = ToProto(session().health(), session().config());
    if (!view.has_ended) Fail(SetAlarm());
    return true;
  }

  absl::Status SetAlarm() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    return alarm_.Set(quotas().HealthPeriod(tenant_, period_), [weak = weak_from_this()] {
      if (const auto self = weak.lock()) static_cast<WatchHealthReactor*>(self.get())->OnAlarm();
    });
  }

  void OnAlarm() {
    const std::lock_guard lock(mutex_);
    is_due_ = true;
    Pump();
  }

  void OnFinish() override ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) { alarm_.Cancel(); }

  absl::Duration period_ = kDefaultPeriod;
  std::string tenant_;
  std::shared_ptr<const void> health_reservation_;  // among the watchers of health
  bool is_due_ ABSL_GUARDED_BY(mutex_) = true;
  bool final_was_sent_ ABSL_GUARDED_BY(mutex_) = false;
  CallAlarm alarm_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

grpc::ServerWriteReactor<v1::WatchPosesResponse>* StartWatchPoses(const ServiceContext& services,
                                                                  grpc::CallbackServerContext* context,
                                                                  const v1::WatchPosesRequest& request) {
  return StartWatch<WatchPosesReactor>(services, context, request);
}

grpc::ServerWriteReactor<v1::WatchHealthResponse>* StartWatchHealth(const ServiceContext& services,
                                                                    grpc::CallbackServerContext* context,
                                                                    const v1::WatchHealthRequest& request) {
  return StartWatch<WatchHealthReactor>(services, context, request);
}

}  // namespace evpose::server
