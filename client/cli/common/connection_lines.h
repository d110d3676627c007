// SPDX-License-Identifier: Apache-2.0

// What a user is told while the server is away.
#pragma once

#include <optional>
#include <string>

#include "absl/time/time.h"
#include "client/lib/track.h"

namespace evpose::client {

// Counts, and says in words, now and then only while nothing changes.
class ConnectionLines {
 public:
  // What is to be said now; empty: nothing.
  std::string Describe(const ConnectionChange& change);

  int outages() const { return outages_; }
  absl::Duration away_for() const { return away_for_; }  // in all

 private:
  bool is_away_ = false;
  absl::Duration said_at_;  // since it is away
  int outages_ = 0;
  absl::Duration away_for_;
};

}  // namespace evpose::client
