// SPDX-License-Identifier: Apache-2.0

// Shared helpers for tests of sessions and services: a tracker with poses that are a simple function of its events,
// events as FLAT64 bytes, a model, waiting for a session.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/tracking/tracker.h"
#include "server/sessions/session.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/watching/waiting_listener.h"

namespace evpose::server {

// Stops all fake trackers while it is closed.
class FakeTrackerGate {
 public:
  void Close() {
    const std::lock_guard lock(mutex_);
    is_open_ = false;
  }
  void Open() {
    const std::lock_guard lock(mutex_);
    is_open_ = true;
    opened_.notify_all();
  }
  void Pass() {
    std::unique_lock lock(mutex_);
    ++num_waiting_;
    came_.notify_all();
    opened_.wait(lock, [this] { return is_open_; });
    --num_waiting_;
  }
  // Returns when a tracker waits at the gate.
  void AwaitTracker() {
    std::unique_lock lock(mutex_);
    came_.wait(lock, [this] { return num_waiting_ > 0; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable came_, opened_;
  int num_waiting_ = 0;
  bool is_open_ = true;
};

// Produces one pose per object and per millisecond with events: its translation is (number of events, sum of x, sum of
// y). An event at pixel (0, 0) makes all objects LOST and reports a phase transition; ResetPose makes one object
// TRACKING. An object without a first pose is INITIALIZING. The outline of a tracked one is a line one metre in front
// of the camera, 0.1 m long.
class FakeTracker : public Tracker {
 public:
  FakeTracker(std::shared_ptr<FakeTrackerGate> gate, const SessionConfig& config) : gate_(std::move(gate)) {
    for (const ObjectConfig& object : config.objects) {
      objects_.push_back({object.initial_camera_from_object ? TrackState::kTracking : TrackState::kInitializing});
    }
  }

  void AddEvents(absl::Span<const Event> events, std::vector<PoseEstimate>& estimates) override {
    gate_->Pass();
    for (const Event& event : events) {
      if (event.t_us / 1000 > window_) Close(event.t_us, estimates);
      for (Object& object : objects_) {
        if (event.x == 0 && event.y == 0) {
          if (object.state != TrackState::kLost && on_transition_) {
            const auto index = static_cast<uint32_t>(&object - objects_.data());
            on_transition_({index, event.t_us, ObjectTransition{ObjectPhase::kPublished, ObjectPhase::kSearching}});
          }
          object.losses += object.state != TrackState::kLost;
          object.state = TrackState::kLost;
        }
        object.attempts += object.state != TrackState::kTracking;
      }
      ++num_events_;
      sum_ += Eigen::Vector3d(1.0, event.x, event.y);
    }
  }
  void AdvanceTime(int64_t t_us, std::vector<PoseEstimate>& estimates) override {
    if (t_us / 1000 > window_) Close(t_us, estimates);
  }
  EventGap Skip(absl::Span<const Event> events, int64_t t_us) override {
    const EventGap gap = {std::max(window_ * 1000, skipped_until_us_), t_us, num_events_ + events.size()};
    num_events_ = 0;
    sum_.setZero();
    window_ = t_us / 1000;
    skipped_until_us_ = t_us;
    return gap;
  }
  void Finish(std::vector<PoseEstimate>& estimates) override { Close((window_ + 1) * 1000, estimates); }
  void ResetPose(size_t object_index, const RigidTransform&) override {
    objects_[object_index].state = TrackState::kTracking;
  }
  void SetPhaseListener(const PhaseListener& listener) override { on_transition_ = listener; }
  size_t num_objects() const override { return objects_.size(); }
  TrackState state(size_t object_index) const override { return objects_[object_index].state; }
  InitializationReport initialization(size_t object_index) const override {
    const Object& object = objects_[object_index];
    if (object.state == TrackState::kTracking) return {.status = InitializationStatus::kNotNeeded};
    return {.status = InitializationStatus::kTooFewLines, .attempts = object.attempts, .num_lines = 2};
  }
  uint32_t losses(size_t object_index) const override { return objects_[object_index].losses; }
  bool Outline(size_t object_index, ObjectOutline& outline) const override {
    if (objects_[object_index].state != TrackState::kTracking) return false;
    outline = {.state = TrackState::kTracking, .t_us = window_ * 1000};
    outline.edges = {{{0, 0, 1}, {0.1, 0, 1}, {0, 0, 0}, EdgeKind::kPainted}};
    return true;
  }
  void SaveState(StateWriter& writer) const override { VisitState(writer, *this); }
  void LoadState(StateReader& reader) override { VisitState(reader, *this); }

 private:
  struct Object {
    TrackState state;
    uint32_t losses = 0;
    uint64_t attempts = 0;  // one for each event without a pose
    static void VisitState(auto& archive, auto& self) {
      auto& [state, losses, attempts] = self;
      archive(AtMost(state, TrackState::kAmbiguous), losses, attempts);
    }
  };

  static void VisitState(auto& archive, auto& self) {
    auto& [gate, objects, on_transition, window, skipped_until_us, num_events, sum] = self;
    for (auto& object : objects) archive(object);
    archive(window, skipped_until_us, num_events, sum);
  }

  void Close(int64_t t_us, std::vector<PoseEstimate>& estimates) {
    for (size_t i = 0; i < objects_.size() && num_events_ > 0; ++i) {
      if (objects_[i].state != TrackState::kTracking) continue;
      PoseEstimate estimate;
      estimate.object_index = static_cast<uint32_t>(i);
      estimate.t_us = window_ * 1000 + 500;
      estimate.camera_from_object.translation_m = sum_;
      for (int row = 0; row < 6; ++row) {
        for (int column = 0; column < 6; ++column) {
          estimate.covariance(row, column) = 10 * std::min(row, column) + std::max(row, column);
        }
      }
      estimate.twist << 1, 2, 3, 4, 5, 6;
      estimate.state = objects_[i].state;
      estimate.num_events = num_events_;
      estimate.explained_ratio = 0.75f;
      estimates.push_back(estimate);
    }
    num_events_ = 0;
    sum_.setZero();
    window_ = t_us / 1000;
  }

  const std::shared_ptr<FakeTrackerGate> gate_;
  std::vector<Object> objects_;
  PhaseListener on_transition_;
  int64_t window_ = 0;
  int64_t skipped_until_us_ = 0;
  uint32_t num_events_ = 0;
  Eigen::Vector3d sum_ = Eigen::Vector3d::Zero();
};

inline TrackerFactory FakeTrackers(std::shared_ptr<FakeTrackerGate> gate = std::make_shared<FakeTrackerGate>()) {
  return [gate](const SessionConfig& config,
                const std::vector<std::shared_ptr<const ObjectModel>>&) -> absl::StatusOr<std::unique_ptr<Tracker>> {
    return std::make_unique<FakeTracker>(gate, config);
  };
}

// Encodes events as FLAT64 (core/events/decoder.h).
inline std::string Flat64(const std::vector<Event>& events) {
  std::string bytes;
  for (const Event& event : events) {
    const uint64_t word = static_cast<uint64_t>(event.t_us) << 32 | static_cast<uint64_t>(event.x) << 18 |
                          static_cast<uint64_t>(event.y) << 4 | event.polarity;
    for (int shift = 0; shift < 64; shift += 8) bytes.push_back(static_cast<char>(word >> shift));
  }
  return bytes;
}

// `per_ms` events in each of the milliseconds [begin_ms, end_ms), none at pixel (0, 0).
inline std::vector<Event> SomeEvents(int64_t begin_ms, int64_t end_ms, int per_ms = 3) {
  std::vector<Event> events;
  for (int64_t ms = begin_ms; ms < end_ms; ++ms) {
    for (int64_t i = 0; i < per_ms; ++i) {
      events.push_back({ms * 1000 + i * (900 / per_ms), static_cast<uint16_t>(1 + (7 * ms + i) % 300),
                        static_cast<uint16_t>(1 + (3 * ms + 5 * i) % 200), static_cast<uint8_t>(i % 2)});
    }
  }
  return events;
}

// Restores each stored session, as a client that asks for it does.
inline void RestoreAll(SessionManager& sessions, const Store& store) {
  const std::vector<SessionOwner> owners = store.ListOwners().value();
  for (const SessionOwner& owner : owners) (void)sessions.Describe(owner.tenant, owner.name);
}

inline constexpr char kCubeObj[] =
    "v -0.1 -0.1 -0.1\nv 0.1 -0.1 -0.1\nv 0.1 0.1 -0.1\nv -0.1 0.1 -0.1\n"
    "v -0.1 -0.1 0.1\nv 0.1 -0.1 0.1\nv 0.1 0.1 0.1\nv -0.1 0.1 0.1\n"
    "f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\n"
    "f 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8\n";

inline SessionConfig SomeConfig(const std::vector<std::string>& object_ids = {"cube"},
                                const std::string& model = "models/cube") {
  SessionConfig config;
  config.encoding = Encoding::kFlat64;
  config.camera = {.width_px = 320, .height_px = 240, .fx_px = 300, .fy_px = 300, .cx_px = 160, .cy_px = 120};
  for (const std::string& id : object_ids) config.objects.push_back({id, model, RigidTransform()});
  return config;
}

// Waits until `is_true`, which is called after each change of the session.
inline void Until(const std::shared_ptr<Session>& session, const std::function<bool()>& is_true) {
  const auto waiting = std::make_shared<WaitingListener>();
  session->AddWatcher(waiting);
  waiting->WaitUntil(is_true);
}

}  // namespace evpose::server
