// SPDX-License-Identifier: Apache-2.0
#include "client/view/shared_frames.h"

#include <utility>

namespace evpose::client {

void SharedFrames::Add(std::shared_ptr<const PageOutbox::Prepared> frames) {
  const std::lock_guard lock(mutex_);
  for (const std::weak_ptr<PageOutbox>& each : outboxes_) {
    if (const std::shared_ptr<PageOutbox> outbox = each.lock()) outbox->Add(frames);
  }
  frames_.push_back(std::move(frames));
}

void SharedFrames::SendTo(const std::shared_ptr<PageOutbox>& outbox) {
  const std::lock_guard lock(mutex_);
  for (const std::shared_ptr<const PageOutbox::Prepared>& each : frames_) outbox->Add(each);
  std::erase_if(outboxes_, [](const std::weak_ptr<PageOutbox>& each) { return each.expired(); });
  outboxes_.push_back(outbox);
}

}  // namespace evpose::client
