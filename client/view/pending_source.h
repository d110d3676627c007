// SPDX-License-Identifier: Apache-2.0

// The source of the pages while the files of a recording (poses, models, camera) are still being read.
#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "client/view/view_source.h"

namespace evpose::client {

// Tells the pages which files are being read, until Provide() sets the source that is shown instead. Thread-safe.
class PendingSource : public ViewSource {
 public:
  // Sends `hello` first to each page, then `notice`, which states what is being read.
  PendingSource(const HelloMessage& hello, const std::string& notice) : hello_(hello), notice_(notice) {}

  std::unique_ptr<PageView> Open(std::shared_ptr<PageOutbox> outbox) override;
  // Shows `source`, which must outlive the views, to all pages.
  void Provide(ViewSource& source);

 private:
  class View;

  const HelloMessage hello_;
  const std::string notice_;
  std::mutex mutex_;
  ViewSource* source_ ABSL_GUARDED_BY(mutex_) = nullptr;
  std::vector<View*> waiting_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::client
