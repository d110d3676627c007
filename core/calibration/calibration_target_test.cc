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

TEST(CalibrationTarget, EdgesOfDifferentPolygonsAreFarApart) {
  const auto target = ParseCalibrationTarget("A4");
  ASSERT_TRUE(target.ok());
  double nearest_mm = 1e9;
  for (size_t i = 0; i < target->ink.size(); ++i) {
    for (size_t j = 0; j < target->ink.size(); ++j) {
      if (i == j) continue;
      for (const Eigen::Vector2d& corner : target->ink[i]) {
        const auto& other = target->ink[j];
        for (size_t k = 0; k < other.size(); ++k) {
          const Eigen::Vector2d side = other[(k + 1) % other.size()] - other[k];
          const double at = std::clamp((corner - other[k]).dot(side) / side.squaredNorm(), 0.0, 1.0);
          nearest_mm = std::min(nearest_mm, (corner - other[k] - at * side).norm());
        }
      }
    }
  }
  // At 1 px/mm, which is the whole sheet in a quarter of the width of an EVK4, this is more than two gates of 4 px.
  EXPECT_GT(nearest_mm, 10.0);
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
