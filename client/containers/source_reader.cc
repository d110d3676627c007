// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/containers/event_source.h"
#include "core/base/status_macros.h"
#include "core/events/encoder.h"

namespace evpose::client {
namespace {

constexpr int kFlat64Addresses = 1 << 14;               // of rows and of columns
constexpr int64_t kClockRangeUs = int64_t{1} << 32;     // of FLAT64
constexpr int64_t kMaxStepUs = (int64_t{1} << 31) - 1;  // largest step in time that a decoder does not take for a wrap
// Bounds the memory for the triggers before the first event: 8 million.
constexpr size_t kMaxBytesBeforeEvent = size_t{64} << 20;
constexpr SensorGeometry kUnknownSensor = {2048, 2048};  // as for FLAT64 without a geometry

// The sizes of the sensors of Prophesee, iniVation, Samsung and CelePixel, by their number of pixels.
constexpr std::array<SensorGeometry, 13> kKnownSensors = {{{128, 128},
                                                           {240, 180},
                                                           {304, 240},
                                                           {346, 260},
                                                           {320, 320},
                                                           {384, 320},
                                                           {640, 480},
                                                           {640, 512},
                                                           {768, 640},
                                                           {1280, 720},
                                                           {1280, 800},
                                                           {1280, 960},
                                                           kUnknownSensor}};

bool HasAddress(const SourceEvent& event) {
  return event.x >= 0 && event.y >= 0 && event.x < kFlat64Addresses && event.y < kFlat64Addresses;
}

class SourceReader final : public RecordingReader {
 public:
  SourceReader(std::unique_ptr<EventSource> source, RecordingHeader header, std::unique_ptr<EventEncoder> encoder)
      : source_(std::move(source)), header_(std::move(header)), encoder_(std::move(encoder)) {}

  // Reads up to the first event; the first event or trigger sets the zero of the times. False if there is no event.
  absl::StatusOr<bool> Start() {
    while (!has_event_) {
      if (bytes_.size() > kMaxBytesBeforeEvent) return false;
      EVPOSE_ASSIGN_OR_RETURN(const bool has_more, Refill());
      if (!has_more) return false;
    }
    header_.time_offset_us += zero_us_;
    if (header_.metavision_zero_us) *header_.metavision_zero_us -= zero_us_;
    return true;
  }

  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return -1; }

  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    while (begin_ == bytes_.size()) {
      bytes_.clear();
      begin_ = 0;
      EVPOSE_ASSIGN_OR_RETURN(const bool has_more, Refill());
      if (!has_more) return 0;
    }
    const size_t size = std::min(buffer.size(), bytes_.size() - begin_);
    std::memcpy(buffer.data(), bytes_.data() + begin_, size);
    begin_ += size;
    return size;
  }

  std::vector<SkippedParts> skipped() const override {
    std::vector<SkippedParts> parts = source_->skipped();
    if (num_outside_ > 0)
      parts.push_back(
          {"events with a row or column below 0 or above 16383", num_outside_, SkippedParts::Loss::kEvents});
    if (num_without_time_ > 0)
      parts.push_back({"events without a valid time", num_without_time_, SkippedParts::Loss::kEvents});
    if (num_early_ > 0) parts.push_back({"events before time 0", num_early_, SkippedParts::Loss::kEvents});
    if (num_early_triggers_ > 0)
      parts.push_back({"triggers before the first event", num_early_triggers_, SkippedParts::Loss::kNone});
    if (num_jumps_ > 0)
      parts.push_back({"events more than 35 minutes from the event before", num_jumps_, SkippedParts::Loss::kEvents});
    return parts;
  }

 private:
  // Appends the bytes of the next events, which may be none. Returns false at the end of the recording.
  absl::StatusOr<bool> Refill() {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_more, source_->Next(from_file_));
    if (!has_more) return false;
    events_.clear();
    for (const SourceEvent& event : from_file_) EVPOSE_RETURN_IF_ERROR(Take(event));
    EVPOSE_RETURN_IF_ERROR(Flush());
    return true;
  }

  absl::Status Flush() {
    EVPOSE_RETURN_IF_ERROR(encoder_->Encode(events_, bytes_));
    events_.clear();
    return absl::OkStatus();
  }

  // Encodes a trigger, or adds an event to those to be encoded.
  absl::Status Take(const SourceEvent& event) {
    const bool is_trigger = event.trigger_input >= 0;
    int64_t t_us = 0;
    if (!TakeTime(event, is_trigger, t_us)) return absl::OkStatus();
    if (!is_trigger) {
      has_event_ = true;
      events_.push_back({t_us, static_cast<uint16_t>(event.x), static_cast<uint16_t>(event.y),
                         static_cast<uint8_t>(event.is_on ? 1 : 0)});
      return absl::OkStatus();
    }
    EVPOSE_RETURN_IF_ERROR(Flush());
    return encoder_->EncodeTrigger(
        {t_us, static_cast<uint8_t>(event.trigger_input), static_cast<uint8_t>(event.is_on ? 1 : 0)}, bytes_);
  }

  // The time on the clock of the output; false, after counting, if the event is left out.
  bool TakeTime(const SourceEvent& event, bool is_trigger, int64_t& t_us) {
    if (!is_trigger && !HasAddress(event)) {
      ++num_outside_;
      return false;
    }
    if (event.t_us < -kMaxStateTimeUs || event.t_us > kMaxStateTimeUs) {
      ++num_without_time_;
      return false;
    }
    const bool fits_clock = event.t_us >= 0 && event.t_us < kClockRangeUs;
    if (last_us_ < 0 && !fits_clock && is_trigger) {
      ++num_early_triggers_;
      return false;
    }
    if (last_us_ < 0 && !fits_clock) zero_us_ = event.t_us;
    t_us = event.t_us - zero_us_;
    if (t_us < 0) {
      ++num_early_;
      return false;
    }
    if (last_us_ >= 0 && std::abs(t_us - last_us_) > kMaxStepUs) {
      ++num_jumps_;
      return false;
    }
    last_us_ = t_us;
    return true;
  }

  const std::unique_ptr<EventSource> source_;
  RecordingHeader header_;
  const std::unique_ptr<EventEncoder> encoder_;
  std::vector<SourceEvent> from_file_;
  std::vector<Event> events_;
  std::vector<uint8_t> bytes_;  // of these events
  size_t begin_ = 0;            // of the bytes that Read() has not returned
  int64_t zero_us_ = 0;         // time of the file at time 0 of the events
  int64_t last_us_ = -1;        // -1 before the first event or trigger
  bool has_event_ = false;
  uint64_t num_outside_ = 0;
  uint64_t num_without_time_ = 0;
  uint64_t num_early_ = 0;
  uint64_t num_early_triggers_ = 0;
  uint64_t num_jumps_ = 0;
};

// The smallest known sensor that contains all events of the source.
absl::StatusOr<SensorGeometry> FindSensor(EventSource& source) {
  SensorGeometry extent;
  std::vector<SourceEvent> events;
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_more, source.Next(events));
    if (!has_more) break;
    for (const SourceEvent& event : events) {
      if (event.trigger_input >= 0 || !HasAddress(event)) continue;
      extent.width_px = std::max(extent.width_px, static_cast<int>(event.x) + 1);
      extent.height_px = std::max(extent.height_px, static_cast<int>(event.y) + 1);
    }
  }
  for (const SensorGeometry& sensor : kKnownSensors) {
    if (extent.width_px <= sensor.width_px && extent.height_px <= sensor.height_px) return sensor;
  }
  return extent;
}

}  // namespace

void AppendMerged(absl::Span<const Event> events, absl::Span<const Trigger> triggers, std::vector<SourceEvent>& out) {
  const auto append = [&out](const Event& event) {
    out.push_back({.t_us = event.t_us, .x = event.x, .y = event.y, .is_on = event.polarity == 1});
  };
  for (const Trigger& trigger : triggers) {
    for (; !events.empty() && events.front().t_us < trigger.t_us; events.remove_prefix(1)) append(events.front());
    out.push_back({.t_us = trigger.t_us, .is_on = trigger.polarity == 1, .trigger_input = trigger.id});
  }
  for (const Event& event : events) append(event);
}

absl::StatusOr<std::unique_ptr<RecordingReader>> MakeSourceReader(const std::string& name, const SourceOpener& open,
                                                                  std::optional<SensorGeometry> geometry,
                                                                  bool can_reopen) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<EventSource> source, open());
  RecordingHeader header;
  header.encoding = Encoding::kFlat64;
  header.container = source->facts().format;
  header.time_offset_us = source->facts().time_offset_us;
  header.metavision_zero_us = source->facts().metavision_zero_us;
  header.geometry_is_stated = source->facts().geometry.has_value();
  if (header.geometry_is_stated) geometry = source->facts().geometry;
  header.geometry_is_known = geometry.has_value();
  if (!geometry.has_value() && can_reopen) {
    EVPOSE_ASSIGN_OR_RETURN(geometry, FindSensor(*source));
    EVPOSE_ASSIGN_OR_RETURN(source, open());
  }
  header.geometry = geometry.value_or(kUnknownSensor);
  const absl::Status is_valid = ValidateGeometry(Encoding::kFlat64, header.geometry);
  if (!is_valid.ok()) return absl::InvalidArgumentError(absl::StrCat(name, ": ", is_valid.message()));
  // The encoder accepts all events that a decoder can report; the decoder knows the sensor.
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<EventEncoder> encoder,
                          MakeEventEncoder(Encoding::kFlat64, {kFlat64Addresses, kFlat64Addresses}));
  auto reader = std::make_unique<SourceReader>(std::move(source), std::move(header), std::move(encoder));
  EVPOSE_ASSIGN_OR_RETURN(const bool has_events, reader->Start());
  // The sum of the offset that the file states and the time of its first event, each within the range.
  const int64_t offset_us = reader->header().time_offset_us;
  if (has_events && std::abs(offset_us) <= kMaxStateTimeUs) return reader;
  if (has_events) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ": its time offset of ", offset_us, " us is beyond the range of 36 thousand years"));
  }
  std::string skipped;
  for (const SkippedParts& part : reader->skipped()) absl::StrAppend(&skipped, "; ", part.count, " ", part.what);
  return absl::InvalidArgumentError(absl::StrCat(name, ": has no event", skipped));
}

}  // namespace evpose::client
