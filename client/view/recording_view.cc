// SPDX-License-Identifier: Apache-2.0
#include "client/view/recording_view.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/core_types.h"
#include "core/events/event_bitmap.h"
#include "core/tracking/object/object_outline.h"

namespace evpose::client {
namespace {

constexpr std::chrono::milliseconds kRangePeriod(500);

// The interval of the events of an image; its end is excluded.
TimeSpan WindowAt(int64_t t_us, double window_ms) {
  const int64_t half_us = std::llround(window_ms * 500.0);
  return {t_us - half_us, t_us + half_us};
}

ObjectOutline OutlineAt(const std::string& id, int64_t t_us, TrackState state, const CameraModel& camera,
                        VisibleEdges& edges, const RigidTransform& camera_from_object) {
  evpose::ObjectOutline core;
  core.camera_from_object = camera_from_object;
  core.SetEdges(edges.At(camera_from_object));
  ObjectOutline outline{id, state, t_us, FromCore(camera_from_object), {}};
  for (const OutlineSegment& each : ProjectOutline(camera, core)) {
    outline.segments.push_back({each.p1_px, each.p2_px, static_cast<EdgeKind>(each.kind)});
  }
  return outline;
}

}  // namespace

RecordingView::RecordingView(const RecordingSource& source, std::shared_ptr<PageOutbox> outbox)
    : source_(source), outbox_(std::move(outbox)) {
  AddTracks();
  if (!source.pose_times_us().empty()) t_us_ = source.pose_times_us().front();
  outbox_->Set(PageOutbox::Latest::kHello,
               ToText(HelloMessage{.is_recording = true, .source = source.inputs().path, .session = ""}));
  outbox_->StartScene(source.scene());
  source.SendFrames(outbox_);
  subscription_ = source.events().Subscribe([this] { OnProgress(); });
  OnProgress();
  thread_ = std::jthread([this](const std::stop_token& stop) { Run(stop); });
}

RecordingView::~RecordingView() {
  subscription_.reset();
  thread_ = {};
}

void RecordingView::AddTracks() {
  const RecordingInputs& inputs = source_.inputs();
  for (const bool is_truth : {false, true}) {
    for (size_t i = 0; i < inputs.objects.size(); ++i) {
      const auto& poses = is_truth ? inputs.truth : inputs.poses;
      const auto found = poses.find(inputs.objects[i].id);
      if (found == poses.end()) continue;
      tracks_.push_back({found->first, found->second, VisibleEdges(inputs.camera, *source_.edges()[i]), is_truth});
    }
  }
}

absl::Status RecordingView::Handle(const PageRequest& request) {
  const std::lock_guard lock(mutex_);
  if (const auto* settings = std::get_if<ImageSettings>(&request)) {
    if (*settings == settings_) return absl::OkStatus();
    settings_ = *settings;
    GoTo(is_playing_ ? PlayedUs() : t_us_);
  } else if (const auto* seek = std::get_if<SeekRequest>(&request)) {
    is_playing_ = false;
    GoTo(seek->t_us);
  } else if (const auto* play = std::get_if<PlayRequest>(&request)) {
    GoTo(is_playing_ ? PlayedUs() : t_us_);
    is_playing_ = true;
    speed_ = play->speed;
  } else if (std::holds_alternative<PauseRequest>(request)) {
    GoTo(is_playing_ ? PlayedUs() : t_us_);
    is_playing_ = false;
  } else if (const auto* step = std::get_if<StepRequest>(&request)) {
    GoTo(is_playing_ ? PlayedUs() : t_us_);
    is_playing_ = false;
    Step(step->count);
  } else if (!std::holds_alternative<ListRequest>(request)) {
    return absl::InvalidArgumentError("this is a recording: it has no sessions");
  }
  changed_.notify_one();
  return absl::OkStatus();
}

void RecordingView::GoTo(int64_t t_us) {
  t_us_ = t_us;
  is_to_show_ = true;
  played_since_ = next_tick_ = Clock::now();
}

void RecordingView::Step(int count) {
  const std::vector<int64_t>& times = source_.pose_times_us();
  if (times.empty()) return;
  // The next pose after the present instant; for a step backwards, the first pose at or after it.
  const auto next = count > 0 ? std::upper_bound(times.begin(), times.end(), t_us_)
                              : std::lower_bound(times.begin(), times.end(), t_us_);
  const int64_t target = (next - times.begin()) + (count > 0 ? count - 1 : count);
  GoTo(times[static_cast<size_t>(std::clamp<int64_t>(target, 0, static_cast<int64_t>(times.size()) - 1))]);
}

int64_t RecordingView::PlayedUs() const {
  const std::chrono::duration<double, std::micro> elapsed = Clock::now() - played_since_;
  return t_us_ + std::llround(speed_ * elapsed.count());
}

std::optional<RecordingView::Clock::time_point> RecordingView::NextDue() const {
  if (is_to_show_) {
    const bool is_read = source_.events().HasUntil(WindowAt(t_us_, settings_.window_ms).to_us);
    return is_read ? std::optional(Clock::time_point::min()) : std::nullopt;
  }
  return is_playing_ ? std::optional(next_tick_) : std::nullopt;
}

RecordingView::Work RecordingView::NextWork(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (!stop.stop_requested()) {
    const std::optional<Clock::time_point> due = NextDue();
    if (due && *due <= Clock::now()) break;
    const auto has_changed = [&] { return NextDue() != due; };
    if (due) {
      changed_.wait_until(lock, stop, *due, has_changed);
    } else {
      changed_.wait(lock, stop, has_changed);
    }
  }
  if (stop.stop_requested()) return {};
  Work work{.t_us = t_us_,
            .settings = settings_,
            .is_playing = is_playing_,
            .speed = speed_,
            .is_tick = !std::exchange(is_to_show_, false)};
  if (work.is_tick) AdvancePlay(work);
  return work;
}

void RecordingView::AdvancePlay(Work& work) {
  work.t_us = PlayedUs();
  // Ticks follow each other by the period, however late each of them is noticed. After a long image the next one is
  // not due at once, so that the rate stays bounded.
  const std::chrono::microseconds period(std::llround(1e6 / settings_.rate_hz));
  next_tick_ = std::max(next_tick_ + period, Clock::now() + period / 2);
  // A play waits at the end of what has been read, and stops at the end of the recording.
  const RecordedEvents::Progress progress = source_.events().progress();
  if (*work.t_us < progress.range.to_us) return;
  work.t_us = t_us_ = std::max(t_us_, progress.range.to_us);
  played_since_ = Clock::now();
  if (progress.is_complete) is_playing_ = work.is_playing = work.is_tick = false;
}

void RecordingView::Run(const std::stop_token& stop) {
  while (true) {
    const Work work = NextWork(stop);
    if (!work.t_us) return;
    Show(work);
  }
}

void RecordingView::Show(const Work& work) {
  outbox_->Set(PageOutbox::Latest::kPosition, PositionText(*work.t_us, work.is_playing, work.speed));
  // A page that does not draw needs no images of a play.
  if (work.is_tick && !outbox_->WantsImage()) return;
  outbox_->SetImage(MakeImage(*work.t_us, work.settings));
}

PageImage RecordingView::MakeImage(int64_t t_us, const ImageSettings& settings) {
  const RecordingInputs& inputs = source_.inputs();
  const TimeSpan window = WindowAt(t_us, settings.window_ms);
  EventBitmap bitmap(source_.events().geometry(), settings.cell_px);
  PageImage result;
  result.t_us = t_us;
  EventImage& image = result.image;
  const absl::Status status = source_.events().Visit(window.from_us, window.to_us, [&](absl::Span<const Event> events) {
    bitmap.Add(events);
    image.num_events += events.size();
  });
  if (!status.ok()) outbox_->AddNote(NoticeText(NoticeLevel::kError, std::string(status.message())));
  image.from_t_us = window.from_us;
  image.to_t_us = window.to_us;
  image.cell_px = settings.cell_px;
  image.width = bitmap.width();
  image.height = bitmap.height();
  image.cells.assign(bitmap.bytes().begin(), bitmap.bytes().end());
  for (Track& track : tracks_) {
    const std::optional<RigidTransform> pose = track.poses.At(t_us);
    if (!pose) continue;
    image.outlines.push_back(OutlineAt(track.id, t_us, track.poses.StateAt(t_us), inputs.camera, track.edges, *pose));
    result.num_truths += track.is_truth ? 1 : 0;
  }
  return result;
}

void RecordingView::OnProgress() {
  const std::lock_guard lock(mutex_);
  // Read and sent with the lock, so that the constructor and the thread that reads the recording send ranges in order.
  const RecordedEvents::Progress progress = source_.events().progress();
  changed_.notify_one();
  const Clock::time_point now = Clock::now();
  if (!progress.is_complete && now - range_sent_at_ < kRangePeriod) return;
  range_sent_at_ = now;
  outbox_->Set(PageOutbox::Latest::kRange, RangeText(progress.range, progress.is_complete, source_.events().counts()));
  if (!progress.status.ok()) {
    outbox_->AddNote(NoticeText(NoticeLevel::kError, std::string(progress.status.message())));
  }
  if (progress.is_complete) SendEnds(progress.range.to_us);
}

void RecordingView::SendEnds(int64_t to_us) {
  for (const Track& track : tracks_) {
    const Trajectory& trajectory = track.poses.trajectory();
    if (track.is_truth || trajectory.empty()) continue;
    const int64_t last_us = trajectory.back().t_us;
    if (to_us - last_us <= track.poses.longest_step_us()) continue;
    outbox_->AddNote(StateText(track.id, last_us + 1, TrackState::kLost, "no pose until the end of the recording"));
  }
}

}  // namespace evpose::client
