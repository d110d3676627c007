// SPDX-License-Identifier: Apache-2.0
#include "client/bench/chart.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "client/bench/gnuplot.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Okabe and Ito's, which most colour-blind people can tell apart, and three more.
constexpr std::array<const char*, 10> kColors = {"#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00",
                                                 "#56B4E9", "#000000", "#8C564B", "#7F7F7F", "#6A3D9A"};
// gnuplot's numbers: disc, square, triangles, diamond, pentagon, cross; then the hollow ones and an upright cross.
constexpr std::array<int, 14> kMarkers = {7, 5, 9, 13, 11, 15, 2, 6, 4, 8, 12, 10, 14, 1};
constexpr int kNumFullMarkers = 7;

// Around the area of a panel, pixels: what axes, numbers and titles need.
constexpr int kLeftPx = 72;
constexpr int kRightPx = 18;
constexpr int kTopPx = 32;
constexpr int kBottomPx = 52;
constexpr int kTitlePx = 34;
constexpr int kLegendRowPx = 20;
constexpr int kLegendPaddingPx = 16;
constexpr int kLegendSamplePx = 56;
constexpr int kCharacterPx = 8;
constexpr int kMaxPx = 20'000;

struct Look {
  int color = 0;
  int marker = 0;
};

// A name of the legend, with the series that shows how it looks.
struct LegendEntry {
  Look look;
  const ChartSeries* series = nullptr;
};

std::vector<std::string> LegendNames(const ChartPage& page) {
  std::vector<std::string> names;
  for (const ChartPanel& panel : page.panels) {
    for (const ChartSeries& series : panel.series) {
      if (series.name.empty() || std::count(names.begin(), names.end(), series.name) > 0) continue;
      names.push_back(series.name);
    }
  }
  return names;
}

int NumLegendColumns(const ChartPage& page, const std::vector<std::string>& names) {
  size_t longest = 0;
  for (const std::string& name : names) longest = std::max(longest, name.size());
  const int entry_px = kLegendSamplePx + kCharacterPx * static_cast<int>(longest);
  return std::clamp(page.WidthPx() / entry_px, 1, std::max(1, static_cast<int>(names.size())));
}

int LegendPx(const ChartPage& page) {
  const std::vector<std::string> names = LegendNames(page);
  if (names.empty()) return 0;
  const int columns = NumLegendColumns(page, names);
  return kLegendPaddingPx + kLegendRowPx * ((static_cast<int>(names.size()) + columns - 1) / columns);
}

int TitlePx(const ChartPage& page) { return page.title.empty() ? 0 : kTitlePx; }

absl::Status CheckSeries(const ChartSeries& series, const std::string& field) {
  const size_t size = series.x.size();
  const bool has_range = series.style == ChartStyle::kBand || series.style == ChartStyle::kBoxes;
  const size_t range_size = has_range ? size : 0;
  const size_t y_size = series.style == ChartStyle::kBand ? 0 : size;
  if (series.y.size() != y_size || series.low.size() != range_size || series.high.size() != range_size) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s has %d x, %d y, %d low and %d high; its style needs %d, %d, %d and %d", field, size,
                        series.y.size(), series.low.size(), series.high.size(), size, y_size, range_size, range_size));
  }
  if (series.color && (*series.color < 0 || *series.color >= static_cast<int>(kColors.size()))) {
    return absl::InvalidArgumentError(absl::StrCat(field, ".color is ", *series.color, "; there are ", kColors.size()));
  }
  if (series.marker && (*series.marker < 0 || *series.marker >= static_cast<int>(kMarkers.size()))) {
    return absl::InvalidArgumentError(
        absl::StrCat(field, ".marker is ", *series.marker, "; there are ", kMarkers.size()));
  }
  return absl::OkStatus();
}

bool IsDrawn(double value, const ChartAxis& axis) {
  return std::isfinite(value) && (!axis.is_logarithmic || value > 0.0);
}

// Which of the page's lines a point becomes, or an empty line: a gap.
std::string DataLine(const ChartPanel& panel, const ChartSeries& series, size_t i) {
  const bool has_y = series.style != ChartStyle::kBand;
  const bool has_range = !series.low.empty();
  const double y = has_y ? series.y[i] : series.low[i];
  const double low = has_range ? series.low[i] : y;
  const double high = has_range ? series.high[i] : y;
  const bool is_drawn = IsDrawn(series.x[i], panel.x_axis) && IsDrawn(y, panel.y_axis) && IsDrawn(low, panel.y_axis) &&
                        IsDrawn(high, panel.y_axis);
  return is_drawn ? absl::StrFormat("%.10g %.10g %.10g %.10g\n", series.x[i], y, low, high) : "\n";
}

std::string LineStyle(const ChartSeries& series, const Look& look) {
  return absl::StrFormat("lc rgb '%s' lw 1.6%s", kColors[look.color], series.is_dashed ? " dt '_-'" : "");
}

std::string PointStyle(const ChartSeries& series, const Look& look) {
  return absl::StrFormat("pt %d ps %.3g", kMarkers[look.marker], 0.8 * series.marker_scale);
}

// `source`: what the columns x, y, low, high come from.
std::string PlotClause(const std::string& source, const ChartSeries& series, const Look& look,
                       const std::string& title) {
  const std::string line = LineStyle(series, look);
  switch (series.style) {
    case ChartStyle::kLines:
      return absl::StrCat(source, " using 1:2 with lines ", line, " ", title);
    case ChartStyle::kPoints:
      return absl::StrCat(source, " using 1:2 with points ", PointStyle(series, look), " ", line, " ", title);
    case ChartStyle::kLinesAndPoints:
      return absl::StrCat(source, " using 1:2 with linespoints ", PointStyle(series, look), " ", line, " ", title);
    case ChartStyle::kBand:
      return absl::StrFormat("%s using 1:3:4 with filledcurves fc rgb '%s' fs transparent solid 0.25 noborder %s",
                             source, kColors[look.color], title);
    case ChartStyle::kBoxes:
      return absl::StrFormat(
          "%s using 1:3:3:4:4:(%.10g) with candlesticks %s fs transparent solid 0.25 %s, "
          "%s using 1:2:2:2:2:(%.10g) with candlesticks %s notitle",
          source, series.box_width, line, title, source, series.box_width, line);
  }
  return "";
}

class ScriptWriter {
 public:
  explicit ScriptWriter(const ChartPage& page) : page_(page), width_px_(page.WidthPx()), height_px_(page.HeightPx()) {
    for (const ChartPanel& panel : page.panels) {
      for (const ChartSeries& series : panel.series) AddToLegend(series);
    }
  }

  std::string Write(bool is_svg) {
    absl::StrAppendFormat(&script_,
                          "set encoding utf8\nset terminal %s noenhanced size %d,%d font 'DejaVu Sans,10' "
                          "background rgb '#FFFFFF'\nset multiplot\n",
                          is_svg ? "svg" : "pngcairo", width_px_, height_px_);
    WriteTitle();
    for (size_t i = 0; i < page_.panels.size(); ++i) WritePanel(i);
    WriteLegend();
    absl::StrAppend(&script_, "unset multiplot\nunset output\n");
    return std::move(script_);
  }

 private:
  // A name's first series says how all of them look.
  void AddToLegend(const ChartSeries& series) {
    if (legend_.contains(series.name) && !series.name.empty()) return;
    const int number = static_cast<int>(legend_.size());
    const Look look = {series.color.value_or(number % static_cast<int>(kColors.size())),
                       series.marker.value_or(number % kNumFullMarkers)};
    if (!series.name.empty()) legend_[series.name] = {look, &series};
  }

  Look LookOf(const ChartSeries& series) const {
    if (const auto entry = legend_.find(series.name); entry != legend_.end()) return entry->second.look;
    return {series.color.value_or(0), series.marker.value_or(0)};
  }

  void WriteTitle() {
    if (page_.title.empty()) return;
    absl::StrAppendFormat(&script_, "set label 1 %s at screen 0.5, screen %.6f center font 'DejaVu Sans,13'\n",
                          GnuplotQuoted(page_.title), 1.0 - 0.5 * kTitlePx / height_px_);
  }

  // Pixels from the picture's top left corner.
  void WriteMargins(int left_px, int top_px, int right_px, int bottom_px) {
    absl::StrAppendFormat(&script_,
                          "set lmargin at screen %.6f\nset rmargin at screen %.6f\nset tmargin at screen %.6f\n"
                          "set bmargin at screen %.6f\n",
                          static_cast<double>(left_px) / width_px_, static_cast<double>(right_px) / width_px_,
                          1.0 - static_cast<double>(top_px) / height_px_,
                          1.0 - static_cast<double>(bottom_px) / height_px_);
  }

  void WriteAxis(const char* name, const ChartAxis& axis, bool has_points) {
    const auto bound = [](const std::optional<double>& value) {
      return value ? absl::StrFormat("%.10g", *value) : std::string("*");
    };
    absl::StrAppendFormat(&script_, "set %slabel %s\n%s logscale %s\n", name, GnuplotQuoted(axis.label),
                          axis.is_logarithmic ? "set" : "unset", name);
    // Without data the axis needs a range to be drawn at all.
    const std::string low = has_points || axis.min ? bound(axis.min) : "1";
    const std::string high = has_points || axis.max ? bound(axis.max) : "10";
    absl::StrAppendFormat(&script_, "set %srange [%s:%s]\nset format %s '%s'\n", name, low, high, name,
                          axis.is_logarithmic ? "%g" : "%h");
    if (axis.names.empty()) {
      absl::StrAppendFormat(&script_, "set %stics autofreq norotate\n", name);
      return;
    }
    absl::StrAppendFormat(&script_, "set %stics (", name);
    for (size_t i = 0; i < axis.names.size(); ++i) {
      absl::StrAppendFormat(&script_, "%s%s %d", i > 0 ? ", " : "", GnuplotQuoted(axis.names[i]), i);
    }
    absl::StrAppend(&script_, ")\n");
  }

  // True when there is something to draw.
  bool WriteData(const ChartPanel& panel, size_t index) {
    bool has_points = false;
    for (size_t s = 0; s < panel.series.size(); ++s) {
      absl::StrAppendFormat(&script_, "$panel%d_series%d << END\n", index, s);
      for (size_t i = 0; i < panel.series[s].x.size(); ++i) {
        const std::string line = DataLine(panel, panel.series[s], i);
        has_points |= line != "\n";
        script_ += line;
      }
      script_ += "END\n";
    }
    return has_points;
  }

  // Room for the names beside the axis, as far as half of the panel.
  int LeftMarginPx(const ChartPanel& panel) const {
    size_t longest = 0;
    for (const std::string& name : panel.y_axis.names) longest = std::max(longest, name.size());
    const int names_px = kCharacterPx * static_cast<int>(std::min<size_t>(longest, 1000)) + 16;
    return std::clamp(names_px, kLeftPx, std::max(kLeftPx, page_.panel_width_px / 2));
  }

  void WritePanel(size_t index) {
    const ChartPanel& panel = page_.panels[index];
    const bool has_points = WriteData(panel, index);
    const int left_px = static_cast<int>(index) % page_.num_columns * page_.panel_width_px;
    const int top_px = TitlePx(page_) + static_cast<int>(index) / page_.num_columns * page_.panel_height_px;
    WriteMargins(left_px + LeftMarginPx(panel), top_px + kTopPx, left_px + page_.panel_width_px - kRightPx,
                 top_px + page_.panel_height_px - kBottomPx);
    absl::StrAppendFormat(&script_, "set title %s offset 0,-0.4\nset grid lt 1 lc rgb '#E4E4E4' lw 0.8\nset key off\n",
                          GnuplotQuoted(panel.title));
    absl::StrAppend(&script_, panel.is_isometric ? "set size ratio -1\n" : "set size noratio\n");
    WriteAxis("x", panel.x_axis, has_points);
    WriteAxis("y", panel.y_axis, has_points);
    std::vector<std::string> clauses;
    for (size_t s = 0; s < panel.series.size() && has_points; ++s) {
      if (!HasPoints(panel, panel.series[s])) continue;
      clauses.push_back(PlotClause(absl::StrFormat("$panel%d_series%d", index, s), panel.series[s],
                                   LookOf(panel.series[s]), "notitle"));
    }
    if (clauses.empty()) clauses.push_back("NaN notitle");
    absl::StrAppend(&script_, "plot ", absl::StrJoin(clauses, ", \\\n  "), "\nunset label 1\n");
  }

  static bool HasPoints(const ChartPanel& panel, const ChartSeries& series) {
    for (size_t i = 0; i < series.x.size(); ++i) {
      if (DataLine(panel, series, i) != "\n") return true;
    }
    return false;
  }

  // A panel of nothing but the legend.
  void WriteLegend() {
    const std::vector<std::string> names = LegendNames(page_);
    if (names.empty()) return;
    absl::StrAppendFormat(&script_,
                          "unset title\nunset border\nunset tics\nunset grid\nunset xlabel\nunset ylabel\n"
                          "unset logscale\nset size noratio\nset xrange [0:1]\nset yrange [0:1]\n"
                          "set key on horizontal center center Left reverse maxcols %d samplen 3 width 1\n",
                          NumLegendColumns(page_, names));
    WriteMargins(0, height_px_ - LegendPx(page_), width_px_, height_px_);
    script_ += "$nothing << END\n-9 -9 -9 -9\nEND\nplot ";
    for (size_t i = 0; i < names.size(); ++i) {
      const LegendEntry& entry = legend_.at(names[i]);
      absl::StrAppend(&script_, i > 0 ? ", \\\n  " : "",
                      PlotClause("$nothing", *entry.series, entry.look, "title " + GnuplotQuoted(names[i])));
    }
    script_ += "\n";
  }

  const ChartPage& page_;
  const int width_px_;
  const int height_px_;
  std::map<std::string, LegendEntry> legend_;
  std::string script_;
};

}  // namespace

int ChartPage::WidthPx() const { return panel_width_px * std::min<int>(num_columns, static_cast<int>(panels.size())); }

int ChartPage::HeightPx() const {
  const int num_rows = (static_cast<int>(panels.size()) + num_columns - 1) / num_columns;
  return TitlePx(*this) + panel_height_px * num_rows + LegendPx(*this);
}

absl::Status ChartPage::Validate() const {
  if (panels.empty()) return absl::InvalidArgumentError("ChartPage.panels is empty");
  if (num_columns < 1) return absl::InvalidArgumentError(absl::StrCat("ChartPage.num_columns is ", num_columns));
  if (panel_width_px < 2 * (kLeftPx + kRightPx) || panel_height_px < 2 * (kTopPx + kBottomPx)) {
    return absl::InvalidArgumentError(absl::StrCat("ChartPage.panel_width_px and panel_height_px are ", panel_width_px,
                                                   "x", panel_height_px, "; at least ", 2 * (kLeftPx + kRightPx), "x",
                                                   2 * (kTopPx + kBottomPx), " are needed"));
  }
  for (size_t p = 0; p < panels.size(); ++p) {
    for (size_t s = 0; s < panels[p].series.size(); ++s) {
      EVPOSE_RETURN_IF_ERROR(
          CheckSeries(panels[p].series[s], absl::StrCat("ChartPage.panels[", p, "].series[", s, "]")));
    }
  }
  if (WidthPx() > kMaxPx || HeightPx() > kMaxPx) {
    return absl::InvalidArgumentError(absl::StrCat("the picture would be of ", WidthPx(), "x", HeightPx(),
                                                   " pixels; at most ", kMaxPx, " each way are drawn"));
  }
  return absl::OkStatus();
}

absl::StatusOr<ChartFile> ChartFile::Create(const std::string& path) {
  const bool is_svg = absl::EndsWith(path, ".svg");
  if (!is_svg && !absl::EndsWith(path, ".png")) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": a picture's name must end in .png or .svg"));
  }
  // Whether it is there and runs.
  EVPOSE_RETURN_IF_ERROR(RunGnuplot("exit status 0\n").status());
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  return ChartFile(std::move(file), is_svg);
}

absl::Status ChartFile::Write(const ChartPage& page) {
  EVPOSE_RETURN_IF_ERROR(page.Validate());
  EVPOSE_ASSIGN_OR_RETURN(const std::string picture, RunGnuplot(ScriptWriter(page).Write(is_svg_)));
  if (picture.empty()) return absl::InternalError("gnuplot drew nothing, and said nothing");
  EVPOSE_RETURN_IF_ERROR(file_.Append(picture));
  return file_.Commit();
}

}  // namespace evpose::client
