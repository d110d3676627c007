// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/watchers.h"

#include <algorithm>
#include <utility>

namespace evpose::server {
namespace {

// Told in one turn of the side thread: each may serialise a page of poses.
constexpr size_t kWatchersPerTurn = 16;

}  // namespace

void Watchers::Add(std::weak_ptr<SessionListener> watcher) {
  const std::lock_guard lock(mutex_);
  // Nothing may change for long, while watchers come and go.
  if (!is_under_way_ && watchers_.size() == watchers_.capacity()) {
    ForgetGone();
    watchers_.reserve(2 * watchers_.size() + 1);
  }
  watchers_.push_back(std::move(watcher));
}

void Watchers::Notify() {
  const std::lock_guard lock(mutex_);
  if (is_under_way_) {
    has_changed_again_ = true;
  } else if (!watchers_.empty()) {
    is_under_way_ = true;
    Post();
  }
}

size_t Watchers::size() const {
  const std::lock_guard lock(mutex_);
  return watchers_.size();
}

void Watchers::ForgetGone() {
  std::erase_if(watchers_, [](const std::weak_ptr<SessionListener>& watcher) { return watcher.expired(); });
}

void Watchers::Post() {
  pool_.PostAside([self = shared_from_this()] { self->Turn(); });
}

void Watchers::Turn() {
  for (const auto& watcher : NextFew()) watcher->OnSessionChanged();
  const std::lock_guard lock(mutex_);
  if (next_ < watchers_.size()) return Post();
  next_ = 0;
  ForgetGone();
  is_under_way_ = std::exchange(has_changed_again_, false) && !watchers_.empty();
  if (is_under_way_) Post();
}

std::vector<std::shared_ptr<SessionListener>> Watchers::NextFew() {
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<SessionListener>> few;
  const size_t end = std::min(next_ + kWatchersPerTurn, watchers_.size());
  for (; next_ < end; ++next_) {
    if (auto watcher = watchers_[next_].lock()) few.push_back(std::move(watcher));
  }
  return few;
}

}  // namespace evpose::server
