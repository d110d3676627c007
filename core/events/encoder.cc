// SPDX-License-Identifier: Apache-2.0
#include "core/events/encoder.h"

#include <array>
#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/events/word_encoder.h"

namespace evpose {
namespace {

std::string TimeOf(std::optional<size_t> event) {
  return event.has_value() ? absl::StrCat("the time of event ", *event) : "the time";
}

}  // namespace

absl::StatusOr<std::unique_ptr<EventEncoder>> MakeEventEncoder(Encoding encoding, SensorGeometry geometry) {
  EVPOSE_RETURN_IF_ERROR(ValidateGeometry(encoding, geometry));
  // Indexed by Encoding.
  static constexpr std::array<std::unique_ptr<EventEncoder> (*)(SensorGeometry), kNumEncodings> kMakers = {
      MakeEvt3Encoder, MakeEvt21Encoder, MakeEvt2Encoder, MakeDatEncoder, MakeFlat64Encoder};
  return kMakers[static_cast<size_t>(encoding)](geometry);
}

absl::Status WordEncoder::Encode(absl::Span<const Event> events, std::vector<uint8_t>& out) {
  EVPOSE_RETURN_IF_ERROR(Check(events));
  if (events.empty()) return absl::OkStatus();
  EncodeChecked(events, out);
  last_us_ = events.back().t_us;
  last_written_us_ = last_us_;
  return absl::OkStatus();
}

absl::Status WordEncoder::EncodeTime(int64_t t_us, std::vector<uint8_t>& out) {
  if (!limits_.has_time_words) return absl::OkStatus();
  EVPOSE_RETURN_IF_ERROR(CheckOrder(std::nullopt, t_us, last_us_));
  EVPOSE_RETURN_IF_ERROR(CheckGap(std::nullopt, t_us, last_written_us_));
  EncodeCheckedTime(t_us, out);
  last_written_us_ = t_us;
  last_us_ = t_us;
  return absl::OkStatus();
}

absl::Status WordEncoder::EncodeTrigger(const Trigger& trigger, std::vector<uint8_t>& out) {
  if (limits_.num_trigger_inputs == 0) {
    return absl::UnimplementedError("the encoding has no triggers; EVT3, EVT2.1, EVT2 and FLAT64 have them");
  }
  if (trigger.id >= limits_.num_trigger_inputs || trigger.polarity > 1) {
    return absl::InvalidArgumentError(absl::StrCat("a trigger of input ", trigger.id, " and polarity ",
                                                   trigger.polarity, " does not fit the encoding, which has ",
                                                   limits_.num_trigger_inputs, " inputs"));
  }
  EVPOSE_RETURN_IF_ERROR(CheckOrder(std::nullopt, trigger.t_us, last_us_));
  EVPOSE_RETURN_IF_ERROR(CheckGap(std::nullopt, trigger.t_us, last_written_us_));
  EncodeCheckedTrigger(trigger, out);
  last_us_ = trigger.t_us;
  last_written_us_ = trigger.t_us;
  return absl::OkStatus();
}

absl::Status WordEncoder::CheckOrder(std::optional<size_t> event, int64_t t_us, int64_t previous_us) const {
  const bool is_ordered = t_us >= previous_us || !limits_.has_time_words;
  if (is_ordered && t_us >= 0) return absl::OkStatus();
  if (t_us < 0) {
    return absl::InvalidArgumentError(absl::StrCat(TimeOf(event), " is ", t_us, " us; it must not be negative"));
  }
  return absl::InvalidArgumentError(
      absl::StrCat(TimeOf(event), " is ", t_us, " us after ", previous_us, " us; times must not decrease"));
}

absl::Status WordEncoder::CheckGap(std::optional<size_t> event, int64_t t_us, int64_t previous_us) const {
  const bool is_first = previous_us < 0;
  const int64_t gap_us = is_first ? t_us : t_us - previous_us;
  const int64_t max_us = is_first ? limits_.max_first_us : limits_.max_gap_us;
  if (gap_us >= -max_us && gap_us <= max_us) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(TimeOf(event), " is ", t_us, " us, ", gap_us, " us after ",
                                                 is_first ? "the zero of the clock" : "the last written time",
                                                 "; at most ", max_us, " us can be encoded"));
}

absl::Status WordEncoder::Check(absl::Span<const Event> events) const {
  int64_t previous_us = last_us_;
  int64_t written_us = last_written_us_;
  for (size_t i = 0; i < events.size(); ++i) {
    const Event& event = events[i];
    if (event.t_us < 0 || event.t_us < previous_us || event.t_us != written_us) {
      EVPOSE_RETURN_IF_ERROR(CheckOrder(i, event.t_us, previous_us));
      EVPOSE_RETURN_IF_ERROR(CheckGap(i, event.t_us, written_us));
    }
    if (event.x >= geometry_.width_px || event.y >= geometry_.height_px) {
      return absl::InvalidArgumentError(absl::StrCat("event ", i, " at x ", event.x, ", y ", event.y,
                                                     " lies outside the sensor of ", geometry_.width_px, "x",
                                                     geometry_.height_px, " pixels"));
    }
    if (event.polarity > 1) {
      return absl::InvalidArgumentError(
          absl::StrCat("event ", i, " has polarity ", static_cast<int>(event.polarity), "; it must be 0 or 1"));
    }
    previous_us = event.t_us;
    written_us = event.t_us;
  }
  return absl::OkStatus();
}

size_t VectorRunLength(absl::Span<const Event> events) {
  const Event& first = events.front();
  size_t length = 1;
  while (length < events.size()) {
    const Event& event = events[length];
    const bool joins = event.t_us == first.t_us && event.y == first.y && event.polarity == first.polarity &&
                       event.x / kVectorPixels == first.x / kVectorPixels && event.x > events[length - 1].x;
    if (!joins) break;
    ++length;
  }
  return length;
}

uint32_t VectorMask(absl::Span<const Event> run) {
  uint32_t mask = 0;
  for (const Event& event : run) mask |= 1u << (event.x % kVectorPixels);
  return mask;
}

}  // namespace evpose
