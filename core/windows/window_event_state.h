// SPDX-License-Identifier: Apache-2.0

// Serialization of the events of a window, in about six bytes per event.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/windows/pixel_history.h"

namespace evpose {

// Saves the events of a window that begins at `t_begin_us`. Polarities other than 0 are saved as 1.
void SaveWindowEvents(StateWriter& writer, int64_t t_begin_us, absl::Span<const WindowEvent> events);
// Loads them. Fails (reader.status()) if there are more than `max_events` events or if an event lies outside
// [t_begin_us, t_end_us); `events` is then empty.
void LoadWindowEvents(StateReader& reader, int64_t t_begin_us, int64_t t_end_us, size_t max_events,
                      std::vector<WindowEvent>& events);

}  // namespace evpose
