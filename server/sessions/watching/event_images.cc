// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/watching/event_images.h"

#include <algorithm>
#include <utility>

#include "core/base/yield_point.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

constexpr size_t kPieceEvents = 4096;  // between two yield points: some 10 us for each size of cells
constexpr double kLongestPeriodS = 365.0 * 24.0 * 3600.0;  // so that the sums with times are in range

EventImages::Clock::duration Period(double seconds) {
  const std::chrono::duration<double> period(std::min(seconds, kLongestPeriodS));
  return std::chrono::duration_cast<EventImages::Clock::duration>(period);
}

}  // namespace

EventImages::Reader::~Reader() { images_->Close(this); }

std::optional<EventImages::Reader::Taken> EventImages::Reader::Take() {
  const std::lock_guard lock(images_->mutex_);
  if (!is_ready_) return std::nullopt;
  is_ready_ = is_own_ = false;
  images_->metrics_->event_images.Add();
  return Taken{std::exchange(image_, nullptr), num_skipped_};
}

absl::Status EventImages::Reader::status() const {
  const std::lock_guard lock(images_->mutex_);
  return failure_;
}

EventImages::EventImages(const SessionConfig& config, const std::string& tenant, std::function<Time()> now,
                         WorkerPool& pool, std::shared_ptr<ServerMetrics> metrics)
    : camera_(config.camera),
      num_objects_(static_cast<uint32_t>(config.objects.size())),
      now_(std::move(now)),
      pool_(pool),
      metrics_(std::move(metrics)),
      watchers_(std::make_shared<Watchers>(pool, tenant)) {}

// The last reference may be released on a thread of gRPC: the lock shows to race detectors that all calls have ended.
EventImages::~EventImages() { const std::lock_guard lock(mutex_); }

std::unique_ptr<EventImages::Reader> EventImages::Open(int cell_px, double max_rate_hz,
                                                       std::weak_ptr<SessionListener> listener) {
  std::unique_ptr<Reader> reader(new Reader(shared_from_this()));
  reader->cell_px_ = cell_px;
  reader->period_ = Period(1.0 / max_rate_hz);
  watchers_->Add(std::move(listener));
  const Time now = now_();
  const std::lock_guard lock(mutex_);
  readers_.push_back(reader.get());
  UpdateCanvases(now);
  // The reader is due at the same times as the others, so that they share the images.
  reader->due_ = Find(cell_px)->due;
  // The timer may have been set for a slower reader.
  timer_.reset();
  SetTimer(now);
  num_readers_ = static_cast<uint32_t>(readers_.size());
  return reader;
}

void EventImages::Close(const Reader* reader) {
  const Time now = now_();
  const std::lock_guard lock(mutex_);
  std::erase(readers_, reader);
  num_readers_ = static_cast<uint32_t>(readers_.size());
  UpdateCanvases(now);
  if (!readers_.empty()) return;
  timer_.reset();
  latest_ = {};
  outlines_.reset();
}

EventImages::Clock::duration EventImages::PeriodOf(const Reader& reader) const {
  return std::max(reader.period_, Period(static_cast<double>(readers_.size()) / kMaxImagesPerS));
}

EventImages::Canvas* EventImages::Find(int cell_px) {
  const auto found = std::find_if(canvases_.begin(), canvases_.end(),
                                  [cell_px](const Canvas& canvas) { return canvas.bitmap.cell_px() == cell_px; });
  return found == canvases_.end() ? nullptr : &*found;
}

void EventImages::UpdateCanvases(Time now) {
  std::erase_if(canvases_, [this](const Canvas& canvas) {
    return std::none_of(readers_.begin(), readers_.end(),
                        [&canvas](const Reader* reader) { return reader->cell_px_ == canvas.bitmap.cell_px(); });
  });
  for (Canvas& canvas : canvases_) canvas.period = Clock::duration::max();
  for (const Reader* reader : readers_) {
    Canvas* canvas = Find(reader->cell_px_);
    if (canvas == nullptr) {
      canvas =
          &canvases_.emplace_back(Canvas{.bitmap = EventBitmap({camera_.width_px, camera_.height_px}, reader->cell_px_),
                                         .period = Clock::duration::max(),
                                         .due = now});
    }
    canvas->period = std::min(canvas->period, PeriodOf(*reader));
  }
  // A reader does not wait for the period of slower ones.
  for (Canvas& canvas : canvases_) canvas.due = std::min(canvas.due, now + canvas.period);
}

void EventImages::Add(absl::Span<const Event> events, int64_t from_t_us, int64_t to_t_us, const Tracker& tracker) {
  while (events.size() > kPieceEvents) {
    const absl::Span<const Event> piece = events.first(kPieceEvents);
    const int64_t piece_to_t_us = std::max(from_t_us, std::min(piece.back().t_us, to_t_us));
    AddPiece(piece, from_t_us, piece_to_t_us);
    from_t_us = piece_to_t_us;
    events.remove_prefix(kPieceEvents);
    YieldPoint();
  }
  AddPiece(events, from_t_us, to_t_us);
  const Time now = now_();
  const std::lock_guard lock(mutex_);
  if (readers_.empty()) return;
  latest_.resize(num_objects_);
  has_pose_.resize(num_objects_);
  for (uint32_t i = 0; i < num_objects_; ++i) {
    latest_[i].object_index = i;
    has_pose_[i] = tracker.Outline(i, latest_[i].object);
  }
  outlines_.reset();
  MakeDueImages(now);
  SetTimer(now);
}

void EventImages::AddPiece(absl::Span<const Event> events, int64_t from_t_us, int64_t to_t_us) {
  const std::lock_guard lock(mutex_);
  for (Canvas& canvas : canvases_) {
    if (!canvas.from_t_us) canvas.from_t_us = from_t_us;
    canvas.has_changed = canvas.has_changed || !events.empty() || to_t_us > canvas.to_t_us;
    canvas.to_t_us = to_t_us;
    canvas.num_events += events.size();
    canvas.bitmap.Add(events);
  }
}

void EventImages::Finish() {
  const Time now = now_();
  const std::lock_guard lock(mutex_);
  for (Canvas& canvas : canvases_) {
    if (!canvas.has_changed) continue;
    const absl::Status made = TryToMakeImage(canvas, now);
    for (Reader* reader : readers_) {
      if (reader->cell_px_ == canvas.bitmap.cell_px()) reader->failure_.Update(made);
    }
  }
  for (Reader* reader : readers_) reader->is_ready_ = reader->image_ != nullptr;
  watchers_->Notify();
}

void EventImages::MakeDueImages(Time now) {
  for (Canvas& canvas : canvases_) {
    if (!canvas.has_changed || now < canvas.due) continue;
    if (TryToMakeImage(canvas, now).ok()) watchers_->Notify();
  }
}

absl::Status EventImages::TryToMakeImage(Canvas& canvas, Time now) {
  return OrOutOfMemory([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    MakeImage(canvas, now);
    return absl::OkStatus();
  });
}

void EventImages::MakeImage(Canvas& canvas, Time now) {
  // A late image delays the next one by half a period at least, and does not change the mean rate.
  canvas.due = std::max(canvas.due + canvas.period, now + canvas.period / 2);
  auto image = std::make_shared<EventImage>(*canvas.from_t_us, canvas.to_t_us, canvas.num_events,
                                            EventBitmap(canvas.bitmap.sensor(), canvas.bitmap.cell_px()), Outlines());
  image->SwapBitmap(canvas.bitmap);  // after the allocations: if one fails, the next image has these events
  canvas.from_t_us = canvas.to_t_us;
  canvas.num_events = 0;
  canvas.has_changed = false;
  for (Reader* reader : readers_) {
    if (reader->cell_px_ != image->bitmap().cell_px()) continue;
    reader->failure_.Update(OrOutOfMemory([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
      Give(image, canvas, now, *reader);
      return absl::OkStatus();
    }));
  }
}

void EventImages::Give(const std::shared_ptr<EventImage>& image, const Canvas& canvas, Time now, Reader& reader) {
  // A reader with a lower rate takes the image whose time is nearest to its own.
  const bool is_due = now + canvas.period / 2 >= reader.due_;
  if (reader.image_ == nullptr) {
    reader.image_ = image;
  } else if (reader.is_own_) {
    reader.image_->Append(*image);
  } else {
    reader.image_ = EventImage::Join(*reader.image_, *image);
    reader.is_own_ = true;
  }
  if (!is_due) return;
  if (reader.is_ready_) {
    ++reader.num_skipped_;
    metrics_->skipped_event_images.Add();
  }
  reader.is_ready_ = true;
  const Clock::duration period = PeriodOf(reader);
  reader.due_ = std::max(reader.due_ + period, now + period / 2);
}

void EventImages::SetTimer(Time now) {
  if (timer_ != nullptr) return;
  std::optional<Time> next;
  for (const Canvas& canvas : canvases_) {
    if (canvas.has_changed) next = next ? std::min(*next, canvas.due) : canvas.due;
  }
  if (!next) return;
  timer_ = pool_.PostAfter(absl::FromChrono(std::max(*next - now, Clock::duration::zero())), [weak = weak_from_this()] {
    if (const auto self = weak.lock()) self->OnTimer();
  });
}

void EventImages::OnTimer() {
  const Time now = now_();
  const std::lock_guard lock(mutex_);
  timer_.reset();
  MakeDueImages(now);
  SetTimer(now);
}

std::shared_ptr<const SessionOutlines> EventImages::Outlines() {
  if (outlines_ == nullptr) {
    std::vector<SessionOutlines::Outline> outlines;
    for (size_t i = 0; i < latest_.size(); ++i) {
      if (has_pose_[i]) outlines.push_back(latest_[i]);
    }
    outlines_ = std::make_shared<const SessionOutlines>(camera_, std::move(outlines));
  }
  return outlines_;
}

}  // namespace evpose::server
