// SPDX-License-Identifier: Apache-2.0

// What all pages of a source get, prepared while they are open.
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
  // For all pages that are open, and for later ones.
  void Add(std::shared_ptr<const PageOutbox::Prepared> frames);
  // Sends what there is to a page, and later the rest.
  void SendTo(const std::shared_ptr<PageOutbox>& outbox);

 private:
  std::mutex mutex_;
  std::vector<std::shared_ptr<const PageOutbox::Prepared>> frames_ ABSL_GUARDED_BY(mutex_);
  std::vector<std::weak_ptr<PageOutbox>> outboxes_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client
