// SPDX-License-Identifier: Apache-2.0

// The view of one page on a recording.
#pragma once

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "client/view/recording_source.h"
#include "client/view/view_source.h"
#include "core/association/visible_edges.h"

namespace evpose::client {

// A thread makes the images. The first image is that of the first pose.
class RecordingView : public PageView {
 public:
  // `source` must outlive the view.
  RecordingView(const RecordingSource& source, std::shared_ptr<PageOutbox> outbox);
  ~RecordingView() override;

  absl::Status Handle(const PageRequest& request) override;

 private:
  using Clock = std::chrono::steady_clock;

  // The edges of an object that has poses in the recording; those of the truth come last.
  struct Track {
    const std::string& id;
    const RecordedPoses& poses;
    VisibleEdges edges;
    bool is_truth = false;
  };
  // The next image, and how it was requested.
  struct Work {
    std::optional<int64_t> t_us;  // nullopt: the view ends
    ImageSettings settings;
    bool is_playing = false;
    double speed = 1.0;
    bool is_tick = false;  // an image of a play, which may be left out
  };

  void AddTracks();
  void Run(const std::stop_token& stop);
  Work NextWork(const std::stop_token& stop);
  // Returns when the next image is due: now or earlier for one that was requested, later for a tick; nullopt: not
  // before a change.
  std::optional<Clock::time_point> NextDue() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Sets the instant of a tick, and when the next one is due.
  void AdvancePlay(Work& work) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  int64_t PlayedUs() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Changes the present instant. A play continues from there.
  void GoTo(int64_t t_us) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Step(int count) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Show(const Work& work);
  PageImage MakeImage(int64_t t_us, const ImageSettings& settings);
  // Called after a piece of the recording was read.
  void OnProgress();
  // Sends the state LOST for the objects without a pose at the end of the recording. A file of poses does not have the
  // cause, because a loss is stated by the poses after it.
  void SendEnds(int64_t to_us);

  const RecordingSource& source_;
  const std::shared_ptr<PageOutbox> outbox_;
  std::vector<Track> tracks_;

  std::mutex mutex_;
  std::condition_variable_any changed_;
  ImageSettings settings_ ABSL_GUARDED_BY(mutex_);
  int64_t t_us_ ABSL_GUARDED_BY(mutex_) = 0;  // the present instant; during a play, the instant at played_since_
  bool is_to_show_ ABSL_GUARDED_BY(mutex_) = true;
  bool is_playing_ ABSL_GUARDED_BY(mutex_) = false;
  double speed_ ABSL_GUARDED_BY(mutex_) = 1.0;
  Clock::time_point played_since_ ABSL_GUARDED_BY(mutex_);
  Clock::time_point next_tick_ ABSL_GUARDED_BY(mutex_);
  Clock::time_point range_sent_at_ ABSL_GUARDED_BY(mutex_);

  std::shared_ptr<void> subscription_;
  std::jthread thread_;
};

}  // namespace evpose::client
