// SPDX-License-Identifier: Apache-2.0

// The events that every client of the load test sends: a cube, as FLAT64 chunks of a millisecond.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "evpose/v1/session_service.pb.h"

namespace evpose::bench {

struct Scene {
  std::vector<std::string> chunks;  // one per millisecond of sensor time, from 0 on; may be empty
  uint64_t num_events = 0;
  std::string model_obj;
  v1::SessionConfig config;  // without the model's name
};

// Simulates `rate_hz` events per second for the given duration; about half of them from the cube's lines, the rest
// noise.
Scene MakeScene(double duration_s, double rate_hz);

}  // namespace evpose::bench
