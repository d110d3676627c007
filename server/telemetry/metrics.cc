// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/metrics.h"

#include <algorithm>
#include <thread>

namespace evpose::server {

std::optional<Exemplar> ExemplarSlot::Get() const {
  while (is_in_use_.exchange(true, std::memory_order_acquire)) std::this_thread::yield();
  const std::optional<Exemplar> exemplar = is_set_ ? std::optional(exemplar_) : std::nullopt;
  is_in_use_.store(false, std::memory_order_release);
  return exemplar;
}

void DurationHistogram::SetExemplar(Duration duration, std::string_view trace_id,
                                    std::chrono::system_clock::time_point time) {
  Exemplar exemplar = {.duration = std::max(duration, Duration(0)), .time = time};
  if (trace_id.size() != exemplar.trace_id.size()) return;
  std::copy(trace_id.begin(), trace_id.end(), exemplar.trace_id.begin());
  exemplars_[BucketOf(duration)].Set(exemplar);
}

std::array<std::optional<Exemplar>, DurationHistogram::kNumBuckets> DurationHistogram::ReadExemplars() const {
  std::array<std::optional<Exemplar>, kNumBuckets> exemplars;
  std::transform(exemplars_.begin(), exemplars_.end(), exemplars.begin(),
                 [](const ExemplarSlot& slot) { return slot.Get(); });
  return exemplars;
}

DurationHistogram::Reading DurationHistogram::Read() const {
  Reading reading;
  std::transform(counts_.begin(), counts_.end(), reading.counts.begin(),
                 [](const Counter& count) { return count.value(); });
  reading.sum_s = static_cast<double>(sum_ns_.value()) * 1e-9;
  return reading;
}

}  // namespace evpose::server
