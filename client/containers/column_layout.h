// SPDX-License-Identifier: Apache-2.0

// The columns of a table that hold the time, position and polarity of its events.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/types/span.h"

namespace evpose::client {

struct ColumnLayout {
  int t = 0;
  int x = 1;
  int y = 2;
  int p = 3;
  int time_exponent = 6;  // the time's unit is 10^(time_exponent - 6) s: 6 for seconds, 0 for microseconds

  // The names of the columns in their order: "t x y p".
  std::string Describe() const;
  int num_columns() const;  // number of columns that a row must have

  friend bool operator==(const ColumnLayout&, const ColumnLayout&) = default;
};

using TableRow = std::array<double, 4>;

// The layout that the names of the columns state, such as x, y, p (pol, polarity), t (ts, time, timestamp). The name of
// the time may have a unit as in t_us, t[s]; without one the unit is that of UnitOfTimes(). nullopt if a column is
// missing or unclear.
std::optional<ColumnLayout> LayoutOfNames(absl::Span<const std::string> names, absl::Span<const double> times);
// Whether a name is that of one of the four columns.
bool IsEventColumn(std::string_view name);
// Whether the values in the four columns can be an event: the time is finite, x and y are integers from 0 to 65535, and
// p is 0, 1 or -1.
bool IsEventRow(const ColumnLayout& layout, const TableRow& row);

// The layout of rows without names, of "t x y p", "x y p t" and "x y t p": the one that fits the most rows, with x and
// y integers from 0 on and p 0 or 1, or -1 or 1. If several fit as many, it is the first of those in which the time
// steps back least often. nullopt if none fits more than half of the rows; the others may be damaged.
std::optional<ColumnLayout> LayoutOfRows(absl::Span<const TableRow> rows);

// 0, 1 and -1 are polarities.
bool IsPolarity(double value);

// The name of the unit of a ColumnLayout::time_exponent: "s", "ms", "us" or "ns".
const char* TimeUnit(int time_exponent);

// Seconds (6) if a time has a fraction, else microseconds (0). A value that is not a number, such as nan, is not a
// time.
int UnitOfTimes(absl::Span<const double> times);

}  // namespace evpose::client
