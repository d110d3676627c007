// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/first_pose_run.h"

#include <algorithm>
#include <utility>

#include "core/association/association.h"
#include "core/base/status_macros.h"
#include "core/events/events_between.h"
#include "core/experiments/tracking/tracking_recordings.h"
#include "core/windows/window_memory.h"

namespace evpose {

absl::Span<const Event> FirstPoseRun::Between(int64_t begin_us, int64_t end_us) const {
  return EventsBetween(events, begin_us, end_us);
}

std::optional<PoseError> FirstPoseRun::ErrorAt(int64_t t_us, const RigidTransform& estimate) const {
  const absl::StatusOr<RigidTransform> truth = Interpolate(inputs.truth, t_us);
  if (!truth.ok()) return std::nullopt;
  return ComparePoses(*inputs.model, inputs.simulation.camera, {}, *truth, estimate);
}

absl::StatusOr<std::unique_ptr<Tracker>> FirstPoseRun::MakeTracker(const TrackerOptions& options,
                                                                   const std::optional<RigidTransform>& given) const {
  ObjectToTrack object;
  object.model = inputs.model;
  object.search_model = search_model;
  object.template_model = template_model;
  object.initial_camera_from_object = given;
  return Tracker::Create({std::move(object)}, inputs.simulation.camera, options, tables);
}

absl::StatusOr<FirstPoseRun> LoadFirstPoseRun(ModelRunInputs inputs, const std::function<bool(double)>& on_progress) {
  FirstPoseRun run;
  run.inputs = std::move(inputs);
  const auto on_events = [&](absl::Span<const Event> events) -> absl::Status {
    run.events.insert(run.events.end(), events.begin(), events.end());
    return absl::OkStatus();
  };
  EVPOSE_RETURN_IF_ERROR(PlayRun(run.inputs.simulation, run.inputs.directory, on_events, on_progress));
  EVPOSE_ASSIGN_OR_RETURN(run.tables, MakeCameraTables(run.inputs.simulation.camera));
  return run;
}

std::vector<PixelEvent> StoredEvents(const FirstPoseRun& run, const TrackerOptions& options, int64_t begin_us,
                                     int64_t t_us) {
  const CameraModel& camera = run.inputs.simulation.camera;
  const InitializationOptions& initialization = options.initialization;
  WindowMemory memory(initialization.memory_us, initialization.max_window_events, initialization.max_events);
  EventWindower windower(options.windows, {camera.width_px, camera.height_px});
  const auto on_window = [&](const EventWindow& window) { memory.Add(window); };
  windower.Add(run.Between(std::max(begin_us, t_us - initialization.memory_us), t_us), on_window);
  windower.Finish(on_window);
  std::vector<PixelEvent> pixel_events;
  for (size_t i = 0; i < memory.size(); ++i) {
    const EventWindow window = memory.At(i);
    for (const WindowEvent& event : window.events) {
      const auto observation = Observe(camera, run.tables->undistortion, event, window.t_mid_us());
      if (!observation) continue;
      pixel_events.push_back(
          {event.t_us, static_cast<float>(observation->u_px), static_cast<float>(observation->v_px), event.polarity});
    }
  }
  return pixel_events;
}

}  // namespace evpose
