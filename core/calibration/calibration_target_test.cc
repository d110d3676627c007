// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/calibration_target.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "core/models/object_model.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

ObjectModel ModelOf(const CalibrationTarget& target) {
  const std::string obj = TargetToObj(target);
  auto model = ParseObjectModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, ModelFormat::kObj, {});
  EXPECT_TRUE(model.ok()) << model.status();
  return *std::move(model);
}

double InkAreaMm2(const CalibrationTarget& target) {
  double area = 0.0;
  for (const auto& polygon : target.ink) {
    for (size_t i = 0; i < polygon.size(); ++i) {
      const Eigen::Vector2d &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      area += 0.5 * (a.x() * b.y() - a.y() * b.x());
    }
  }
  return area;
}

TEST(CalibrationTarget, ModelHasTheBordersOfTheInkAsLinesAndNoSymmetry) {
  for (const char* page : {"A4", "a3", "letter", "600x400mm", "200x90"}) {
    const auto target = ParseCalibrationTarget(page);
    ASSERT_TRUE(target.ok()) << target.status();
    const ObjectModel model = ModelOf(*target);
    size_t num_sides = 0;
    for (const auto& polygon : target->ink) num_sides += polygon.size();
    EXPECT_EQ(model.lines.size(), num_sides) << page;
    EXPECT_TRUE(model.curves.empty());
    EXPECT_LE(model.symmetries.size(), 1u) << page;
    EXPECT_FALSE(model.continuous_symmetry.has_value());
    EXPECT_TRUE(model.notices.empty()) << model.notices.front();
    for (const ModelLine& line : model.lines) {
      ASSERT_EQ(line.face_normals.size(), 1u);
      EXPECT_NEAR(line.face_normals[0].z(), 1.0, 1e-9);
    }
  }
}

TEST(CalibrationTarget, FacesAreTheWhitePart) {
  const auto target = ParseCalibrationTarget("A4");
  ASSERT_TRUE(target.ok());
  const ObjectModel model = ModelOf(*target);
  double white_mm2 = 0.0;
  for (const auto& [a, b, c] : model.triangles) {
    const Eigen::Vector3d normal = (model.vertices[b] - model.vertices[a]).cross(model.vertices[c] - model.vertices[a]);
    EXPECT_GT(normal.z(), 0.0);
    white_mm2 += 0.5e6 * normal.z();
  }
  EXPECT_NEAR(white_mm2, 297.0 * 210.0 - InkAreaMm2(*target), 0.05);
}

struct InkEdge {
  size_t polygon = 0;
  Eigen::Vector2d begin, end;

  Eigen::Vector2d Along() const { return (end - begin).normalized(); }
};

std::vector<InkEdge> EdgesOf(const CalibrationTarget& target) {
  std::vector<InkEdge> edges;
  for (size_t i = 0; i < target.ink.size(); ++i) {
    const auto& polygon = target.ink[i];
    for (size_t k = 0; k < polygon.size(); ++k) edges.push_back({i, polygon[k], polygon[(k + 1) % polygon.size()]});
  }
  return edges;
}

double DistanceMm(const Eigen::Vector2d& point, const InkEdge& edge) {
  const Eigen::Vector2d side = edge.end - edge.begin;
  const double at = std::clamp((point - edge.begin).dot(side) / side.squaredNorm(), 0.0, 1.0);
  return (point - edge.begin - at * side).norm();
}

// Edges of the pattern do not cross.
double DistanceMm(const InkEdge& a, const InkEdge& b) {
  return std::min({DistanceMm(a.begin, b), DistanceMm(a.end, b), DistanceMm(b.begin, a), DistanceMm(b.end, a)});
}

TEST(CalibrationTarget, PolygonsAreSixPercentOfThePatternApart) {
  for (const char* page : {"A4", "A3", "letter", "600x400mm", "200x90", "80x80", "80x5000"}) {
    const auto target = ParseCalibrationTarget(page);
    ASSERT_TRUE(target.ok());
    const double shorter_mm = std::min(target->width_mm - 20.0, target->height_mm - 26.0);
    const std::vector<InkEdge> edges = EdgesOf(*target);
    for (const InkEdge& a : edges) {
      for (const InkEdge& b : edges) {
        if (a.polygon == b.polygon) continue;
        EXPECT_GE(DistanceMm(a, b), 0.06 * shorter_mm) << page;
      }
    }
  }
}

// LineSampler would measure two edges as one if the sine of the angle between them is below 0.1 and their distance is
// below 6 px, three of its smallest gates. The image of the sheet is 320 px wide, a quarter of the width of an EVK4.
TEST(CalibrationTarget, NearlyParallelEdgesAreSoFarApartThatTheirEventsAreNotMixedUp) {
  struct Sheet {
    const char* page;
    double apart_px;
  };
  for (const auto& [page, apart_px] :
       {Sheet{"A4", 20.0}, Sheet{"A3", 20.0}, Sheet{"letter", 20.0}, Sheet{"600x400mm", 20.0}, Sheet{"200x90", 11.0}}) {
    const auto target = ParseCalibrationTarget(page);
    ASSERT_TRUE(target.ok());
    const double px_per_mm = 320.0 / target->width_mm;
    const std::vector<InkEdge> edges = EdgesOf(*target);
    for (size_t i = 0; i < edges.size(); ++i) {
      for (size_t j = 0; j < i; ++j) {
        const Eigen::Vector2d a = edges[i].Along(), b = edges[j].Along();
        const double sine = std::abs(a.x() * b.y() - a.y() * b.x());
        EXPECT_GT(sine, 0.007) << page << ": edges " << i << " and " << j << " are parallel";
        if (sine > 0.1) continue;
        EXPECT_GE(px_per_mm * DistanceMm(edges[i], edges[j]), apart_px) << page << " " << i << " " << j;
      }
    }
  }
}

TEST(CalibrationTarget, PdfHasTrueScaleAndCorrectOffsets) {
  const auto target = ParseCalibrationTarget("A4");
  ASSERT_TRUE(target.ok());
  const std::string pdf = TargetToPdf(*target);
  EXPECT_THAT(pdf, HasSubstr("/MediaBox [0 0 841.889764 595.275591]"));
  EXPECT_THAT(pdf, HasSubstr("2.834645669 0 0 2.834645669 0 0 cm"));
  EXPECT_THAT(pdf, HasSubstr("100 mm"));
  EXPECT_THAT(pdf, HasSubstr("/PrintScaling /None"));
  EXPECT_EQ(target->ruler_length_mm, 100.0);
  // Each entry of the table points to the object with its number, and startxref to the table.
  const size_t table = pdf.find("xref\n0 6\n");
  ASSERT_NE(table, std::string::npos);
  for (int number = 1; number <= 5; ++number) {
    int offset = 0;
    ASSERT_TRUE(absl::SimpleAtoi(pdf.substr(table + 9 + size_t{20} * static_cast<size_t>(number), 10), &offset));
    EXPECT_EQ(pdf.substr(offset, 7), std::to_string(number) + " 0 obj");
  }
  EXPECT_THAT(pdf, HasSubstr("startxref\n" + std::to_string(table) + "\n%%EOF"));
}

TEST(CalibrationTarget, RefusesOtherPages) {
  for (const char* page : {"A9", "", "x", "100", "100x", "100x200x300", "nanx200", "1e9x200"}) {
    EXPECT_EQ(ParseCalibrationTarget(page).status().code(), absl::StatusCode::kInvalidArgument) << page;
  }
  EXPECT_THAT(std::string(ParseCalibrationTarget("10x200mm").status().message()), HasSubstr("80 to 5000 mm"));
}

}  // namespace
}  // namespace evpose
