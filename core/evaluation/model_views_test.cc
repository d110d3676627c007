// SPDX-License-Identifier: Apache-2.0
#include "core/evaluation/model_views.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/models/cube_files_testing.h"

namespace evpose {
namespace {

const CameraModel kViewCamera = {
    .width_px = 640, .height_px = 480, .fx_px = 700.0, .fy_px = 700.0, .cx_px = 320.0, .cy_px = 240.0};

ObjectModel ModelOf(const std::string& obj) {
  return ParseObjectModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, ModelFormat::kObj, {}).value();
}

TEST(ModelViews, EachViewOfACubeShowsItsFacesAndDeterminesItsPose) {
  const std::vector<ModelView> views = ViewModel(ModelOf(Cube()), kViewCamera).value();
  ASSERT_EQ(views.size(), 96u);
  for (const ModelView& view : views) {
    // Four edges of one face, seven of two, nine of three.
    EXPECT_THAT(view.elements.size(), testing::AnyOf(4u, 7u, 9u));
    EXPECT_LT(view.weakest_px, 2.0);
    EXPECT_LE(view.deviation_px.maxCoeff(), (1.0 + 1e-9) * view.weakest_px);
    EXPECT_EQ(view.contour_px, 0.0);
    EXPECT_GT(view.length_px, 4.0 * 300.0 / 2.0);
  }
}

TEST(ModelViews, ParallelLinesDoNotDetermineThePose) {
  const ModelView view =
      ViewModelFrom({0, 0, 1}, ModelOf("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nl 1 2\nl 3 4\n"), kViewCamera).value();
  EXPECT_EQ(view.elements.size(), 2u);
  EXPECT_GT(view.weakest_px, 1e3) << "they can move along themselves";
  // The direction is that of the lines, which are horizontal in the image or vertical.
  EXPECT_NEAR(view.weakest.normalized().cwiseAbs().head<2>().maxCoeff(), 1.0, 1e-6);
  EXPECT_GT(view.deviation_px.head<2>().maxCoeff(), 1e3);
  EXPECT_LT(view.deviation_px(2), 1.0) << "their distance in the image shows the depth";
  EXPECT_LT(view.deviation_px(5), 1.0) << "a rotation in the image turns them";
}

TEST(ModelViews, MoreEventsDetermineThePoseBetter) {
  const ObjectModel cube = ModelOf(Cube());
  const double few = ViewModelFrom({1, 2, 3}, cube, kViewCamera, {.events = 100.0})->weakest_px;
  const double many = ViewModelFrom({1, 2, 3}, cube, kViewCamera, {.events = 10'000.0})->weakest_px;
  EXPECT_NEAR(few / many, 10.0, 1e-6);
}

TEST(ModelViews, InvalidOptionsAreNamed) {
  const ObjectModel cube = ModelOf(Cube());
  EXPECT_THAT(ViewModel(cube, kViewCamera, {.num_views = 0}).status().message(), testing::HasSubstr("num_views"));
  EXPECT_THAT(ViewModel(cube, kViewCamera, {.object_px = 0.0}).status().message(), testing::HasSubstr("object_px"));
  EXPECT_FALSE(ViewModel(cube, {}).ok());
}

}  // namespace
}  // namespace evpose
