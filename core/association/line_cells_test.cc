// SPDX-License-Identifier: Apache-2.0
#include "core/association/line_cells.h"

#include <gtest/gtest.h>

#include <vector>

#include "core/estimation/ideal_events_testing.h"

namespace evpose {
namespace {

TEST(LineCellsTest, TheBorderIsWhereTheOtherLineBecomesNearer) {
  // A parallel line 6 px away, from the point on the line and from one 1 px off it, and the line itself moving away.
  EXPECT_DOUBLE_EQ(CellBoundaryPx(0.0, 6.0, -1.0), 3.0);
  EXPECT_DOUBLE_EQ(CellBoundaryPx(1.0, 5.0, -1.0), 3.0);
  EXPECT_DOUBLE_EQ(CellBoundaryPx(1.0, -5.0, 1.0), 3.0);
  EXPECT_GT(CellBoundaryPx(1.0, 7.0, 1.0), 1e6);
  // A perpendicular line: its distance does not change.
  EXPECT_DOUBLE_EQ(CellBoundaryPx(1.0, 5.0, 0.0), 5.0);
}

// Vertical lines of 100 px.
class LineCellsGridTest : public ::testing::Test {
 protected:
  void Find(const std::vector<double>& columns_px) {
    std::vector<TrackedLine> tracked;
    for (const double u_px : columns_px) {
      const double x = (u_px - camera_.cx_px) / 1000.0;
      tracked.push_back({static_cast<int>(tracked.size()), {x, -0.05, 1.0}, {x, 0.05, 1.0}});
    }
    ProjectLines(camera_, MotionState(), tracked, lines_);
    TileGrid grid(camera_);
    grid.Build(lines_, 12.0);
    FindCells(grid, lines_, cells_);
  }
  double AreaPx2(size_t line) const { return GateAreaPx2(cells_, lines_, line, 8.0); }

  const CameraModel camera_ = testing::MakeCamera(640, 480, 1000.0);
  std::vector<ImageLine> lines_;
  std::vector<LineCell> cells_;
};

TEST_F(LineCellsGridTest, ADistantLineHasItsWholeGate) {
  Find({200.0, 300.0});
  EXPECT_NEAR(AreaPx2(0), 1600.0, 1.0);
  EXPECT_NEAR(AreaPx2(1), 1600.0, 1.0);
}

TEST_F(LineCellsGridTest, DenseLinesShareTheUnionOfTheirGates) {
  Find({300.0, 305.0, 310.0, 315.0});
  EXPECT_NEAR(AreaPx2(1), 500.0, 1.0);
  EXPECT_NEAR(AreaPx2(0), 1050.0, 1.0);
  EXPECT_NEAR(AreaPx2(0) + AreaPx2(1) + AreaPx2(2) + AreaPx2(3), (8.0 + 15.0 + 8.0) * 100.0, 1.0);
}

}  // namespace
}  // namespace evpose
