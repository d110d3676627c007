// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/watching/event_images.h"

#include <algorithm>
#include <iterator>
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
  {
    const std::lock_guard lock(images_->mutex_);
    if (!is_ready_) return std::nullopt;
  }
  const std::lock_guard taking(images_->taking_mutex_);
  std::optional<Taken> taken;
  const absl::Status status = OrOutOfMemory([&]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
    taken = images_->Take(*this);
    return absl::OkStatus();
  });
  if (status.ok()) return taken;
  // While images follow, the next one has these events.
  const std::lock_guard lock(images_->mutex_);
  if (images_->has_finished_) failure_.Update(status);
  return std::nullopt;
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
  const Canvas& canvas = *Find(cell_px);
  reader->due_ = canvas.due;
  reader->next_ = canvas.next_number;
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
  if (Canvas* const canvas = Find(reader->cell_px_); canvas != nullptr) RemoveTaken(*canvas);
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
  MarkDueImages(now);
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
  const std::lock_guard lock(mutex_);
  has_finished_ = true;
  for (Canvas& canvas : canvases_) {
    canvas.is_image_due = canvas.is_image_due || canvas.has_changed;
    canvas.has_changed = false;
    for (Reader* reader : readers_) {
      if (reader->cell_px_ != canvas.bitmap.cell_px()) continue;
      reader->is_ready_ = canvas.is_image_due || reader->next_ < canvas.next_number;
    }
  }
  watchers_->Notify();
}

void EventImages::MarkDueImages(Time now) {
  for (Canvas& canvas : canvases_) {
    if (!canvas.has_changed || now < canvas.due) continue;
    canvas.has_changed = false;
    canvas.is_image_due = true;
    // A late image delays the next one by half a period at least, and does not change the mean rate.
    canvas.due = std::max(canvas.due + canvas.period, now + canvas.period / 2);
    MarkReaders(canvas, now);
    watchers_->Notify();
  }
}

void EventImages::MarkReaders(const Canvas& canvas, Time now) {
  for (Reader* reader : readers_) {
    if (reader->cell_px_ != canvas.bitmap.cell_px()) continue;
    // A reader with a lower rate takes the image whose time is nearest to its own.
    if (now + canvas.period / 2 < reader->due_) continue;
    if (reader->is_ready_) {
      ++reader->num_skipped_;
      metrics_->skipped_event_images.Add();
    }
    reader->is_ready_ = true;
    const Clock::duration period = PeriodOf(*reader);
    reader->due_ = std::max(reader->due_ + period, now + period / 2);
  }
}

EventImages::Reader::Taken EventImages::Take(Reader& reader) {
  MakeImage(reader.cell_px_);
  Reader::Taken taken = {EventImage::Join(ImagesFor(reader))};
  {
    const std::lock_guard lock(mutex_);
    Canvas& canvas = *Find(reader.cell_px_);
    reader.is_ready_ = false;
    reader.next_ = canvas.next_number;
    taken.num_skipped = reader.num_skipped_;
    RemoveTaken(canvas);
  }
  metrics_->event_images.Add();
  RunUnlessOutOfMemory([this, &reader]() ABSL_NO_THREAD_SAFETY_ANALYSIS { JoinImages(reader.cell_px_); });
  return taken;
}

void EventImages::MakeImage(int cell_px) {
  {
    const std::lock_guard lock(mutex_);
    if (!Find(cell_px)->is_image_due) return;
  }
  EventBitmap empty({camera_.width_px, camera_.height_px}, cell_px);
  const std::lock_guard lock(mutex_);
  Canvas& canvas = *Find(cell_px);
  canvas.images.reserve(canvas.images.size() + 1);
  auto image =
      std::make_shared<EventImage>(*canvas.from_t_us, canvas.to_t_us, canvas.num_events, std::move(empty), Outlines());
  // Nothing is allocated from here on: if an allocation fails, the canvas has its events still.
  image->SwapBitmap(canvas.bitmap);
  canvas.images.push_back({canvas.next_number, std::move(image)});
  ++canvas.next_number;
  canvas.from_t_us = canvas.to_t_us;
  canvas.num_events = 0;
  canvas.has_changed = canvas.is_image_due = false;
}

std::vector<std::shared_ptr<const EventImage>> EventImages::ImagesFor(const Reader& reader) {
  const std::lock_guard lock(mutex_);
  std::vector<std::shared_ptr<const EventImage>> images;
  for (const NumberedImage& made : Find(reader.cell_px_)->images) {
    if (made.number >= reader.next_) images.push_back(made.image);
  }
  return images;
}

void EventImages::JoinImages(int cell_px) {
  while (true) {
    std::vector<std::shared_ptr<const EventImage>> parts;
    {
      const std::lock_guard lock(mutex_);
      Canvas& canvas = *Find(cell_px);
      const auto first = FindJoinable(canvas);
      if (first == canvas.images.end()) return;
      parts = {first->image, std::next(first)->image};
    }
    const std::shared_ptr<const EventImage> joined = EventImage::Join(parts);
    const std::lock_guard lock(mutex_);
    Canvas& canvas = *Find(cell_px);
    // A reader that has been closed meanwhile may have been the last one that waited for them.
    const auto first = std::find_if(canvas.images.begin(), canvas.images.end(),
                                    [&parts](const NumberedImage& made) { return made.image == parts.front(); });
    if (first == canvas.images.end()) continue;
    first->image = joined;
    canvas.images.erase(std::next(first));
  }
}

std::vector<EventImages::NumberedImage>::iterator EventImages::FindJoinable(Canvas& canvas) {
  return std::adjacent_find(canvas.images.begin(), canvas.images.end(),
                            [&](const NumberedImage&, const NumberedImage& next) {
                              return std::none_of(readers_.begin(), readers_.end(), [&](const Reader* reader) {
                                return reader->cell_px_ == canvas.bitmap.cell_px() && reader->next_ == next.number;
                              });
                            });
}

void EventImages::RemoveTaken(Canvas& canvas) {
  uint64_t first = canvas.next_number;
  for (const Reader* reader : readers_) {
    if (reader->cell_px_ == canvas.bitmap.cell_px()) first = std::min(first, reader->next_);
  }
  std::erase_if(canvas.images, [first](const NumberedImage& made) { return made.number < first; });
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
  MarkDueImages(now);
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
