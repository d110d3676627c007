// SPDX-License-Identifier: Apache-2.0
#include "client/containers/column_layout.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/ascii.h"

namespace evpose::client {
namespace {

enum class Column { kTime, kX, kY, kPolarity, kOther };

struct NamedColumn {
  Column column = Column::kOther;
  std::optional<int> time_exponent;  // if the name states the unit
};

// The part of a name before its unit: "t" of "t_us", "t [s]", "t(us)".
NamedColumn ReadName(std::string_view text) {
  const std::string name = absl::AsciiStrToLower(absl::string_view(text.data(), text.size()));
  const size_t unit_begin = name.find_first_of("[(_ ");
  const std::string base = name.substr(0, unit_begin);
  NamedColumn result;
  if (base == "x") result.column = Column::kX;
  if (base == "y") result.column = Column::kY;
  if (base == "p" || base == "pol" || base == "polarity" || base == "polarities") result.column = Column::kPolarity;
  if (base == "t" || base == "ts" || base == "time" || base == "timestamp" || base == "timestamps") {
    result.column = Column::kTime;
  }
  if (unit_begin == std::string::npos || result.column != Column::kTime) return result;
  std::string unit;
  for (const char c : name.substr(unit_begin)) {
    if (absl::ascii_isalpha(static_cast<unsigned char>(c))) unit += c;
  }
  if (unit == "s" || unit == "sec" || unit == "seconds") result.time_exponent = 6;
  if (unit == "ms") result.time_exponent = 3;
  if (unit == "us" || unit == "usec" || unit == "microseconds") result.time_exponent = 0;
  if (unit == "ns" || unit == "nsec" || unit == "nanoseconds") result.time_exponent = -3;
  return result;
}

bool IsAddress(double value) { return value >= 0.0 && value < 65536.0 && value == std::floor(value); }

struct LayoutFit {
  size_t num_fitting = 0;  // rows that can be events
  size_t backsteps = 0;    // number of steps back of their times
};

LayoutFit CheckLayout(const ColumnLayout& layout, absl::Span<const TableRow> rows) {
  const auto time = static_cast<size_t>(layout.t);
  LayoutFit fit;
  const TableRow* before = nullptr;
  for (const TableRow& row : rows) {
    if (!IsEventRow(layout, row)) continue;
    ++fit.num_fitting;
    fit.backsteps += before != nullptr && row[time] < (*before)[time];
    before = &row;
  }
  return fit;
}

}  // namespace

std::string ColumnLayout::Describe() const {
  std::vector<std::pair<int, char>> columns = {{t, 't'}, {x, 'x'}, {y, 'y'}, {p, 'p'}};
  std::sort(columns.begin(), columns.end());
  std::string text;
  for (const auto& [column, name] : columns) {
    if (!text.empty()) text += ' ';
    text += name;
  }
  return text;
}

int ColumnLayout::num_columns() const { return std::max({t, x, y, p}) + 1; }

bool IsEventRow(const ColumnLayout& layout, const TableRow& row) {
  const auto at = [&row](int column) { return row[static_cast<size_t>(column)]; };
  return std::isfinite(at(layout.t)) && IsAddress(at(layout.x)) && IsAddress(at(layout.y)) && IsPolarity(at(layout.p));
}

bool IsEventColumn(std::string_view name) { return ReadName(name).column != Column::kOther; }

std::optional<ColumnLayout> LayoutOfNames(absl::Span<const std::string> names, absl::Span<const double> times) {
  ColumnLayout layout = {-1, -1, -1, -1, UnitOfTimes(times)};
  for (size_t i = 0; i < names.size(); ++i) {
    const NamedColumn named = ReadName(names[i]);
    if (named.column == Column::kOther) continue;
    int& column = named.column == Column::kTime ? layout.t
                  : named.column == Column::kX  ? layout.x
                  : named.column == Column::kY  ? layout.y
                                                : layout.p;
    if (column >= 0) return std::nullopt;  // two columns of one name
    column = static_cast<int>(i);
    if (named.time_exponent) layout.time_exponent = *named.time_exponent;
  }
  if (std::min({layout.t, layout.x, layout.y, layout.p}) < 0) return std::nullopt;
  return layout;
}

std::optional<ColumnLayout> LayoutOfRows(absl::Span<const TableRow> rows) {
  std::optional<ColumnLayout> best;
  LayoutFit best_fit;
  for (ColumnLayout layout : {ColumnLayout{0, 1, 2, 3}, ColumnLayout{3, 0, 1, 2}, ColumnLayout{2, 0, 1, 3}}) {
    const LayoutFit fit = CheckLayout(layout, rows);
    const bool is_better = fit.num_fitting > best_fit.num_fitting ||
                           (fit.num_fitting == best_fit.num_fitting && fit.backsteps < best_fit.backsteps);
    if (2 * fit.num_fitting <= rows.size() || !is_better) continue;
    best_fit = fit;
    std::vector<double> times;
    for (const TableRow& row : rows) {
      if (IsEventRow(layout, row)) times.push_back(row[static_cast<size_t>(layout.t)]);
    }
    layout.time_exponent = UnitOfTimes(times);
    best = layout;
  }
  return best;
}

bool IsPolarity(double value) { return value == 0.0 || value == 1.0 || value == -1.0; }

const char* TimeUnit(int time_exponent) {
  if (time_exponent == 6) return "s";
  if (time_exponent == 3) return "ms";
  return time_exponent == 0 ? "us" : "ns";
}

int UnitOfTimes(absl::Span<const double> times) {
  const auto has_fraction = [](double t) { return std::isfinite(t) && t != std::floor(t); };
  return std::any_of(times.begin(), times.end(), has_fraction) ? 6 : 0;
}

}  // namespace evpose::client
