// SPDX-License-Identifier: Apache-2.0

// How late a stream is: since when its oldest unprocessed piece should have been processed.
#pragma once

#include <cstdint>
#include <deque>
#include <mutex>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"

namespace evpose::client {

// Thread-safe.
class DueTimes {
 public:
  // The lag is exact to this time: pieces within it share an entry, so that an outage of hours needs little memory.
  static constexpr absl::Duration kStep = absl::Milliseconds(100);

  // Piece `seq`, with a number above the previous ones, should be processed at `due`.
  void Add(uint64_t seq, absl::Time due);
  // Returns for how long the oldest piece after `processed_seq` has been due; zero if none is.
  absl::Duration Lag(uint64_t processed_seq, absl::Time now);

 private:
  struct Pieces {
    uint64_t last_seq = 0;
    absl::Time due;  // of the first one
  };

  std::mutex mutex_;
  std::deque<Pieces> pieces_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client
