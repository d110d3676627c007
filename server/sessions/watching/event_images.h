// SPDX-License-Identifier: Apache-2.0

// Makes images of the events of a session for its watchers (server/sessions/watching/README.md, section 1).
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/types/span.h"
#include "core/events/event.h"
#include "core/events/event_bitmap.h"
#include "core/tracking/tracker.h"
#include "server/runtime/worker_pool.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/watching/event_image.h"
#include "server/sessions/watching/watchers.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// Without watchers this object holds no image, and costs its session one comparison for each slice of events.
// Thread-safe.
class EventImages : public std::enable_shared_from_this<EventImages> {
 public:
  using Clock = std::chrono::steady_clock;
  using Time = Clock::time_point;

  // Images of a session per second, to all its watchers together. With more watchers each receives fewer: this bounds
  // the time that their images take. Enough for 16 with the highest rate, and for 32 with the default.
  static constexpr double kMaxImagesPerS = 960.0;
  static constexpr double kMaxRateHz = 60.0;  // of one watcher: displays show no more

  EventImages(const SessionConfig& config, const std::string& tenant, std::function<Time()> now, WorkerPool& pool,
              std::shared_ptr<ServerMetrics> metrics);
  ~EventImages();

  // A watcher of the images, until it is destroyed.
  class Reader {
   public:
    ~Reader();
    struct Taken {
      std::shared_ptr<const EventImage> image;
      uint64_t num_skipped = 0;  // EventImage.num_skipped of the API
    };
    // Returns an image with the events since the last one; nullopt until one is due, and without memory for it. An
    // image that is not taken before the next one is due counts as skipped. Takes milliseconds.
    std::optional<Taken> Take();
    // Returns RESOURCE_EXHAUSTED (OUT_OF_MEMORY) if events are missing, because there was no memory for the last image.
    absl::Status status() const;

   private:
    friend class EventImages;
    explicit Reader(std::shared_ptr<EventImages> images) : images_(std::move(images)) {}

    const std::shared_ptr<EventImages> images_;
    // Guarded by the mutex of `images_`.
    int cell_px_ = 0;
    Clock::duration period_{};
    Time due_;
    uint64_t next_ = 0;      // number of the first image that it has not taken
    bool is_ready_ = false;  // an image is due
    absl::Status failure_;
    uint64_t num_skipped_ = 0;
  };
  // `cell_px` is 1, 2 or 4; `max_rate_hz` is positive and at most kMaxRateHz. `listener` is called when an image is due
  // and by Notify(), on the pool's thread for images.
  std::unique_ptr<Reader> Open(int cell_px, double max_rate_hz, std::weak_ptr<SessionListener> listener);
  uint32_t num_readers() const { return num_readers_.load(std::memory_order_relaxed); }

  // The next three functions are for the session. Add() and Finish() are called in its turns.
  bool is_watched() const { return num_readers() > 0; }
  // Adds events that have been tracked; it has yield points. They have advanced the clock of the sensor from
  // `from_t_us` to `to_t_us`; `tracker` is in the state after them.
  void Add(absl::Span<const Event> events, int64_t from_t_us, int64_t to_t_us, const Tracker& tracker);
  // To be called when no more events follow. All images that wait are then due.
  void Finish();
  // Calls the listeners of the readers, because the session has ended.
  void Notify() { watchers_->Notify(); }

 private:
  struct NumberedImage {
    uint64_t number = 0;
    std::shared_ptr<const EventImage> image;
  };
  // The events since the last image, in cells of one size, and the images that some of the readers have not taken.
  struct Canvas {
    EventBitmap bitmap;
    std::optional<int64_t> from_t_us;  // absent before the first events
    int64_t to_t_us = 0;
    uint64_t num_events = 0;
    bool has_changed = false;   // since an image was last due
    bool is_image_due = false;  // the next reader that takes an image makes it
    Clock::duration period{};   // of the fastest reader
    Time due;
    uint64_t next_number = 0;
    std::vector<NumberedImage> images;  // the oldest first; each begins where some reader goes on
  };

  void AddPiece(absl::Span<const Event> events, int64_t from_t_us, int64_t to_t_us);
  Clock::duration PeriodOf(const Reader& reader) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // To be called after each change of readers_: adds and removes canvases, and sets their periods.
  void UpdateCanvases(Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  Canvas* Find(int cell_px) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Close(const Reader* reader);
  // Notifies the readers of the canvases that are due. Makes and joins no image, because turns and the timer call it.
  void MarkDueImages(Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void MarkReaders(const Canvas& canvas, Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  // The next four are for Reader::Take(). They make and join images without mutex_, which turns take.
  Reader::Taken Take(Reader& reader) ABSL_EXCLUSIVE_LOCKS_REQUIRED(taking_mutex_);
  // Makes an image of the canvas if one is due that no reader has made yet. Without memory the canvas keeps its events.
  void MakeImage(int cell_px) ABSL_EXCLUSIVE_LOCKS_REQUIRED(taking_mutex_);
  std::vector<std::shared_ptr<const EventImage>> ImagesFor(const Reader& reader);
  // Joins the images of the canvas where no reader goes on between them, so that there are at most as many as readers,
  // and each is joined once, however many readers wait.
  void JoinImages(int cell_px) ABSL_EXCLUSIVE_LOCKS_REQUIRED(taking_mutex_);
  // The first of two such images; images.end(): there are none.
  std::vector<NumberedImage>::iterator FindJoinable(Canvas& canvas) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RemoveTaken(Canvas& canvas) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  // Sets the timer so that waiting events become an image in time, even if no further events arrive.
  void SetTimer(Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void OnTimer();
  std::shared_ptr<const SessionOutlines> Outlines() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const CameraModel camera_;
  const uint32_t num_objects_;
  const std::function<Time()> now_;
  WorkerPool& pool_;
  const std::shared_ptr<ServerMetrics> metrics_;
  const std::shared_ptr<Watchers> watchers_;
  std::atomic<uint32_t> num_readers_ = 0;
  std::mutex taking_mutex_;  // held by the reader that takes an image; locked before mutex_
  mutable std::mutex mutex_;
  bool has_finished_ ABSL_GUARDED_BY(mutex_) = false;
  std::vector<Reader*> readers_ ABSL_GUARDED_BY(mutex_);
  std::vector<Canvas> canvases_ ABSL_GUARDED_BY(mutex_);                  // one for each size of cells that has readers
  std::vector<SessionOutlines::Outline> latest_ ABSL_GUARDED_BY(mutex_);  // of all objects, so that memory is reused
  std::vector<bool> has_pose_ ABSL_GUARDED_BY(mutex_);
  std::shared_ptr<const SessionOutlines> outlines_ ABSL_GUARDED_BY(mutex_);  // of latest_; null: not made yet
  std::unique_ptr<PoolTimer> timer_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
