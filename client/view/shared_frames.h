// SPDX-License-Identifier: Apache-2.0

// The messages that all pages of a source receive. They may be prepared while pages are open.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "client/view/page_outbox.h"

namespace evpose::client {

// Thread-safe.
class SharedFrames {
 public:
  // Sends the frames to all pages that are open, and to each page that opens later.
  void Add(std::shared_ptr<const PageOutbox::Prepared> frames);
  // Sends the present frames to a page, and later ones when they are added.
  void SendTo(const std::shared_ptr<PageOutbox>& outbox);

 private:
  std::mutex mutex_;
  std::vector<std::shared_ptr<const PageOutbox::Prepared>> frames_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::weak_ptr<PageOutbox>> outboxes_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client
