// SPDX-License-Identifier: Apache-2.0

// The open streams of a server, which notifies, awaits and ends them when it shuts down.
#pragma once

#include <condition_variable>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "server/auth/authenticator.h"

namespace evpose::server {

class OpenStream {
 public:
  virtual ~OpenStream() = default;
  // Sends the notice GoAway, if it is a Track stream.
  virtual void GoAway(absl::Duration deadline) = 0;
  // Ends the stream with this error.
  virtual void End(const absl::Status& status) = 0;
  // Ends the stream with UNAUTHENTICATED if its caller is no longer admitted (StillAdmitted() in authentication.h).
  virtual void CheckAccess(const AccessCheck& check) = 0;
};

// Thread-safe.
class StreamRegistry {
 public:
  enum class Kind { kTrack, kWatch, kUpload };

  // After EndAll() the stream is ended immediately.
  void Add(Kind kind, const std::shared_ptr<OpenStream>& stream);
  void Remove(const OpenStream* stream);

  // Sends GoAway to all Track streams.
  void GoAway(absl::Duration deadline);
  // Returns when no Track stream is left, or at the deadline.
  void WaitForTracks(absl::Time deadline);
  // Returns when no stream of any kind is left, or at the deadline.
  void WaitForAll(absl::Time deadline);
  // Calls CheckAccess() of all streams.
  void CheckAccess(const AccessCheck& check);
  // Ends all streams, also those that are added later.
  void EndAll(const absl::Status& status);

 private:
  struct Entry {
    Kind kind;
    std::weak_ptr<OpenStream> stream;
  };
  std::vector<std::shared_ptr<OpenStream>> Streams(bool only_tracks);

  std::mutex mutex_;
  std::condition_variable removed_;
  std::unordered_map<const OpenStream*, Entry> entries_ ABSL_GUARDED_BY(mutex_);
  int num_tracks_ ABSL_GUARDED_BY(mutex_) = 0;
  absl::Status ended_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
