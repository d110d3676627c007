// SPDX-License-Identifier: Apache-2.0

// Events as text, one in each line: those of the UZH (t[s] x y p) and Metavision's CSV (x,y,p,t[us]).
#pragma once

#include <optional>
#include <string_view>

#include "client/containers/column_layout.h"
#include "client/containers/container_format.h"

namespace evpose::client {

extern const ContainerFormat kTextFormat;

struct TextLayout {
  ColumnLayout columns;
  std::optional<SensorGeometry> geometry;  // of a line "%geometry:W,H" or, before the events, "W H"
  int64_t time_offset_us = 0;              // of a line "%time_offset_us:N"
  int num_heading_lines = 0;               // lines before the first event, other than empty ones and comments
  bool has_commas = false;
};

// The layout of the events of a text that begins with `prefix`; nullopt if it is not a text with events.
std::optional<TextLayout> FindTextLayout(std::string_view prefix);

}  // namespace evpose::client
