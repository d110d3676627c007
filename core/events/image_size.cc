// SPDX-License-Identifier: Apache-2.0
#include "core/events/image_size.h"

#include <algorithm>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"

namespace evpose {

std::optional<SensorGeometry> ParseImageSize(std::string_view text) {
  const std::vector<absl::string_view> sides = absl::StrSplit(absl::string_view(text.data(), text.size()), 'x');
  SensorGeometry size;
  const bool is_size =
      sides.size() == 2 && absl::SimpleAtoi(sides[0], &size.width_px) && absl::SimpleAtoi(sides[1], &size.height_px);
  if (!is_size || std::min(size.width_px, size.height_px) <= 0) return std::nullopt;
  return size;
}

}  // namespace evpose
