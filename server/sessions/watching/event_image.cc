// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/watching/event_image.h"

#include <zlib.h>

#include <algorithm>

#include "absl/cleanup/cleanup.h"

namespace evpose::server {
namespace {

// Share of zero bytes below which compression saves less than a third and takes longest.
constexpr double kMinZeroShare = 0.3;

// Runs of equal bytes are all that level 1 finds in an image of events. Without the search for other matches
// compression takes a third of the time, and the result is smaller.
EncodedCells Encode(absl::Span<const uint8_t> bytes) {
  const auto zeros = static_cast<double>(std::count(bytes.begin(), bytes.end(), uint8_t{0}));
  if (zeros < kMinZeroShare * static_cast<double>(bytes.size())) return {};
  z_stream stream = {};
  constexpr int kLevel = 1, kWindowBits = 15, kMemoryLevel = 8;  // the latter two as by default
  if (deflateInit2(&stream, kLevel, Z_DEFLATED, kWindowBits, kMemoryLevel, Z_RLE) != Z_OK) return {};
  const absl::Cleanup end = [&stream] { deflateEnd(&stream); };
  EncodedCells cells = {true, std::string(bytes.size(), '\0')};
  stream.next_in = const_cast<Bytef*>(bytes.data());  // NOLINT: zlib only reads it
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(cells.zlib.data());
  stream.avail_out = static_cast<uInt>(bytes.size()) - 1;
  if (deflate(&stream, Z_FINISH) != Z_STREAM_END) return {};  // it is not smaller
  cells.zlib.resize(stream.total_out);
  cells.zlib.shrink_to_fit();
  return cells;
}

}  // namespace

const std::vector<SessionOutlines::Outline>& SessionOutlines::Projected() const {
  std::call_once(is_projected_, [this] {
    for (Outline& outline : outlines_) outline.segments = ProjectOutline(camera_, outline.object);
    // The edges are released last, because the next call projects all of them again if this one has no memory. `= {}`
    // would keep their memory.
    for (Outline& outline : outlines_) outline.object.edges = std::vector<ObjectOutline::Edge>();
  });
  return outlines_;
}

const EncodedCells& EventImage::cells() const {
  std::call_once(is_encoded_, [this] { cells_ = Encode(bitmap_.bytes()); });
  return cells_;
}

void EventImage::Append(const EventImage& next) {
  to_t_us_ = next.to_t_us_;
  num_events_ += next.num_events_;
  bitmap_.Add(next.bitmap_);
  outlines_ = next.outlines_;
}

std::shared_ptr<const EventImage> EventImage::Join(absl::Span<const std::shared_ptr<const EventImage>> parts) {
  if (parts.size() == 1) return parts.front();
  const EventImage& first = *parts.front();
  const auto joined =
      std::make_shared<EventImage>(first.from_t_us_, first.to_t_us_, first.num_events_, first.bitmap_, first.outlines_);
  for (const auto& part : parts.subspan(1)) joined->Append(*part);
  return joined;
}

}  // namespace evpose::server
