// SPDX-License-Identifier: Apache-2.0

// A recording of a model file in which first poses are searched for, in memory.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/association/camera_tables.h"
#include "core/detection/line_detector.h"
#include "core/events/event.h"
#include "core/experiments/first_pose/pose_comparison.h"
#include "core/experiments/tracking/model_run.h"
#include "core/initialization/search_model.h"
#include "core/initialization/templates/template_model.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"

namespace evpose {

struct FirstPoseRun {
  ModelRunInputs inputs;
  std::vector<Event> events;
  std::shared_ptr<const SearchModel> search_model;  // null if the lines determine no pose
  std::shared_ptr<const TemplateModel> template_model;
  std::shared_ptr<const CameraTables> tables;
  bool is_absent = false;  // the recording shows another object

  absl::Span<const Event> Between(int64_t begin_us, int64_t end_us) const;
  // nullopt outside the recording.
  std::optional<PoseError> ErrorAt(int64_t t_us, const RigidTransform& estimate) const;
  bool IsRight(const PoseError& error) const { return !is_absent && error.is_right(); }
  // A tracker of the object, without a prior or from a pose at its first event. Errors: those of Tracker::Create().
  absl::StatusOr<std::unique_ptr<Tracker>> MakeTracker(const TrackerOptions& options,
                                                       const std::optional<RigidTransform>& given = std::nullopt) const;
};

// The models are not set. Errors: those of PlayRun() and MakeCameraTables().
absl::StatusOr<FirstPoseRun> LoadFirstPoseRun(ModelRunInputs inputs, const std::function<bool(double)>& on_progress);

// The events that a tracker which has received those since `begin_us` would search in at `t_us`.
std::vector<PixelEvent> StoredEvents(const FirstPoseRun& run, const TrackerOptions& options, int64_t begin_us,
                                     int64_t t_us);

}  // namespace evpose
