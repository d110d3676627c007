// SPDX-License-Identifier: Apache-2.0

// Pages of charts, drawn by the gnuplot program.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/output_file.h"

namespace evpose::client {

enum class ChartStyle {
  kLines,
  kPoints,
  kLinesAndPoints,
  kBand,   // a shade from low to high
  kBoxes,  // a box from low to high with a bar at y
};

// The points are drawn in their order. One that is not finite, or not above 0 on a logarithmic axis, is left out, and
// a line has a gap there.
struct ChartSeries {
  // In the page's legend, once. Series of the same name look the same in all panels. Empty: not in the legend.
  std::string name;
  ChartStyle style = ChartStyle::kLines;
  std::vector<double> x;
  std::vector<double> y;     // as many as x; of kBand: none
  std::vector<double> low;   // of kBand and kBoxes: as many as x
  std::vector<double> high;  // likewise
  // Which of ten colours, and which of seven markers, first the full and then the hollow ones (7 to 13); without: each
  // name of the page has its own.
  std::optional<int> color;
  std::optional<int> marker;
  double marker_scale = 1.0;
  bool is_dashed = false;
  double box_width = 0.5;  // of kBoxes, in units of x
};

struct ChartAxis {
  std::string label;  // with its unit
  bool is_logarithmic = false;
  std::optional<double> min;  // without: from the data
  std::optional<double> max;
  std::vector<std::string> names;  // not empty: stand at 0, 1, 2, ... in place of numbers
};

struct ChartPanel {
  std::string title;
  ChartAxis x_axis;
  ChartAxis y_axis;
  std::vector<ChartSeries> series;
  bool is_isometric = false;  // a unit of x is as long as one of y: for paths seen from above
};

struct ChartPage {
  std::string title;               // empty: none
  std::vector<ChartPanel> panels;  // row by row
  int num_columns = 1;
  int panel_width_px = 480;
  int panel_height_px = 320;

  // INVALID_ARGUMENT naming the field: no panel, a series with arrays of different lengths, and the like.
  absl::Status Validate() const;
  // Of the picture: the panels, and strips for the title above and the legend below, where there are any.
  int WidthPx() const;
  int HeightPx() const;
};

// A picture that is written whole or not at all. Made before a long computation, so that it is not in vain.
class ChartFile {
 public:
  // INVALID_ARGUMENT unless `path` ends in .png or .svg; FAILED_PRECONDITION without the program gnuplot, saying what
  // to install; those of OutputFile.
  static absl::StatusOr<ChartFile> Create(const std::string& path);

  // Once. Errors: those of Validate(); INTERNAL with gnuplot's message when it fails; those of OutputFile.
  absl::Status Write(const ChartPage& page);

 private:
  ChartFile(OutputFile file, bool is_svg) : file_(std::move(file)), is_svg_(is_svg) {}

  OutputFile file_;
  bool is_svg_;
};

}  // namespace evpose::client
