// SPDX-License-Identifier: Apache-2.0

// Windows' events as a part of a saved state, in some six bytes each.
#pragma once

#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/windows/pixel_history.h"

namespace evpose {

// Of a window that begins at `t_begin_us`. Of a polarity it is kept whether it is 0.
void SaveWindowEvents(StateWriter& writer, int64_t t_begin_us, absl::Span<const WindowEvent> events);
// `events` is empty after a failure; else all of [t_begin_us, t_end_us), and at most `max_events`.
void LoadWindowEvents(StateReader& reader, int64_t t_begin_us, int64_t t_end_us, size_t max_events,
                      std::vector<WindowEvent>& events);

}  // namespace evpose
