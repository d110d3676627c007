// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/scene.h"

#include <algorithm>
#include <cmath>

#include "client/lib/messages/conversion.h"
#include "client/lib/messages/core_types.h"
#include "core/estimation/ideal_events_testing.h"
#include "server/sessions/session_testing.h"

namespace evpose::bench {
namespace {

constexpr double kCubeEdgeM = 0.2;  // edge of server::kCubeObj

RigidTransform CubeAt(double t_s) {
  // The cube swings back and forth, so that the scene may have any duration.
  const double phase = 2.0 * std::sin(1.1 * t_s);
  return testing::MakePose({0.03 * std::sin(1.7 * t_s), 0.02 * std::sin(2.3 * t_s), 0.8},
                           {0.6 + 0.2 * std::sin(1.3 * t_s), 0.5 + 0.1 * phase, 0.2});
}

}  // namespace

Scene MakeScene(double duration_s, double rate_hz) {
  const CameraModel camera = testing::MakeCamera(640, 480, 600.0);
  testing::IdealEventOptions options;
  options.duration_us = static_cast<int64_t>(1e6 * duration_s);
  options.clutter_per_s = 0.0;
  options.events_per_px2 = 1.0;
  const auto cube = testing::MakeCube(kCubeEdgeM);
  const size_t unthinned = testing::MakeIdealEvents(*cube, camera, CubeAt, options).size();
  options.events_per_px2 = std::min(2.0, 0.5 * rate_hz * duration_s / static_cast<double>(unthinned));
  options.clutter_per_s = 0.5 * rate_hz;
  const std::vector<Event> events = testing::MakeIdealEvents(*cube, camera, CubeAt, options);

  Scene scene;
  scene.model_obj = server::kCubeObj;
  scene.config = client::ToProto(client::SessionConfig{
      .encoding = client::EventEncoding::kFlat64,
      .camera = client::FromCore(camera),
      .objects = {{.object_id = "cube", .initial_camera_from_object = client::FromCore(CubeAt(0.0))}}});
  scene.num_events = events.size();
  scene.chunks.resize(static_cast<size_t>(std::ceil(1e3 * duration_s)));
  for (const Event& event : events) {
    const auto ms = std::min(static_cast<size_t>(event.t_us / 1000), scene.chunks.size() - 1);
    scene.chunks[ms] += server::Flat64({event});
  }
  return scene;
}

}  // namespace evpose::bench
