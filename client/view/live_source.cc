// SPDX-License-Identifier: Apache-2.0
#include "client/view/live_source.h"

#include <utility>

#include "client/view/live_view.h"

namespace evpose::client {

std::unique_ptr<PageView> LiveSource::Open(std::shared_ptr<PageOutbox> outbox) {
  return std::make_unique<LiveView>(client_, HelloMessage{false, server_, session_}, std::move(outbox));
}

}  // namespace evpose::client
