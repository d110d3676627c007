// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/tracker_factory.h"

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "core/tracking/tracker.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

std::shared_ptr<const ObjectModel> Cube() {
  return std::make_shared<const ObjectModel>(
      ParseObjectModel({reinterpret_cast<const uint8_t*>(kCubeObj), sizeof(kCubeObj) - 1}, ModelFormat::kObj, {})
          .value());
}

SessionConfig CubeConfig() {
  SessionConfig config = SomeConfig();
  config.objects[0].initial_camera_from_object->translation_m.z() = 0.5;
  return config;
}

TEST(TrackerFactoryTest, TrackersOfOneModelShareItsPreparedData) {
  const TrackerFactory make_tracker = MakeTrackerFactory();
  const auto model = Cube();
  const auto first = make_tracker(CubeConfig(), {model});
  ASSERT_TRUE(first.ok()) << first.status();
  const long uses_of_first = model.use_count() - 1;
  const auto second = make_tracker(CubeConfig(), {model});
  ASSERT_TRUE(second.ok()) << second.status();
  // The data that both trackers share reference the model, too: its edges, and those of its search.
  EXPECT_EQ(model.use_count(), 1 + uses_of_first + uses_of_first - 2);
}

TEST(TrackerFactoryTest, DataOfAnUntrackedModelAreReleased) {
  const TrackerFactory make_tracker = MakeTrackerFactory();
  const auto model = Cube();
  ASSERT_TRUE(make_tracker(CubeConfig(), {model}).ok());
  EXPECT_EQ(model.use_count(), 1);
}

TEST(TrackerFactoryTest, AModelThatDeterminesNoPoseIsNamed) {
  ObjectModel two_lines;
  two_lines.diameter_m = 1.0;
  two_lines.lines = {{{0, 0, 0}, {1, 0, 0}, {}}, {{0, 0, 0}, {0, 1, 0}, {}}};
  const auto tracker = MakeTrackerFactory()(CubeConfig(), {std::make_shared<const ObjectModel>(two_lines)});
  EXPECT_EQ(tracker.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(tracker.status().message().find("config.objects[0].model: the model has 2 distinct lines"),
            absl::string_view::npos)
      << tracker.status();
}

TEST(TrackerFactoryTest, ACameraThatIsWrongIsNamed) {
  SessionConfig config = CubeConfig();
  config.camera.fx_px = 0.0;
  const auto tracker = MakeTrackerFactory()(config, {Cube()});
  EXPECT_EQ(tracker.status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(tracker.status().message().find("camera_matrix"), absl::string_view::npos) << tracker.status();
}

}  // namespace
}  // namespace evpose::server
