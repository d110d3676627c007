// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/calibration_target.h"

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"

namespace evpose {
namespace {

using Eigen::Vector2d;

// The pattern in the unit square, y upwards. It has no symmetry, and long edges in many directions, no two of them
// exactly parallel, so that a pose without a prior has one solution. The gaps between polygons are at least 6 % of its
// shorter side, and those between nearly parallel edges are larger (README, section 1): their events are not mixed up.
const std::vector<std::vector<Vector2d>>& UnitPattern() {
  static const auto& pattern = *new std::vector<std::vector<Vector2d>>{
      {{0.00, 0.97}, {0.04, 0.64}, {0.30, 0.58}, {0.38, 1.00}},
      {{0.47, 0.98}, {0.385, 0.55}, {0.68, 0.95}},
      {{0.77, 1.00}, {0.62, 0.64}, {0.97, 0.50}, {1.00, 0.94}},
      {{0.00, 0.53}, {0.05, 0.00}, {0.27, 0.45}},
      {{0.38, 0.46}, {0.17, 0.07}, {0.70, 0.03}, {0.62, 0.53}},
      {{0.71, 0.49}, {0.80, 0.00}, {1.00, 0.02}, {0.96, 0.38}},
  };
  return pattern;
}

// Margins of the pattern, millimetres: most printers reach all but 5 mm. The ruler is below the pattern.
constexpr double kSideMarginMm = 10.0;
constexpr double kLowerMarginMm = 16.0;
constexpr double kRulerHeightMm = 7.0;
constexpr double kRulerStepMm = 10.0;
constexpr double kMaxRulerMm = 100.0;
constexpr double kPointsPerMm = 72.0 / 25.4;  // the unit of PDF

struct NamedPage {
  const char* name;
  double width_mm;
  double height_mm;
};
constexpr NamedPage kPages[] = {{"a4", 297.0, 210.0}, {"a3", 420.0, 297.0}, {"letter", 279.4, 215.9}};

// Divides the white part of a sheet into triangles: trapezoids between the levels of all corners. An edge that crosses
// a level has a vertex there, on both sides, so that neighbours share their vertices.
class WhiteTriangles {
 public:
  explicit WhiteTriangles(const CalibrationTarget& target) {
    AddPolygon({{0.0, 0.0}, {target.width_mm, 0.0}, {target.width_mm, target.height_mm}, {0.0, target.height_mm}});
    for (const auto& polygon : target.ink) AddPolygon(polygon);
    std::vector<double> levels;
    for (const Vector2d& corner : corners_) levels.push_back(corner.y());
    std::sort(levels.begin(), levels.end());
    levels.erase(std::unique(levels.begin(), levels.end()), levels.end());
    for (size_t i = 0; i + 1 < levels.size(); ++i) AddLayer(levels[i], levels[i + 1]);
  }

  const std::vector<Vector2d>& points() const { return points_; }
  const std::vector<std::array<size_t, 3>>& triangles() const { return triangles_; }
  size_t IndexOf(const Vector2d& point) {
    const auto [at, is_new] = index_.try_emplace({point.x(), point.y()}, points_.size());
    if (is_new) points_.push_back(point);
    return at->second;
  }

 private:
  struct Side {
    Vector2d low;
    Vector2d high;
    // The end points exactly, so that sides with a common corner share a vertex.
    Vector2d At(double y) const {
      if (y == low.y()) return low;
      if (y == high.y()) return high;
      return {low.x() + (y - low.y()) / (high.y() - low.y()) * (high.x() - low.x()), y};
    }
  };

  void AddPolygon(const std::vector<Vector2d>& polygon) {
    for (size_t i = 0; i < polygon.size(); ++i) {
      Vector2d low = polygon[i], high = polygon[(i + 1) % polygon.size()];
      corners_.push_back(low);
      if (low.y() == high.y()) continue;
      if (low.y() > high.y()) std::swap(low, high);
      sides_.push_back({low, high});
    }
  }

  void AddLayer(double low, double high) {
    std::vector<const Side*> crossing;
    for (const Side& side : sides_) {
      if (side.low.y() <= low && side.high.y() >= high) crossing.push_back(&side);
    }
    const double middle = 0.5 * (low + high);
    std::sort(crossing.begin(), crossing.end(),
              [&](const Side* a, const Side* b) { return a->At(middle).x() < b->At(middle).x(); });
    // The sheet is white outside the ink: the parts between an odd side and the next one.
    for (size_t i = 0; i + 1 < crossing.size(); i += 2) {
      AddTrapezoid(ChainAt(low, *crossing[i], *crossing[i + 1]), ChainAt(high, *crossing[i], *crossing[i + 1]));
    }
  }

  // Returns the vertices of a level from one side to the other.
  std::vector<size_t> ChainAt(double y, const Side& left, const Side& right) {
    std::vector<Vector2d> chain = {left.At(y), right.At(y)};
    for (const Vector2d& corner : corners_) {
      if (corner.y() == y && corner.x() > chain[0].x() && corner.x() < chain[1].x()) chain.push_back(corner);
    }
    std::sort(chain.begin(), chain.end(), [](const Vector2d& a, const Vector2d& b) { return a.x() < b.x(); });
    std::vector<size_t> indices;
    for (const Vector2d& point : chain) {
      const size_t index = IndexOf(point);
      if (indices.empty() || indices.back() != index) indices.push_back(index);
    }
    return indices;
  }

  // Counter-clockwise triangles between two chains, each of which has its next vertex on the shorter diagonal's side.
  void AddTrapezoid(const std::vector<size_t>& low, const std::vector<size_t>& high) {
    for (size_t i = 0, j = 0; i + 1 < low.size() || j + 1 < high.size();) {
      const bool has_low = i + 1 < low.size(), has_high = j + 1 < high.size();
      const bool takes_low = has_low && (!has_high || (points_[low[i + 1]] - points_[high[j]]).norm() <=
                                                          (points_[high[j + 1]] - points_[low[i]]).norm());
      if (takes_low) {
        triangles_.push_back({low[i], low[i + 1], high[j]});
        ++i;
      } else {
        triangles_.push_back({low[i], high[j + 1], high[j]});
        ++j;
      }
    }
  }

  std::vector<Vector2d> corners_;
  std::vector<Side> sides_;
  std::vector<Vector2d> points_;
  std::map<std::pair<double, double>, size_t> index_;
  std::vector<std::array<size_t, 3>> triangles_;
};

// Operators of a PDF page, in points of 1/72 inch.
std::string PdfDrawing(const CalibrationTarget& target) {
  // The transformation from millimetres; black for areas, lines and text; hairlines of 0.2 mm.
  std::string drawing = absl::StrFormat("%.9f 0 0 %.9f 0 0 cm\n0 g 0 G 0.2 w\n", kPointsPerMm, kPointsPerMm);
  for (const auto& polygon : target.ink) {
    for (size_t i = 0; i < polygon.size(); ++i) {
      absl::StrAppendFormat(&drawing, "%.6f %.6f %s\n", polygon[i].x(), polygon[i].y(), i == 0 ? "m" : "l");
    }
    drawing += "h f\n";
  }
  const Vector2d& ruler = target.ruler_mm;
  absl::StrAppendFormat(&drawing, "%.6f %.6f m %.6f %.6f l S\n", ruler.x(), ruler.y(),
                        ruler.x() + target.ruler_length_mm, ruler.y());
  for (double x = 0.0; x <= target.ruler_length_mm + 1e-9; x += kRulerStepMm) {
    absl::StrAppendFormat(&drawing, "%.6f %.6f m %.6f %.6f l S\n", ruler.x() + x, ruler.y() - 1.0, ruler.x() + x,
                          ruler.y() + 1.0);
  }
  absl::StrAppendFormat(&drawing,
                        "BT /F1 2.6 Tf %.6f %.6f Td (%g mm: measure it. Print at 100 %%, keep the sheet flat.) Tj ET\n",
                        ruler.x() + target.ruler_length_mm + 4.0, ruler.y() - 1.0, target.ruler_length_mm);
  return drawing;
}

}  // namespace

absl::StatusOr<CalibrationTarget> MakeCalibrationTarget(double width_mm, double height_mm) {
  for (const double side : {width_mm, height_mm}) {
    if (side >= kMinSheetMm && side <= kMaxSheetMm) continue;
    return absl::InvalidArgumentError(absl::StrFormat("a sheet of %g x %g mm: each side must be %g to %g mm", width_mm,
                                                      height_mm, kMinSheetMm, kMaxSheetMm));
  }
  CalibrationTarget target{width_mm, height_mm, {}, {}, 0.0};
  const Vector2d origin(kSideMarginMm, kLowerMarginMm);
  const Vector2d size(width_mm - 2.0 * kSideMarginMm, height_mm - kLowerMarginMm - kSideMarginMm);
  for (const auto& polygon : UnitPattern()) {
    std::vector<Vector2d>& ink = target.ink.emplace_back();
    for (const Vector2d& corner : polygon) ink.push_back(origin + corner.cwiseProduct(size));
  }
  target.ruler_mm = {kSideMarginMm, kRulerHeightMm};
  while (target.ruler_length_mm + kRulerStepMm <= std::min(kMaxRulerMm, 0.5 * width_mm)) {
    target.ruler_length_mm += kRulerStepMm;
  }
  return target;
}

absl::StatusOr<CalibrationTarget> ParseCalibrationTarget(const std::string& page) {
  const std::string name = absl::AsciiStrToLower(page);
  for (const NamedPage& known : kPages) {
    if (name == known.name) return MakeCalibrationTarget(known.width_mm, known.height_mm);
  }
  const std::vector<absl::string_view> sides = absl::StrSplit(absl::StripSuffix(name, "mm"), 'x');
  double width_mm = 0.0, height_mm = 0.0;
  if (sides.size() != 2 || !absl::SimpleAtod(sides[0], &width_mm) || !absl::SimpleAtod(sides[1], &height_mm)) {
    return absl::InvalidArgumentError(
        absl::StrCat("\"", page, "\" is not a page: A4, A3, letter, or WIDTHxHEIGHT in millimetres such as 600x400mm"));
  }
  return MakeCalibrationTarget(width_mm, height_mm);
}

std::string TargetToObj(const CalibrationTarget& target) {
  WhiteTriangles white(target);
  std::string lines;
  for (const auto& polygon : target.ink) {
    for (size_t i = 0; i < polygon.size(); ++i) {
      absl::StrAppendFormat(&lines, "l %d %d\n", white.IndexOf(polygon[i]) + 1,
                            white.IndexOf(polygon[(i + 1) % polygon.size()]) + 1);
    }
  }
  std::string obj = absl::StrFormat("%s%g x %g mm, in metres\n", kTargetObjBegin, target.width_mm, target.height_mm);
  for (const Vector2d& point : white.points()) {
    absl::StrAppendFormat(&obj, "v %.9f %.9f 0\n", 1e-3 * (point.x() - 0.5 * target.width_mm),
                          1e-3 * (point.y() - 0.5 * target.height_mm));
  }
  for (const auto& [a, b, c] : white.triangles()) absl::StrAppendFormat(&obj, "f %d %d %d\n", a + 1, b + 1, c + 1);
  return obj + lines;
}

std::string TargetToPdf(const CalibrationTarget& target) {
  const std::string drawing = PdfDrawing(target);
  const std::string objects[] = {
      // Viewers must not fit the page to the paper (ISO 32000-1, 12.2).
      "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
      "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
      absl::StrFormat("<< /Type /Page /Parent 2 0 R /MediaBox [0 0 %.6f %.6f] /Contents 4 0 R "
                      "/Resources << /Font << /F1 5 0 R >> >> >>",
                      kPointsPerMm * target.width_mm, kPointsPerMm * target.height_mm),
      absl::StrCat("<< /Length ", drawing.size(), " >>\nstream\n", drawing, "endstream"),
      "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
  };
  std::string pdf = "%PDF-1.6\n";
  std::string table = "0000000000 65535 f \n";
  int number = 0;
  for (const std::string& object : objects) {
    absl::StrAppendFormat(&table, "%010d 00000 n \n", pdf.size());
    absl::StrAppend(&pdf, ++number, " 0 obj\n", object, "\nendobj\n");
  }
  const size_t table_at = pdf.size();
  absl::StrAppend(&pdf, "xref\n0 ", number + 1, "\n", table, "trailer\n<< /Size ", number + 1,
                  " /Root 1 0 R >>\nstartxref\n", table_at, "\n%%EOF\n");
  return pdf;
}

}  // namespace evpose
