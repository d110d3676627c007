// SPDX-License-Identifier: Apache-2.0

// What a load test counts.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "server/runtime/latency_histogram.h"

namespace evpose::client {

// Returns the sensor time at the end of the chunk that has the last events of the window of the pose at `t_us`. Poses
// belong to the middles of adjacent windows: the window ends half-way to the next pose.
int64_t WindowDueUs(int64_t t_us, int64_t next_t_us, int64_t chunk_us);

// The longest time without a pose of a session that has ended: between two poses, or from its last pose to its end if
// that was an error.
struct SessionPause {
  int64_t longest_us = 0;
  bool has_reconnected = false;  // the session has attached again after an error
};

// Counts of one virtual user of a load test (virtual_user.h), or of all.
struct LoadCounts {
  uint64_t created = 0;
  uint64_t completed = 0;                    // sessions with a received summary
  std::map<std::string, uint64_t> refusals;  // creations that failed, by reason or status code
  std::map<std::string, uint64_t> failures;  // sessions that ended with an error, by reason or status code
  uint64_t unfinished = 0;                   // sessions without a summary at the end of the test
  uint64_t events = 0;                       // sent, without repetitions
  uint64_t poses = 0;                        // received
  uint64_t lost_poses = 0;                   // missing numbers, with those that the server reported as lost
  uint64_t reconnections = 0;
  uint64_t watched_poses = 0;
  uint64_t unwatched_poses = 0;  // poses that a watcher was too slow for
  // Time from when the chunk that completes a window was to be sent until its pose has arrived.
  server::LatencyHistogram latency;
  int64_t max_latency_us = 0;
  std::vector<SessionPause> pauses;  // of each session that has received a pose

  void AddLatency(int64_t latency_us);
  // Adds another user's counts.
  void Add(const LoadCounts& other);
  // The longest pauses of all sessions, or of those that have reconnected, in seconds and in increasing order.
  std::vector<double> SortedPausesS(bool only_reconnected) const;
  // Replaces the numbers of events and poses by those between two moments, for rates.
  void LimitTo(const LoadCounts& begin, const LoadCounts& end);
  // No pose was lost, and no session failed or is unfinished.
  bool IsComplete() const { return lost_poses == 0 && failures.empty() && unfinished == 0; }
};

}  // namespace evpose::client
