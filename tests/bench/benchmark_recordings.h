// SPDX-License-Identifier: Apache-2.0

// The input of the benchmarks: short recordings of the scenes of `evpose bench speed`, simulated once.
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "core/experiments/speed/speed_recordings.h"

namespace evpose::bench {

constexpr int64_t kBenchmarkDurationUs = 50'000;

inline const SpeedRecording& RecordingOf(const std::string& scene) {
  static std::map<std::string, SpeedRecording>* const all = new std::map<std::string, SpeedRecording>();
  const auto [found, is_new] = all->try_emplace(scene);
  if (is_new) found->second = MakeSpeedRecording(scene, kBenchmarkDurationUs).value();
  return found->second;
}

inline const std::vector<uint8_t>& BytesOf(const std::string& scene, Encoding encoding) {
  static std::map<std::pair<std::string, Encoding>, std::vector<uint8_t>>* const all =
      new std::map<std::pair<std::string, Encoding>, std::vector<uint8_t>>();
  const auto [found, is_new] = all->try_emplace({scene, encoding});
  if (is_new) found->second = EncodeRecording(RecordingOf(scene), encoding).value();
  return found->second;
}

}  // namespace evpose::bench
