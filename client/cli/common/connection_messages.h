// SPDX-License-Identifier: Apache-2.0

// The messages to the user during an outage of the server.
#pragma once

#include <optional>
#include <string>

#include "absl/time/time.h"
#include "evpose/track.h"

namespace evpose::client {

// Counts outages and describes them; repeats an unchanged message only from time to time.
class ConnectionMessages {
 public:
  // Returns the message that is due; empty: none.
  std::string Describe(const ConnectionChange& change);

  int outages() const { return outages_; }
  absl::Duration away_for() const { return away_for_; }  // total duration of all outages

 private:
  bool is_away_ = false;
  absl::Duration described_at_;  // time of the last message since the start of the outage
  int outages_ = 0;
  absl::Duration away_for_;
};

}  // namespace evpose::client
