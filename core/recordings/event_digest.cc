// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/event_digest.h"

#include "core/base/byte_order.h"
#include "core/base/state_io.h"

namespace evpose {

void EventDigest::Add(absl::Span<const Event> events) {
  StateWriter packed;
  for (const Event& event : events) packed(event.t_us, event.x, event.y, event.polarity);
  const std::string bytes = packed.Take();
  digest_.Update(AsBytes(bytes));
}

}  // namespace evpose
