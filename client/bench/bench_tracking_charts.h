// SPDX-License-Identifier: Apache-2.0

// The results of `evpose bench tracking` as pictures.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/bench/chart.h"
#include "core/experiments/tracking/tracking_bench.h"

namespace evpose::client {

class TrackingCharts {
 public:
  // Pictures in `directory`, which is made when it is missing. Errors: those of ChartFile::Create(); the path when it
  // cannot be made.
  static absl::StatusOr<TrackingCharts> Create(const std::string& directory);

  // SCENARIO.png, of the first run: position and rotation over time beside the truth, and the errors.
  absl::Status Write(const TrackingBenchBlock& block) const;
  // summary.png: errors, honesty and losses of every row, and the targets.
  absl::Status WriteSummary(const std::vector<TrackingBenchBlock>& blocks) const;

 private:
  explicit TrackingCharts(std::string directory) : directory_(std::move(directory)) {}
  absl::Status WritePage(const std::string& name, const ChartPage& page) const;

  std::string directory_;
};

}  // namespace evpose::client
