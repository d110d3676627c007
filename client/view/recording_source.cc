// SPDX-License-Identifier: Apache-2.0
#include "client/view/recording_source.h"

#include <algorithm>
#include <utility>

#include "client/lib/messages/core_types.h"
#include "client/view/recording_view.h"
#include "core/base/status_macros.h"
#include "core/models/display_geometry.h"

namespace evpose::client {

RecordingSource::RecordingSource(RecordingInputs inputs) : inputs_(std::move(inputs)) {
  for (const RecordingObject& object : inputs_.objects) {
    edges_.push_back(std::make_unique<const ModelEdges>(object.model, VisibilityOptions(), EdgeElementOptions()));
  }
  for (const auto& [id, poses] : inputs_.poses) {
    for (const StampedPose& pose : poses.trajectory()) pose_times_us_.push_back(pose.t_us);
  }
  std::sort(pose_times_us_.begin(), pose_times_us_.end());
  pose_times_us_.erase(std::unique(pose_times_us_.begin(), pose_times_us_.end()), pose_times_us_.end());
  preparer_ = std::jthread([this](const std::stop_token& stop) { PrepareFrames(stop); });
}

RecordingSource::~RecordingSource() = default;

void RecordingSource::PrepareFrames(const std::stop_token& stop) {
  for (const bool is_truth : {false, true}) {
    for (const auto& [id, poses] : is_truth ? inputs_.truth : inputs_.poses) {
      if (stop.stop_requested()) return;
      PageOutbox::Prepared frames;
      poses.AppendFrames(id, is_truth, inputs_.frame, frames);
      frames_.Add(std::make_shared<const PageOutbox::Prepared>(std::move(frames)));
    }
  }
  for (const RecordingObject& object : inputs_.objects) {
    if (stop.stop_requested()) return;
    DisplayGeometry display = MakeDisplayGeometry(object.model, DisplayLimits());
    const ModelGeometry geometry{std::move(display.vertices), std::move(display.faces), std::move(display.edges),
                                 display.is_simplified};
    const std::string message = ToBinary({object.id, object.model_name, object.model.diameter_m}, geometry);
    frames_.Add(std::make_shared<const PageOutbox::Prepared>(PageOutbox::Prepared{{message, true}}));
  }
}

absl::StatusOr<std::unique_ptr<RecordingSource>> RecordingSource::Open(RecordingInputs inputs) {
  std::unique_ptr<RecordingReader> reader = std::move(inputs.reader);
  std::unique_ptr<RecordingSource> source(new RecordingSource(std::move(inputs)));
  EVPOSE_ASSIGN_OR_RETURN(source->events_, RecordedEvents::Open(source->inputs_.path, std::move(reader)));
  return source;
}

std::unique_ptr<PageView> RecordingSource::Open(std::shared_ptr<PageOutbox> outbox) {
  return std::make_unique<RecordingView>(*this, std::move(outbox));
}

PageScene RecordingSource::scene() const {
  PageScene scene;
  scene.frame = inputs_.frame;
  scene.camera = FromCore(inputs_.camera);
  for (const RecordingObject& object : inputs_.objects) {
    scene.objects.push_back({object.id, object.model_name, object.model.diameter_m});
  }
  scene.has_truth = !inputs_.truth.empty();
  const RecordedEvents::Progress progress = events_->progress();
  scene.recording = progress.range;
  if (pose_times_us_.empty()) return scene;
  TimeSpan& range = *scene.recording;
  if (!progress.has_events) range = {pose_times_us_.front(), pose_times_us_.front()};
  range.from_us = std::min(range.from_us, pose_times_us_.front());
  range.to_us = std::max(range.to_us, pose_times_us_.back());
  return scene;
}

}  // namespace evpose::client
