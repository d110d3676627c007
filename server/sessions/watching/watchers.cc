// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/watching/watchers.h"

#include <algorithm>
#include <utility>

#include "server/runtime/out_of_memory.h"

namespace evpose::server {
void Watchers::Add(std::weak_ptr<SessionListener> watcher) {
  const std::lock_guard lock(mutex_);
  // A session may not change for a long time while watchers come and go.
  if (!is_in_round_ && watchers_.size() == watchers_.capacity()) {
    RemoveDestroyed();
    watchers_.reserve(2 * watchers_.size() + 1);
  }
  watchers_.push_back(std::move(watcher));
}

void Watchers::Notify() {
  const std::lock_guard lock(mutex_);
  if (is_in_round_) {
    has_changed_again_ = true;
  } else if (!watchers_.empty()) {
    Post();
  }
}

size_t Watchers::size() const {
  const std::lock_guard lock(mutex_);
  return watchers_.size();
}

void Watchers::RemoveDestroyed() {
  std::erase_if(watchers_, [](const std::weak_ptr<SessionListener>& watcher) { return watcher.expired(); });
}

void Watchers::Post() {
  const auto turn = [self = shared_from_this()] { self->CallSome(); };
  const absl::Status posted = OrOutOfMemory([this, &turn] {
    if (tenant_.has_value()) {
      pool_.images().Post(*tenant_, [turn](const absl::Status&) { turn(); });
    } else {
      pool_.PostLowPriority(turn);
    }
    return absl::OkStatus();
  });
  is_in_round_ = posted.ok();
  if (!is_in_round_) next_ = 0;
}

void Watchers::CallSome() {
  for (const auto& watcher : NextOnes()) {
    RunUnlessOutOfMemory([&watcher] { watcher->OnSessionChanged(); });
  }
  const std::lock_guard lock(mutex_);
  if (next_ < watchers_.size()) return Post();
  next_ = 0;
  RemoveDestroyed();
  is_in_round_ = false;
  if (std::exchange(has_changed_again_, false) && !watchers_.empty()) Post();
}

absl::InlinedVector<std::shared_ptr<SessionListener>, Watchers::kWatchersPerTurn> Watchers::NextOnes() {
  const std::lock_guard lock(mutex_);
  absl::InlinedVector<std::shared_ptr<SessionListener>, kWatchersPerTurn> ones;
  const size_t count = tenant_.has_value() ? kImagesPerTurn : kWatchersPerTurn;
  const size_t end = std::min(next_ + count, watchers_.size());
  for (; next_ < end; ++next_) {
    if (auto watcher = watchers_[next_].lock()) ones.push_back(std::move(watcher));
  }
  return ones;
}

}  // namespace evpose::server
