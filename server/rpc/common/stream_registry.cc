// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/common/stream_registry.h"

#include <mutex>
#include <utility>

namespace evpose::server {

void StreamRegistry::Add(Kind kind, const std::shared_ptr<OpenStream>& stream) {
  absl::Status ended;
  {
    const std::lock_guard lock(mutex_);
    entries_[stream.get()] = {kind, stream};
    if (kind == Kind::kTrack) ++num_tracks_;
    ended = ended_;
  }
  if (!ended.ok()) stream->End(ended);
}

void StreamRegistry::Remove(const OpenStream* stream) {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(stream);
  if (found == entries_.end()) return;
  if (found->second.kind == Kind::kTrack) --num_tracks_;
  entries_.erase(found);
  removed_.notify_all();
}

std::vector<std::shared_ptr<OpenStream>> StreamRegistry::Streams(bool only_tracks) {
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<OpenStream>> streams;
  for (const auto& [key, entry] : entries_) {
    if (only_tracks && entry.kind != Kind::kTrack) continue;
    if (auto stream = entry.stream.lock()) streams.push_back(std::move(stream));
  }
  return streams;
}

void StreamRegistry::GoAway(absl::Duration deadline) {
  for (const auto& stream : Streams(/*only_tracks=*/true)) stream->GoAway(deadline);
}

void StreamRegistry::WaitForTracks(absl::Time deadline) {
  std::unique_lock lock(mutex_);
  removed_.wait_until(lock, absl::ToChronoTime(deadline), [this] { return num_tracks_ == 0; });
}

void StreamRegistry::WaitForAll(absl::Time deadline) {
  std::unique_lock lock(mutex_);
  removed_.wait_until(lock, absl::ToChronoTime(deadline), [this] { return entries_.empty(); });
}

void StreamRegistry::CheckAccess(const AccessCheck& check) {
  for (const auto& stream : Streams(/*only_tracks=*/false)) stream->CheckAccess(check);
}

void StreamRegistry::EndAll(const absl::Status& status) {
  {
    const std::lock_guard lock(mutex_);
    ended_ = status;
  }
  for (const auto& stream : Streams(/*only_tracks=*/false)) stream->End(status);
}

}  // namespace evpose::server
