// SPDX-License-Identifier: Apache-2.0
#include "server/connections/memory_trimmer.h"

#include <malloc.h>

#include <utility>

#include "server/telemetry/process_usage.h"

namespace evpose::server {

MemoryTrimmer::MemoryTrimmer() : MemoryTrimmer(ProcessResidentBytes, [] { malloc_trim(0); }) {}

MemoryTrimmer::MemoryTrimmer(std::function<size_t()> resident_bytes, std::function<void()> trim)
    : resident_bytes_(std::move(resident_bytes)), trim_(std::move(trim)) {}

void MemoryTrimmer::Step(size_t num_closed) {
  if (num_closed > 0 && num_steps_left_ == 0) {
    interval_ = kSteps;
    num_steps_left_ = kSteps;
  }
  if (num_steps_left_ == 0 || --num_steps_left_ > 0) return;
  if (interval_ == kSteps && resident_bytes_() < trimmed_bytes_ + kMinGrowthBytes) return;
  trim_();
  trimmed_bytes_ = resident_bytes_();
  interval_ *= 2;
  if (interval_ <= kMaxSteps) num_steps_left_ = interval_;
}

}  // namespace evpose::server
