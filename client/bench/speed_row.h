// SPDX-License-Identifier: Apache-2.0

// A line of the table of `evpose bench speed`, for parts that have columns of their own.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace evpose::client {

struct NamedNumber {
  std::string name;  // with the unit; also the key in JSON
  double value = 0.0;
};

struct ServiceRow {
  std::string part;
  std::string what;
  std::string scene;            // SpeedScene::name
  double rate_mev_per_s = 0.0;  // event rate of the recording in sensor time
  uint64_t num_events = 0;      // per session
  std::vector<NamedNumber> numbers;
  std::string measure;  // name of the number by which tests/bench/compare.py compares two tables
  bool more_is_better = false;
};

}  // namespace evpose::client
