// SPDX-License-Identifier: Apache-2.0

// Helpers of the tests of stores.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <future>
#include <memory>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "core/base/temporary_directory_testing.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Opens stores of one kind on the same data, one after the other.
class StoreFixture {
 public:
  virtual ~StoreFixture() = default;
  virtual absl::StatusOr<std::unique_ptr<Store>> Open() = 0;
  // Opens a store with space for about `max_bytes`.
  virtual absl::StatusOr<std::unique_ptr<Store>> OpenSmall(uint64_t max_bytes) = 0;
  // Makes the store give the last fencing number of the session sessions/a again, as a replica does that had missed it
  // and became the master.
  virtual void RepeatLastNumber() = 0;
  // Returns a function that replaces the contents of the store by the present ones; null if nothing can do that to a
  // store in use.
  virtual std::function<void()> Snapshot() { return nullptr; }
  // False if the sessions are in different groups of the store, each with memory of its own.
  virtual bool AreTogether(const std::string& /*session*/, const std::string& /*other*/) const { return true; }
  // True if the data outlive the store object.
  virtual bool keeps() const { return true; }
};

struct TestedStore {
  std::string name;
  std::function<std::unique_ptr<StoreFixture>()> build;

  friend void PrintTo(const TestedStore& kind, std::ostream* out) { *out << kind.name; }
};

inline SessionRecord Record(const std::string& name) {
  return {.name = name,
          .tenant = "tenant of " + name,
          .request_id = "",
          .create_time = absl::FromUnixNanos(1'700'000'000'123'456'789),
          .config = std::string("config\0of ", 10) + name};
}

// The names of all sessions, sorted.
inline std::vector<std::string> NamesOf(const Store& store) {
  const std::vector<SessionOwner> owners = store.ListOwners().value();
  std::vector<std::string> names;
  for (const SessionOwner& owner : owners) names.push_back(owner.name);
  return names;
}

// A segment whose bytes contain the session and the numbers of the poses, so that a test detects exchanged segments.
inline PoseSegment Segment(const std::string& session, uint64_t first, uint64_t last) {
  return {.first_pose_seq = first,
          .last_pose_seq = last,
          .bytes = session + " poses " + std::to_string(first) + " to " + std::to_string(last)};
}

// Pseudo-random bytes, which a store cannot compress.
inline std::string Noise(size_t size, uint64_t seed) {
  std::string bytes(size, '\0');
  for (char& byte : bytes) {
    seed = seed * 6364136223846793005u + 1442695040888963407u;
    byte = static_cast<char>(seed >> 56);
  }
  return bytes;
}

inline ModelRecord Model(const std::string& name, const std::string& tenant, const std::string& bytes) {
  return {
      .name = name,
      .tenant = tenant,
      .reading = {.format = ModelFormat::kStl, .metres_per_unit = 0.001, .crease_angle_deg = 12.5, .is_smooth = false},
      .create_time = absl::FromUnixNanos(1'700'000'000'987'654'321),
      .summary = "summary",
      .bytes = std::make_shared<const std::vector<uint8_t>>(bytes.begin(), bytes.end()),
      .prepared = std::string("\0prepared", 9)};
}

// Commits and waits for the result.
inline absl::Status CommitNow(SessionLease& lease, SessionCommit commit) {
  std::promise<absl::Status> done;
  lease.Commit(std::move(commit), [&done](absl::Status status) { done.set_value(std::move(status)); });
  return done.get_future().get();
}

// The ranges of the segments as text, for example "1-3 4-9".
inline std::string Ranges(const std::vector<PoseSegment>& poses) {
  std::string ranges;
  for (const PoseSegment& segment : poses) {
    if (!ranges.empty()) ranges += ' ';
    ranges += std::to_string(segment.first_pose_seq) + '-' + std::to_string(segment.last_pose_seq);
  }
  return ranges;
}

}  // namespace evpose::server
