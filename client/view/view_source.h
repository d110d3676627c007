// SPDX-License-Identifier: Apache-2.0

// A source of sessions or of a recording, and its view for each page.
#pragma once

#include <memory>

#include "client/view/page_messages.h"
#include "client/view/page_outbox.h"

namespace evpose::client {

// The view of one page. It is destroyed when the page has left, on a thread that may wait.
class PageView {
 public:
  virtual ~PageView() = default;
  // Answers a message of the page, other than key and ack. Must not wait. Error: INVALID_ARGUMENT for a message that
  // this source does not accept; the page is then closed.
  virtual absl::Status Handle(const PageRequest& request) = 0;
};

class ViewSource {
 public:
  virtual ~ViewSource() = default;
  // Opens a view that sends messages to a new page, `hello` first. Must not wait.
  virtual std::unique_ptr<PageView> Open(std::shared_ptr<PageOutbox> outbox) = 0;
};

}  // namespace evpose::client
