// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/findability.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/models/cube_files_testing.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

const CameraModel kFindCamera = {
    .width_px = 640, .height_px = 480, .fx_px = 700.0, .fy_px = 700.0, .cx_px = 320.0, .cy_px = 240.0};

ObjectModel FindModel(const std::string& obj) {
  return ParseObjectModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, ModelFormat::kObj, {}).value();
}

// A closed box with the corners (0, 0, 0) and (x, y, z); `first` is the number of vertices before.
std::string Box(double x, double y, double z, int first = 0, double at_x = 0.0, double at_y = 0.0, double at_z = 0.0) {
  std::string obj;
  for (int i = 0; i < 8; ++i) {
    absl::StrAppend(&obj, "v ", at_x + (i & 1 ? x : 0.0), " ", at_y + (i & 2 ? y : 0.0), " ", at_z + (i & 4 ? z : 0.0),
                    "\n");
  }
  const int faces[6][4] = {{1, 3, 4, 2}, {5, 6, 8, 7}, {1, 2, 6, 5}, {3, 7, 8, 4}, {1, 5, 7, 3}, {2, 4, 8, 6}};
  for (const auto& face : faces) {
    absl::StrAppend(&obj, "f");
    for (const int corner : face) absl::StrAppend(&obj, " ", first + corner);
    absl::StrAppend(&obj, "\n");
  }
  return obj;
}

TEST(Findability, ACubeIsFoundFromAllSidesAndHasNoRival) {
  const std::vector<ViewFindability> views = PredictFindability(FindModel(Cube()), kFindCamera).value();
  ASSERT_EQ(views.size(), 96u);
  for (const ViewFindability& view : views) {
    EXPECT_TRUE(view.rivals.empty()) << "half turns are symmetries of a cube";
    EXPECT_GT(view.edge_px, 600.0);
    EXPECT_GE(view.smallest_px, 40.0);
    EXPECT_LT(view.smallest_px, 120.0);
  }
}

// Median over the views of the share of differing edges of the most similar rival.
double MedianOfLeastShares(const ObjectModel& model) {
  std::vector<double> least;
  const std::vector<ViewFindability> views = PredictFindability(model, kFindCamera).value();
  for (const ViewFindability& view : views) {
    EXPECT_EQ(view.rivals.size(), 3u);
    double share = 1.0;
    for (const HalfTurnRival& rival : view.rivals) {
      EXPECT_NEAR(rival.axis.norm(), 1.0, 1e-9);
      EXPECT_LE(rival.differing_share, 1.0);
      share = std::min(share, rival.differing_share);
    }
    least.push_back(share);
  }
  return UpperMedian(least);
}

TEST(Findability, ANearlySymmetricBoxIsConfusedWithItsHalfTurns) {
  // A small box at one end of a large one: it has no symmetry, and only the small box tells the ends apart.
  const double nearly = MedianOfLeastShares(FindModel(Box(0.2, 0.1, 0.06) + Box(0.01, 0.02, 0.02, 8, 0.2, 0.02, 0.01)));
  // A tall box beside a flat one: the half turns move most of the edges.
  const double unlike = MedianOfLeastShares(FindModel(Box(0.2, 0.1, 0.06) + Box(0.05, 0.05, 0.2, 8, 0.0, 0.1, 0.0)));
  EXPECT_GT(nearly, 0.0);
  EXPECT_LT(nearly, 0.5 * unlike);
}

TEST(Findability, AViewWithoutEnoughEdgesHasNoSmallestSize) {
  // Two parallel lines do not determine a pose from any side.
  const ObjectModel model = FindModel("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nl 1 2\nl 3 4\n");
  const std::vector<ViewFindability> views = PredictFindability(model, kFindCamera).value();
  for (const ViewFindability& view : views) {
    EXPECT_TRUE(std::isinf(view.smallest_px));
  }
}

// The edges of a cube as dashes: as much edge, but no line of the detector's least length until the cube is large.
TEST(Findability, ShortLinesAreNotFound) {
  constexpr int kDashes = 8;
  std::string dashed;
  int num_vertices = 0;
  const ObjectModel cube = FindModel(Cube());
  for (const ModelLine& line : cube.lines) {
    for (int i = 0; i < kDashes; ++i) {
      for (const double end : {i + 0.15, i + 0.85}) {
        const Eigen::Vector3d point = line.p1 + end / kDashes * (line.p2 - line.p1);
        absl::StrAppend(&dashed, "v ", point.x(), " ", point.y(), " ", point.z(), "\n");
      }
      absl::StrAppend(&dashed, "l ", num_vertices + 1, " ", num_vertices + 2, "\n");
      num_vertices += 2;
    }
  }
  const std::vector<ViewFindability> views = PredictFindability(FindModel(dashed), kFindCamera).value();
  for (const ViewFindability& view : views) EXPECT_GT(view.smallest_px, 8 * 20.0);
}

TEST(Findability, InvalidOptionsAreNamed) {
  const ObjectModel cube = FindModel(Cube());
  EXPECT_THAT(PredictFindability(cube, kFindCamera, {.min_edge_px = 0.0}).status().message(),
              testing::HasSubstr("min_edge_px"));
  EXPECT_THAT(PredictFindability(cube, kFindCamera, {.min_line_px = 0.0}).status().message(),
              testing::HasSubstr("min_line_px"));
  EXPECT_THAT(PredictFindability(cube, kFindCamera, {.size_step = 1.0}).status().message(),
              testing::HasSubstr("size_step"));
  EXPECT_FALSE(PredictFindability(cube, {}).ok());
}

}  // namespace
}  // namespace evpose
