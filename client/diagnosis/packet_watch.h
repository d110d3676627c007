// SPDX-License-Identifier: Apache-2.0

// Measures how the events of a live camera arrive: the period of its packets, and whether the pipe keeps up with the
// camera.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "absl/time/time.h"
#include "core/diagnosis/finding.h"

namespace evpose::client {

struct PacketOptions {
  // Milliseconds of sensor time in a packet. The first events of a packet are late by this time. The default of the SDK
  // is 4 ms, and the windows of tracking are 1 to 20 ms long.
  Limits period_ms = {6.0, 50.0};
  // Seconds by which the events of a live camera may fall behind its clock during the observation. The buffers of a
  // driver hold some tenths of a second.
  Limits lag_s = {0.2, 1.0};
  // Ratio of sensor time to host time above which the events come from a file and not from a live camera.
  double max_live_ratio = 1.2;
  // Host time after which the ratio is known to a tenth if single reads are delayed by 0.05 s.
  absl::Duration min_duration = absl::Milliseconds(500);
};

class PacketWatch {
 public:
  // Adds a read that returned at `now` after waiting for `waited`; `t_us` is the time of the latest event in it.
  void Add(absl::Time now, absl::Duration waited, int64_t t_us);

  Finding CheckPeriod(const PacketOptions& options) const;
  Finding CheckLag(const PacketOptions& options) const;

 private:
  std::optional<Finding> ReasonNotLive(const char* check, const PacketOptions& options) const;
  double Ratio() const;

  bool has_begun_ = false;
  absl::Time begin_, end_;
  int64_t begin_us_ = 0;
  int64_t end_us_ = 0;
  int64_t packet_us_ = 0;  // time of the latest event when the last wait began
  std::vector<double> periods_ms_;
};

}  // namespace evpose::client
