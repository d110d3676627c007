// SPDX-License-Identifier: Apache-2.0

// One line of the table of `evpose bench speed` whose numbers depend on what is measured.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace evpose::client {

struct NamedNumber {
  std::string name;  // with its unit; the key in JSON
  double value = 0.0;
};

struct ServiceRow {
  std::string part;
  std::string what;
  std::string scene;            // SpeedScene::name
  double rate_mev_per_s = 0.0;  // of the recording, by the sensor's clock
  uint64_t num_events = 0;      // of a session
  std::vector<NamedNumber> numbers;
  std::string measure;  // the one that tables are compared by
  bool more_is_better = false;
};

}  // namespace evpose::client
