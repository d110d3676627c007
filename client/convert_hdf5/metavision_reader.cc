// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <limits>
#include <optional>
#include <string>

#include "absl/strings/numbers.h"
#include "client/convert_hdf5/hdf5_reader.h"
#include "client/convert_hdf5/metavision_attributes.h"
#include "core/base/status_macros.h"
#include "core/events/image_size.h"

namespace evpose::client {
namespace {

class MetavisionReader final : public Hdf5Reader {
 public:
  MetavisionReader(Hdf5Handle file, Hdf5Column events, std::optional<Hdf5Column> triggers)
      : file_(std::move(file)), events_(std::move(events)), triggers_(std::move(triggers)) {
    header_.format = events_.ecf_chunk_size() > 0 ? "Metavision HDF5 (ECF)" : "Metavision HDF5";
    header_.geometry = ParseImageSize(ReadTextAttribute(file_, kGeometryAttribute)).value_or(SensorGeometry{});
    if (!absl::SimpleAtoi(ReadTextAttribute(file_, kTimeOffsetAttribute), &header_.time_offset_us)) {
      header_.time_offset_us = 0;
    }
    // As OpenEB's reader, which takes a text that is no number for 0.
    if (!absl::SimpleAtoi(ReadTextAttribute(file_, kTimeShiftAttribute), &header_.metavision_zero_us)) {
      header_.metavision_zero_us = 0;
    }
    header_.metavision_zero_us = std::max(header_.metavision_zero_us, int64_t{0});
  }

  bool Next(std::vector<Event>& events, std::vector<Trigger>& triggers) override {
    events.clear();
    triggers.clear();
    if (next_event_ < events_.size()) ReadEvents(events);
    if (!events.empty()) last_us_ = events.back().t_us;
    const bool events_are_left = next_event_ < events_.size();
    TakeTriggers(events_are_left ? last_us_ : std::numeric_limits<int64_t>::max(), triggers);
    return events_are_left || !events.empty() || !triggers.empty() || HasTriggers();
  }

 private:
  void ReadEvents(std::vector<Event>& events) {
    const uint64_t chunk = events_.ecf_chunk_size();
    const uint64_t count = std::min(chunk > 0 ? chunk : kMaxRows, events_.size() - next_event_);
    if (chunk > 0) {
      events_.ReadEcfChunk(next_event_, count, events);
      losses_.events += count - events.size();
      next_event_ += count;
      return;
    }
    rows_.resize(count);
    if (!events_.Read(next_event_, count, row_type_, rows_.data())) {
      losses_.events += count;
      rows_.clear();
    }
    for (const CdRow& row : rows_) {
      Event event;
      if (ToEvent(row, event)) {
        events.push_back(event);
      } else {
        ++losses_.invalid;
      }
    }
    next_event_ += count;
  }

  bool HasTriggers() const {
    return triggers_.has_value() && (next_trigger_ < triggers_->size() || trigger_ < trigger_rows_.size());
  }

  // Moves the triggers up to a time, at most kMaxPipeElements. Those of the file are in the order of time.
  void TakeTriggers(int64_t until_us, std::vector<Trigger>& triggers) {
    while (HasTriggers() && triggers.size() < kMaxPipeElements) {
      if (trigger_ == trigger_rows_.size()) {
        ReadTriggers();
        continue;
      }
      const TriggerRow& row = trigger_rows_[trigger_];
      if (row.t > until_us) return;
      ++trigger_;
      if (row.t < 0 || row.t > kMaxStateTimeUs || row.id < 0 || row.id > 255) {
        ++losses_.invalid;
      } else {
        triggers.push_back({row.t, static_cast<uint8_t>(row.id), static_cast<uint8_t>(row.p > 0 ? 1 : 0)});
      }
    }
  }

  void ReadTriggers() {
    const uint64_t count = std::min(kMaxRows, triggers_->size() - next_trigger_);
    trigger_rows_.resize(count);
    trigger_ = 0;
    if (!triggers_->Read(next_trigger_, count, trigger_type_, trigger_rows_.data())) {
      losses_.triggers += count;
      trigger_rows_.clear();
    }
    next_trigger_ += count;
  }

  const Hdf5Handle file_;
  const Hdf5Handle row_type_ = CdRowType();
  const Hdf5Handle trigger_type_ = TriggerRowType();
  Hdf5Column events_;
  std::optional<Hdf5Column> triggers_;
  uint64_t next_event_ = 0;
  uint64_t next_trigger_ = 0;  // index of the first trigger that has not been read
  std::vector<CdRow> rows_;
  std::vector<TriggerRow> trigger_rows_;
  size_t trigger_ = 0;  // index of the first of these that has not been moved
  int64_t last_us_ = -1;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Hdf5Reader>> OpenMetavision(Hdf5Handle file) {
  EVPOSE_ASSIGN_OR_RETURN(Hdf5Column events, Hdf5Column::Open(file, "/CD/events", H5T_COMPOUND));
  if (events.ecf_chunk_size() > kMaxPipeElements) {
    return absl::InvalidArgumentError("the dataset /CD/events has chunks of more events than ECF can hold");
  }
  std::optional<Hdf5Column> triggers;
  if (Hdf5Column::Exists(file, "/EXT_TRIGGER/events")) {
    EVPOSE_ASSIGN_OR_RETURN(triggers, Hdf5Column::Open(file, "/EXT_TRIGGER/events", H5T_COMPOUND));
  }
  return std::make_unique<MetavisionReader>(std::move(file), std::move(events), std::move(triggers));
}

}  // namespace evpose::client
