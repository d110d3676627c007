// SPDX-License-Identifier: Apache-2.0

// Decides when a session writes a checkpoint, when it has to wait for the store, and which poses must stay in memory.
#pragma once

#include <cstdint>

#include "server/sessions/durability/session_committer.h"

namespace evpose::server {

// A checkpoint is due after this processing time, microseconds, or this number of poses, whichever comes first, so that
// a crash loses at most as much work...
inline constexpr int64_t kCheckpointWorkUs = 100'000;
inline constexpr uint64_t kCheckpointPoses = 1000;
// ...but not before the processing time has reached this multiple of the cost of the last checkpoint, so that
// checkpoints take at most a twentieth of the time.
inline constexpr int64_t kCheckpointCostFactor = 20;
// Number of poses that may wait for the store before the session does: four seconds of poses at 1 kHz, which covers a
// short outage of the store.
inline constexpr uint64_t kMaxUncommittedPoses = 4096;
// Largest number of poses beyond the last persisted one that are sent to a stream, however many poses one item
// produces. It bounds the poses that a client may have seen when it attaches again after a crash.
inline constexpr uint64_t kMaxPosesBeyondStore = 2 * kMaxUncommittedPoses;

// Not thread-safe; a function of the counters passed to it, without clock or store.
class CheckpointPolicy {
 public:
  // State of the session at the time of a call.
  struct Counters {
    uint64_t processed_seq = 0;
    bool has_ended = false;
    uint64_t poses = 0;         // made so far
    int64_t processing_us = 0;  // processing time so far
    bool is_working = false;    // an item is being processed
    bool has_waiting = false;   // further items wait
    bool may_receive = false;   // a stream is attached, and its client has not half-closed it
  };
  // Contents of a checkpoint.
  struct Checkpoint {
    uint64_t processed_seq = 0;
    bool has_ended = false;
    int64_t processing_us = 0;
    int64_t cost_us = 0;  // time that its serialization took
  };

  // `last` is the checkpoint from which the session starts, `last_pose_seq` the number of the last pose that was made
  // or stored. The store may have poses beyond the checkpoint.
  CheckpointPolicy(bool writes_checkpoints, const Checkpoint& last, uint64_t last_pose_seq)
      : writes_checkpoints_(writes_checkpoints), last_(last), last_pose_seq_(last_pose_seq) {}

  using Progress = SessionCommitter::Progress;
  bool IsDue(const Counters& now, const Progress& store) const;
  // Returns whether the session must produce no more poses until the store has some of those that wait.
  bool MustWait(uint64_t poses, const Progress& store) const;
  // Returns the highest number of a pose that a stream may send.
  uint64_t LastPoseSeqToSend(uint64_t poses, const Progress& store) const;
  // Returns the lowest number of a pose that must stay in memory because the store does not have it; UINT64_MAX if
  // there is none.
  uint64_t FirstPoseSeqToKeep() const { return writes_checkpoints_ ? last_pose_seq_ + 1 : UINT64_MAX; }
  // Returns the number of the last item that a restart does not lose.
  uint64_t PersistedSeq(uint64_t processed_seq, const Progress& store) const;
  bool IsEndPersisted(bool has_ended, const Progress& store) const;

  // From now on a checkpoint is due after each item.
  void RequestFlush() { is_flushing_ = true; }
  bool is_flushing() const { return is_flushing_; }
  // Returns whether everything that has been processed has been persisted, and no item is being processed.
  bool IsFlushed(const Counters& now, const Progress& store) const;

  // Poses up to this number have been handed to the committer.
  void RecordPoses(uint64_t last_pose_seq) { last_pose_seq_ = last_pose_seq; }
  void RecordCheckpoint(const Checkpoint& checkpoint) { last_ = checkpoint; }
  uint64_t last_pose_seq() const { return last_pose_seq_; }

 private:
  bool HasProgress(const Counters& now) const;

  const bool writes_checkpoints_;
  Checkpoint last_;         // handed to the committer
  uint64_t last_pose_seq_;  // handed to the committer; may be ahead of Counters::poses after a crash
  bool is_flushing_ = false;
};

}  // namespace evpose::server
