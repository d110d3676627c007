// SPDX-License-Identifier: Apache-2.0

// The size of an image or a sensor as text.
#pragma once

#include <optional>
#include <string_view>

#include "core/events/event.h"

namespace evpose {

// The size of "1280x720"; nullopt if the text is no two positive numbers of pixels.
std::optional<SensorGeometry> ParseImageSize(std::string_view text);

}  // namespace evpose
