// SPDX-License-Identifier: Apache-2.0
#include "core/models/collinear_lines.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>
#include <random>

namespace evpose {
namespace {

using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr double kTolerance = 1e-4;

class RandomLines {
 public:
  explicit RandomLines(uint32_t seed) : random_(seed) {}

  double Uniform(double low, double high) { return low + (high - low) * static_cast<double>(random_()) / 4294967295.0; }
  Eigen::Vector3d Point() { return {Uniform(0, 10), Uniform(0, 10), Uniform(0, 10)}; }

  // Parts of some straight lines, long and short, and lines that are part of none.
  std::vector<ModelLine> Make(int num_straight, int num_parts, int num_others) {
    std::vector<ModelLine> lines;
    for (int i = 0; i < num_straight; ++i) {
      const Eigen::Vector3d from = Point(), to = Point();
      for (int part = 0; part < num_parts; ++part) {
        const double begin = Uniform(0, 1), length = Uniform(0.001, 0.4);
        lines.push_back({from + begin * (to - from), from + (begin + length) * (to - from), {}});
      }
    }
    for (int i = 0; i < num_others; ++i) {
      const Eigen::Vector3d from = Point();
      lines.push_back({from, from + 0.05 * (Point() - Point()), {}});
    }
    std::shuffle(lines.begin(), lines.end(), random_);
    return lines;
  }

 private:
  std::mt19937 random_;
};

// The number of groups if all pairs are compared.
size_t GroupsOfAllPairs(const std::vector<ModelLine>& lines, double min_overlap) {
  std::vector<size_t> group(lines.size());
  std::iota(group.begin(), group.end(), size_t{0});
  for (size_t i = 0; i < lines.size(); ++i) {
    for (size_t j = i + 1; j < lines.size(); ++j) {
      if (JoinCollinear({{lines[i], lines[j]}}, kTolerance, min_overlap, false).size() == 2) continue;
      const size_t from = group[j], to = group[i];
      std::replace(group.begin(), group.end(), from, to);
    }
  }
  std::sort(group.begin(), group.end());
  return std::unique(group.begin(), group.end()) - group.begin();
}

TEST(CollinearLinesTest, FindsWhatAllPairsGive) {
  for (uint32_t seed = 1; seed <= 4; ++seed) {
    const std::vector<ModelLine> lines = RandomLines(seed).Make(15, 6, 60);
    for (const double min_overlap : {kTolerance, -kTolerance}) {
      const size_t groups = GroupsOfAllPairs(lines, min_overlap);
      EXPECT_LT(groups, lines.size());
      EXPECT_THAT(JoinCollinear(lines, kTolerance, min_overlap, false), SizeIs(groups)) << "seed " << seed;
    }
  }
}

TEST(CollinearLinesTest, OneLongLineAmongMany) {
  std::vector<ModelLine> lines = RandomLines(9).Make(0, 0, 3000);
  lines.push_back({{0, 0, 5}, {10, 10, 5}, {}});
  lines.push_back({{7, 7, 5}, {7.001, 7.001, 5}, {}});
  const size_t before = lines.size();
  std::vector<std::string> notices;
  MergeOverlapping(kTolerance, lines, notices);
  EXPECT_THAT(lines, SizeIs(before - 1));
  EXPECT_EQ(lines.back().p2, Eigen::Vector3d(10, 10, 5));
}

TEST(CollinearLinesTest, ManyLinesInOnePlaceEnd) {
  // 20,000 different lines through one point: all pairs are near each other.
  std::vector<ModelLine> lines;
  RandomLines random(3);
  for (int i = 0; i < 20'000; ++i) lines.push_back({{5, 5, 5}, random.Point(), {}});
  EXPECT_THAT(JoinCollinear(lines, kTolerance, kTolerance, false), SizeIs(testing::Le(20'000u)));
  EXPECT_THAT(JoinCollinear({}, kTolerance, kTolerance, false), IsEmpty());
}

}  // namespace
}  // namespace evpose
