// SPDX-License-Identifier: Apache-2.0

// The source of the pages that show a recording with its poses.
#pragma once

#include <map>
#include <memory>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "absl/status/statusor.h"
#include "client/view/recorded_events.h"
#include "client/view/recorded_poses.h"
#include "client/view/shared_frames.h"
#include "client/view/view_source.h"
#include "core/association/visible_edges.h"
#include "core/geometry/camera.h"
#include "core/models/object_model.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {

struct RecordingObject {
  std::string id;
  std::string model_name;
  ObjectModel model;
};

struct RecordingInputs {
  std::string path;
  std::unique_ptr<RecordingReader> reader;  // of the path
  CameraModel camera;
  std::vector<RecordingObject> objects;
  std::map<std::string, RecordedPoses> poses;  // by object
  std::map<std::string, RecordedPoses> truth;  // empty: none
  PoseFrame frame;                             // in which the page shows the poses
};

// Has everything that all pages share.
class RecordingSource : public ViewSource {
 public:
  // Errors: those of RecordedEvents::Open().
  static absl::StatusOr<std::unique_ptr<RecordingSource>> Open(RecordingInputs inputs);
  ~RecordingSource() override;

  std::unique_ptr<PageView> Open(std::shared_ptr<PageOutbox> outbox) override;

  const RecordingInputs& inputs() const { return inputs_; }
  RecordedEvents& events() const { return *events_; }
  const std::vector<std::unique_ptr<const ModelEdges>>& edges() const { return edges_; }  // of the objects
  const std::vector<int64_t>& pose_times_us() const { return pose_times_us_; }            // of all objects, in order
  PageScene scene() const;
  // Sends the poses and geometries to a page: those that are prepared now, and the others when they are.
  void SendFrames(const std::shared_ptr<PageOutbox>& outbox) const { frames_.SendTo(outbox); }

 private:
  explicit RecordingSource(RecordingInputs inputs);
  // Takes up to seconds for many poses and large models. Pages show their first image meanwhile.
  void PrepareFrames(const std::stop_token& stop);

  RecordingInputs inputs_;
  std::unique_ptr<RecordedEvents> events_;
  std::vector<std::unique_ptr<const ModelEdges>> edges_;
  std::vector<int64_t> pose_times_us_;
  mutable SharedFrames frames_;
  std::jthread preparer_;
};

}  // namespace evpose::client
