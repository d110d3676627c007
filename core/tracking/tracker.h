// SPDX-License-Identifier: Apache-2.0

// Tracks the poses of one or several objects from a stream of events: windows, prediction, association, estimation,
// health (core/README.md).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/base/state_io.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/models/object_model.h"
#include "core/tracking/object/object_outline.h"
#include "core/tracking/object/object_to_track.h"
#include "core/tracking/object/pose_estimate.h"
#include "core/tracking/object/track_phase.h"
#include "core/windows/event_window.h"

namespace evpose {

struct CameraTables;

// Declared in tracker_options.h, with unit, default and reason of each field.
struct TrackerOptions;

// Turns a stream of events into pose estimates.
class PoseSource {
 public:
  virtual ~PoseSource() = default;

  // Processes events in order of time (a step back is tolerated: such an event belongs to the open window). Appends the
  // estimates of all windows that these events close, by window, then by object. An object that is LOST or INITIALIZING
  // has no estimate.
  virtual void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) = 0;
  // Ends the stream: closes the open window.
  virtual void Finish(std::vector<PoseEstimate>& estimates) = 0;
};

// Tracks the objects of one stream of events, window by window; all objects share the windows (EventWindower). Not
// thread-safe. Deterministic: the estimates depend only on the events and the options and not on how the events are
// divided into calls. Memory is bounded at any event rate.
class Tracker : public PoseSource {
 public:
  // Creates a tracker of one or more objects; PoseEstimate::object_index is the index in `objects`. `tables` are those
  // of the camera; null: computed here. INVALID_ARGUMENT names the field of the options, of the camera or of the object
  // that is wrong.
  static absl::StatusOr<std::unique_ptr<Tracker>> Create(std::vector<ObjectToTrack> objects, const CameraModel& camera,
                                                         const TrackerOptions& options,
                                                         std::shared_ptr<const CameraTables> tables = nullptr);
  // Creates a tracker of one object.
  static absl::StatusOr<std::unique_ptr<Tracker>> Create(
      std::shared_ptr<const ObjectModel> model, const CameraModel& camera, const TrackerOptions& options,
      const std::optional<RigidTransform>& initial_camera_from_object);

  // Reports that the clock of the sensor has reached t_us without further events (a TimeMark): the windows that end at
  // or before this time close.
  virtual void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) = 0;
  // Discards these events and those of the open window. The clock of the sensor has reached t_us, and the next window
  // begins at the end of the gap. Discarded events are no evidence of motion or rest: the uncertainty of each object
  // grows with time, and the object is LOST when it exceeds HealthOptions::max_uncertainty_px.
  virtual EventGap Skip(absl::Span<const Event> events, int64_t t_us) = 0;
  // Restarts the object from this pose at the present time.
  virtual void ResetPose(size_t object_index, const RigidTransform& camera_from_object) = 0;

  // Reports the transitions of all objects and hypotheses (core/tracking/README.md, section 3) from now on. They have
  // no influence on the estimates. A tracker without phases reports nothing.
  virtual void SetPhaseListener(const PhaseListener& listener) { (void)listener; }

  virtual size_t num_objects() const = 0;
  virtual TrackState state(size_t object_index) const = 0;
  virtual InitializationReport initialization(size_t object_index) const = 0;
  virtual uint32_t losses(size_t object_index) const = 0;  // changes to LOST so far

  // Replaces `outline` by the visible edges of an object at its latest pose; returns false if it has none. The edges of
  // an `outline` from an earlier call for the object are kept while its pose is the latest one, so that they are copied
  // once for each window. After the state was loaded, the edges are missing until the next window. The default is a
  // tracker that has no edges.
  virtual bool Outline(size_t object_index, ObjectOutline& outline) const {
    (void)object_index, (void)outline;
    return false;
  }

  // Writes and reads all that later estimates depend on, bit for bit. A state is loaded into a tracker with the same
  // objects, camera and options, before any other call; after a failure (reader.status()) the tracker must not be used.
  virtual void SaveState(StateWriter& writer) const = 0;
  virtual void LoadState(StateReader& reader) = 0;

  // The same for the first object.
  void ResetPose(const RigidTransform& camera_from_object) { ResetPose(0, camera_from_object); }
  TrackState state() const { return state(0); }
  InitializationReport initialization() const { return initialization(0); }
  uint32_t losses() const { return losses(0); }
};

}  // namespace evpose
