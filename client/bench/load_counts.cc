// SPDX-License-Identifier: Apache-2.0
#include "client/bench/load_counts.h"

#include <algorithm>
#include <vector>

namespace evpose::client {
namespace {

void AddTo(std::map<std::string, uint64_t>& sum, const std::map<std::string, uint64_t>& more) {
  for (const auto& [reason, count] : more) sum[reason] += count;
}

server::LatencyHistogram Sum(const server::LatencyHistogram& a, const server::LatencyHistogram& b) {
  std::vector<uint32_t> counts(a.counts().begin(), a.counts().end());
  counts.resize(std::max(a.counts().size(), b.counts().size()));
  for (size_t i = 0; i < b.counts().size(); ++i) counts[i] += b.counts()[i];
  return server::LatencyHistogram(counts);
}

}  // namespace

int64_t WindowDueUs(int64_t t_us, int64_t next_t_us, int64_t chunk_us) {
  return ((t_us + next_t_us) / 2 / chunk_us + 1) * chunk_us;
}

void LoadCounts::AddLatency(int64_t latency_us) {
  latency.Add(latency_us);
  max_latency_us = std::max(max_latency_us, latency_us);
}

void LoadCounts::Add(const LoadCounts& other) {
  created += other.created;
  completed += other.completed;
  AddTo(refusals, other.refusals);
  AddTo(failures, other.failures);
  unfinished += other.unfinished;
  events += other.events;
  poses += other.poses;
  lost_poses += other.lost_poses;
  reconnections += other.reconnections;
  watched_poses += other.watched_poses;
  unwatched_poses += other.unwatched_poses;
  latency = Sum(latency, other.latency);
  max_latency_us = std::max(max_latency_us, other.max_latency_us);
  pauses.insert(pauses.end(), other.pauses.begin(), other.pauses.end());
}

std::vector<double> LoadCounts::SortedPausesS(bool only_reconnected) const {
  std::vector<double> sorted;
  for (const SessionPause& pause : pauses) {
    if (pause.has_reconnected || !only_reconnected) sorted.push_back(1e-6 * static_cast<double>(pause.longest_us));
  }
  std::sort(sorted.begin(), sorted.end());
  return sorted;
}

void LoadCounts::LimitTo(const LoadCounts& begin, const LoadCounts& end) {
  events = end.events - begin.events;
  poses = end.poses - begin.poses;
  watched_poses = end.watched_poses - begin.watched_poses;
  unwatched_poses = end.unwatched_poses - begin.unwatched_poses;
}

}  // namespace evpose::client
