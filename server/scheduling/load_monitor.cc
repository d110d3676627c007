// SPDX-License-Identifier: Apache-2.0
#include "server/scheduling/load_monitor.h"

#include <algorithm>
#include <cmath>

namespace evpose::server {

LoadMonitor::LoadMonitor(Options options)
    : options_(std::move(options)), updated_at_(options_.now()), cpu_(options_.cpu()) {}

void LoadMonitor::Update() {
  const Time now = options_.now();
  const std::chrono::nanoseconds cpu = options_.cpu();
  const std::lock_guard lock(mutex_);
  const std::chrono::duration<double> elapsed = now - updated_at_;
  if (elapsed.count() <= 0.0) return;
  const std::chrono::duration<double> used = cpu - cpu_;
  // A turn counts when it ends, so that an interval can have more than its own time.
  const double recent = std::clamp(used.count() / elapsed.count() / options_.num_workers, 0.0, 1.0);
  const double weight = 1.0 - std::exp(-elapsed.count() / std::chrono::duration<double>(kTimeConstant).count());
  ratio_ += weight * (recent - ratio_);
  updated_at_ = now;
  cpu_ = cpu;
  if (options_.max_ratio == 0.0 || ratio_ <= options_.max_ratio) {
    above_since_.reset();
  } else if (!above_since_.has_value()) {
    above_since_ = now;
  }
}

double LoadMonitor::ratio() const {
  const std::lock_guard lock(mutex_);
  return ratio_;
}

bool LoadMonitor::IsOverloaded() const {
  const std::lock_guard lock(mutex_);
  return above_since_.has_value() && options_.now() - *above_since_ >= kHold;
}

}  // namespace evpose::server
