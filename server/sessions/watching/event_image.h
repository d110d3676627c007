// SPDX-License-Identifier: Apache-2.0

// An image of events with the visible edges of the objects, which all its watchers share.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/types/span.h"
#include "core/events/event_bitmap.h"
#include "core/geometry/camera.h"
#include "core/tracking/object/object_outline.h"

namespace evpose::server {

// The outlines of the objects of a session at one time. Thread-safe.
class SessionOutlines {
 public:
  struct Outline {
    uint32_t object_index = 0;
    ObjectOutline object;
    std::vector<OutlineSegment> segments;
  };
  // `outlines` are those of the objects that have a pose, without segments.
  SessionOutlines(const CameraModel& camera, std::vector<Outline> outlines)
      : camera_(camera), outlines_(std::move(outlines)) {}

  // Returns the outlines with their segments. The first call projects the edges and then releases them.
  const std::vector<Outline>& Projected() const;

 private:
  const CameraModel camera_;
  mutable std::once_flag is_projected_;
  mutable std::vector<Outline> outlines_;
};

// EventImage.cells of the API.
struct EncodedCells {
  bool is_zlib = false;  // else they are the bytes of the bitmap, and `zlib` is empty
  std::string zlib;
};

// The events of an interval of sensor time, in microseconds. Thread-safe once it is shared.
class EventImage {
 public:
  EventImage(int64_t from_t_us, int64_t to_t_us, uint64_t num_events, EventBitmap bitmap,
             std::shared_ptr<const SessionOutlines> outlines)
      : from_t_us_(from_t_us),
        to_t_us_(to_t_us),
        num_events_(num_events),
        bitmap_(std::move(bitmap)),
        outlines_(std::move(outlines)) {}

  int64_t from_t_us() const { return from_t_us_; }
  int64_t to_t_us() const { return to_t_us_; }
  uint64_t num_events() const { return num_events_; }
  const EventBitmap& bitmap() const { return bitmap_; }
  const std::vector<SessionOutlines::Outline>& outlines() const { return outlines_->Projected(); }
  // Returns the cells, compressed if that makes them smaller. The first call compresses them.
  const EncodedCells& cells() const;

  // To be called before the image is shared.
  void SwapBitmap(EventBitmap& bitmap) { std::swap(bitmap_, bitmap); }
  // Returns an image with the events of all `parts`, at least one, which follow each other, and with the outlines of
  // the last one.
  static std::shared_ptr<const EventImage> Join(absl::Span<const std::shared_ptr<const EventImage>> parts);

 private:
  void Append(const EventImage& next);

  int64_t from_t_us_;
  int64_t to_t_us_;
  uint64_t num_events_;
  EventBitmap bitmap_;
  std::shared_ptr<const SessionOutlines> outlines_;
  mutable std::once_flag is_encoded_;
  mutable EncodedCells cells_;
};

}  // namespace evpose::server
