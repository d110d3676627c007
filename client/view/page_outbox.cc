// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_outbox.h"

#include <algorithm>
#include <utility>

#include "client/view/keep_every_second.h"

namespace evpose::client {
namespace {

constexpr size_t kPosesPerMessage = 256;  // bounds the time for which a message of poses delays an image

// Adds the events of an image that was not sent to the image that follows it.
void AddEarlierEvents(const EventImage& earlier, EventImage& image) {
  if (earlier.cell_px != image.cell_px || earlier.cells.size() != image.cells.size()) return;
  for (size_t i = 0; i < image.cells.size(); ++i) image.cells[i] |= earlier.cells[i];
  image.from_t_us = std::min(image.from_t_us, earlier.from_t_us);
  image.num_events += earlier.num_events;
}

}  // namespace

template <typename Store>
void PageOutbox::Update(const Store& store) {
  {
    const std::lock_guard lock(mutex_);
    if (is_closed_) return;
    store();
  }
  on_ready_();
}

void PageOutbox::Set(Latest kind, std::string text) {
  Update([&] { latest_[kind] = std::move(text); });
}

void PageOutbox::SetHealth(SessionHealth health) {
  Update([&] { health_ = std::move(health); });
}

void PageOutbox::StartScene(const PageScene& scene) {
  Update([&] {
    latest_[Latest::kScene] = ToText(scene);
    latest_.erase(Latest::kRange);
    latest_.erase(Latest::kPosition);
    latest_.erase(Latest::kEnd);
    health_.reset();
    notes_.clear();
    prepared_.clear();
    poses_.clear();
    image_.reset();
    source_skipped_ = 0;
  });
}

void PageOutbox::Add(std::shared_ptr<const Prepared> frames) {
  Update([&] { prepared_.push_back({std::move(frames), 0}); });
}

void PageOutbox::AddPoses(const std::vector<Pose>& poses) {
  Update([&] {
    for (const Pose& pose : poses) {
      std::vector<Pose>& waiting = poses_[pose.object_id];
      waiting.push_back(pose);
      if (waiting.size() > kMaxPoses) KeepEverySecond(waiting, (waiting.size() + 1) % 2);  // the last one stays
    }
  });
}

void PageOutbox::AddNote(std::string text) {
  Update([&] {
    notes_.push_back(std::move(text));
    if (notes_.size() > kMaxNotes) notes_.pop_front();
  });
}

void PageOutbox::SetImage(PageImage image) {
  Update([&] {
    if (image_) {
      ++skipped_;
      if (image.is_continuation) AddEarlierEvents(image_->image, image.image);
    }
    source_skipped_ = image.image.num_skipped;
    image_ = std::move(image);
  });
}

bool PageOutbox::WantsImage() const {
  const std::lock_guard lock(mutex_);
  return !image_ && sent_ - acknowledged_ < kMaxUnacknowledged;
}

LinkCounts PageOutbox::Counts() const {
  return {.images_sent = sent_, .images_skipped = skipped_ + source_skipped_, .unacknowledged = sent_ - acknowledged_};
}

std::optional<PageOutbox::Frame> PageOutbox::NextLatest(Latest first, Latest last) {
  const auto found = latest_.lower_bound(first);
  if (found == latest_.end() || found->first > last) return std::nullopt;
  Frame frame{std::move(found->second)};
  latest_.erase(found);
  return frame;
}

std::optional<PageOutbox::Frame> PageOutbox::NextImage() {
  if (!image_ || sent_ - acknowledged_ >= kMaxUnacknowledged) return std::nullopt;
  const PageImage image = std::move(*image_);
  image_.reset();
  ++sent_;
  return Frame{ToBinary(image, sent_, skipped_ + source_skipped_), true};
}

std::optional<PageOutbox::Frame> PageOutbox::NextPoses() {
  const auto object = poses_.begin();
  if (object == poses_.end()) return std::nullopt;
  std::vector<Pose>& waiting = object->second;
  const size_t count = std::min(waiting.size(), kPosesPerMessage);
  Frame frame{PosesText(object->first, absl::MakeConstSpan(waiting).first(count), false)};
  waiting.erase(waiting.begin(), waiting.begin() + static_cast<std::ptrdiff_t>(count));
  if (waiting.empty()) poses_.erase(object);
  return frame;
}

std::optional<PageOutbox::Frame> PageOutbox::Next() {
  const std::lock_guard lock(mutex_);
  if (auto frame = NextLatest(Latest::kHello, Latest::kPosition)) return frame;
  if (!notes_.empty()) {
    Frame frame{std::move(notes_.front())};
    notes_.pop_front();
    return frame;
  }
  if (auto frame = NextImage()) return frame;
  for (; !prepared_.empty(); prepared_.pop_front()) {
    Cursor& cursor = prepared_.front();
    if (cursor.next < cursor.frames->size()) return (*cursor.frames)[cursor.next++];
  }
  if (auto frame = NextPoses()) return frame;
  if (health_) {
    Frame frame{HealthText(*health_, Counts())};
    health_.reset();
    return frame;
  }
  return NextLatest(Latest::kEnd, Latest::kEnd);
}

void PageOutbox::Acknowledge(uint64_t number) {
  Update([&] { acknowledged_ = std::max(acknowledged_, std::min(number, sent_)); });
}

void PageOutbox::Close() {
  const std::lock_guard lock(mutex_);
  is_closed_ = true;
  prepared_.clear();
  poses_.clear();
  image_.reset();
}

}  // namespace evpose::client
