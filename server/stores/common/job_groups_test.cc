// SPDX-License-Identifier: Apache-2.0
#include "server/stores/common/job_groups.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace evpose::server {
namespace {

using testing::ElementsAre;

TEST(JobGroupsTest, AGroupHasAtMostItsBytesOrOneJob) {
  constexpr uint64_t kMost = kMaxGroupBytes;
  std::vector<uint64_t> sizes = {kMost - 1, 1, 1, kMost + 1, kMost + 1, 2, 3};
  std::vector<std::vector<uint64_t>> groups;
  ForEachGroup(
      sizes, [](uint64_t size) { return size; },
      [&groups](absl::Span<uint64_t> group) { groups.emplace_back(group.begin(), group.end()); });
  EXPECT_THAT(groups, ElementsAre(ElementsAre(kMost - 1, 1), ElementsAre(1), ElementsAre(kMost + 1),
                                  ElementsAre(kMost + 1), ElementsAre(2, 3)));
}

TEST(JobGroupsTest, WithoutJobsThereIsNoGroup) {
  std::vector<uint64_t> none;
  ForEachGroup(
      none, [](uint64_t size) { return size; }, [](absl::Span<uint64_t>) { FAIL(); });
}

}  // namespace
}  // namespace evpose::server
