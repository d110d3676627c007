// SPDX-License-Identifier: Apache-2.0
#include "core/numerics/connected_cells.h"

#include <algorithm>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace evpose {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

// Cells marked by '#'; the cells of each group in ascending order.
std::vector<std::vector<size_t>> SortedGroups(const std::vector<std::string>& rows) {
  std::vector<bool> is_set;
  for (const std::string& row : rows) {
    for (const char cell : row) is_set.push_back(cell == '#');
  }
  auto groups = ConnectedCells(static_cast<int>(rows[0].size()), static_cast<int>(rows.size()), is_set);
  for (auto& group : groups) {
    EXPECT_EQ(group[0], *std::min_element(group.begin(), group.end()));
    std::sort(group.begin(), group.end());
  }
  return groups;
}

TEST(ConnectedCellsTest, ConnectsCellsAtSidesAndCorners) {
  EXPECT_THAT(SortedGroups({"#...#",  //
                            ".#..#",  //
                            "#...."}),
              ElementsAre(ElementsAre(0, 6, 10), ElementsAre(4, 9)));
}

TEST(ConnectedCellsTest, TheEndsOfRowsAreNotNeighbours) {
  EXPECT_THAT(SortedGroups({"..#",  //
                            "...",  //
                            "#.."}),
              ElementsAre(ElementsAre(2), ElementsAre(6)));
  EXPECT_THAT(SortedGroups({"..#",  //
                            "#.."}),
              ElementsAre(ElementsAre(2), ElementsAre(3)));
}

TEST(ConnectedCellsTest, AGroupMayTurnBack) {
  EXPECT_THAT(SortedGroups({"#.#",  //
                            "#.#",  //
                            ".#."}),
              ElementsAre(ElementsAre(0, 2, 3, 5, 7)));
}

TEST(ConnectedCellsTest, EveryCellIsInOneGroup) {
  EXPECT_THAT(SortedGroups({"...", "..."}), IsEmpty());
  const auto groups = SortedGroups(std::vector<std::string>(40, std::string(30, '#')));
  ASSERT_EQ(groups.size(), 1u);
  ASSERT_EQ(groups[0].size(), 1200u);
  for (size_t i = 0; i < groups[0].size(); ++i) ASSERT_EQ(groups[0][i], i);
}

}  // namespace
}  // namespace evpose
