#include "server/sessions/tracker_factory.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

#include "server/sessions/testing.h"

namespace evpose::server {
namespace {

CameraModel SomeCamera() { return SomeConfig().camera; }

TEST(SharedCameraTablesTest, OneCameraHasOneTable) {
  SharedCameraTables shared;
  const auto first = shared.Get(SomeCamera());
  ASSERT_TRUE(first.ok()) << first.status();
  EXPECT_EQ(*shared.Get(SomeCamera()), *first);
}

TEST(SharedCameraTablesTest, AnotherCameraHasAnother) {
  SharedCameraTables shared;
  const auto first = shared.Get(SomeCamera()).value();
  CameraModel turned = SomeCamera();
  turned.distortion[3] = 1e-3;
  const auto second = shared.Get(turned).value();
  EXPECT_NE(second, first);
  EXPECT_NE(second->undistortion.Bearing(0, 0), first->undistortion.Bearing(0, 0));
}

TEST(SharedCameraTablesTest, TablesGoWithTheLastThatUsesThem) {
  SharedCameraTables shared;
  std::weak_ptr<const CameraTables> watched;
  {
    const auto first = shared.Get(SomeCamera()).value();
    const auto second = shared.Get(SomeCamera()).value();
    watched = first;
    EXPECT_EQ(first.use_count(), 2);
  }
  EXPECT_TRUE(watched.expired());
  EXPECT_TRUE(shared.Get(SomeCamera()).ok());  // made anew
}

TEST(SharedCameraTablesTest, ACameraThatIsWrongIsNamedAndNotKept) {
  SharedCameraTables shared;
  CameraModel wrong = SomeCamera();
  wrong.fx_px = 0.0;
  EXPECT_EQ(shared.Get(wrong).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(shared.Get(wrong).status().message().find("camera_matrix"), absl::string_view::npos)
      << shared.Get(wrong).status();
}

TEST(SharedCameraTablesTest, ManyThreadsGetTheSame) {
  SharedCameraTables shared;
  std::vector<std::shared_ptr<const CameraTables>> got(8);
  std::vector<std::thread> threads;
  for (auto& tables : got) threads.emplace_back([&] { tables = shared.Get(SomeCamera()).value(); });
  for (std::thread& thread : threads) thread.join();
  for (const auto& tables : got) EXPECT_EQ(tables, got.front());
}

}  // namespace
}  // namespace evpose::server
