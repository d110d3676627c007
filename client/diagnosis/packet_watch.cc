// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/packet_watch.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"
#include "core/numerics/statistics.h"

namespace evpose::client {
namespace {

// A read that waited for longer than this waited for the camera; a shorter wait is that for the process at the other
// end of the pipe.
constexpr absl::Duration kLeastWait = absl::Microseconds(200);
constexpr size_t kMaxPeriods = 65'536;  // bounds memory
constexpr size_t kMinPeriods = 10;      // fewer have no reliable median

}  // namespace

void PacketWatch::Add(absl::Time now, absl::Duration waited, int64_t t_us) {
  if (!has_begun_) {
    has_begun_ = true;
    begin_ = now;
    begin_us_ = packet_us_ = t_us;
  } else if (waited > kLeastWait && t_us > packet_us_) {
    if (periods_ms_.size() < kMaxPeriods) periods_ms_.push_back(1e-3 * static_cast<double>(t_us - packet_us_));
    packet_us_ = t_us;
  }
  end_ = now;
  end_us_ = t_us;
}

double PacketWatch::Ratio() const {
  return 1e-6 * static_cast<double>(end_us_ - begin_us_) / std::max(absl::ToDoubleSeconds(end_ - begin_), 1e-9);
}

std::optional<Finding> PacketWatch::ReasonNotLive(const char* check, const PacketOptions& options) const {
  if (!has_begun_) return NotChecked(check, "no event arrived");
  if (Ratio() > options.max_live_ratio) {
    return NotChecked(check,
                      absl::StrFormat("the events arrive %.3g times as fast as they were recorded: a file", Ratio()));
  }
  if (end_ - begin_ < options.min_duration) {
    return NotChecked(check, absl::StrCat("events arrived for less than ", absl::FormatDuration(options.min_duration)));
  }
  return std::nullopt;
}

Finding PacketWatch::CheckPeriod(const PacketOptions& options) const {
  if (const auto reason = ReasonNotLive("packet-period", options)) return *reason;
  if (periods_ms_.size() < kMinPeriods) {
    return NotChecked("packet-period",
                      absl::StrCat(Counted(periods_ms_.size(), "packet"), " arrived; the median needs ", kMinPeriods));
  }
  std::vector<double> periods = periods_ms_;
  Finding finding;
  finding.check = "packet-period";
  SetVerdict(UpperMedian(periods), options.period_ms, "ms", finding);
  finding.text = absl::StrFormat("packets have %.2f ms of sensor time, by which poses are late", *finding.value);
  if (finding.verdict != Verdict::kOk) {
    finding.remedy =
        "a shorter packet period: capture_camera --period-us 1000, mipi_frame_period of metavision_driver "
        "(deploy/sensors/README.md)";
  }
  return finding;
}

Finding PacketWatch::CheckLag(const PacketOptions& options) const {
  if (const auto reason = ReasonNotLive("pipe", options)) return *reason;
  Finding finding;
  finding.check = "pipe";
  const double lag_s = absl::ToDoubleSeconds(end_ - begin_) - 1e-6 * static_cast<double>(end_us_ - begin_us_);
  SetVerdict(lag_s, options.lag_s, "s", finding);
  finding.text = absl::StrFormat("in %.2f s the events fell %.3f s behind the camera's clock",
                                 absl::ToDoubleSeconds(end_ - begin_), std::max(lag_s, 0.0));
  if (finding.verdict != Verdict::kOk) {
    finding.remedy =
        "the program that writes the pipe, or the link to the camera, does not keep up: lower the event rate, or use a "
        "faster link (deploy/sensors/README.md)";
  }
  return finding;
}

}  // namespace evpose::client
