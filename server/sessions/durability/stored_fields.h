// SPDX-License-Identifier: Apache-2.0

// Functions that decode the messages of evpose.storage.v1.
#pragma once

#include <algorithm>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "core/tracking/object/pose_estimate.h"
#include "google/protobuf/generated_enum_reflection.h"
#include "google/protobuf/message.h"
#include "google/protobuf/repeated_field.h"
#include "server/runtime/enum_number.h"
#include "server/stores/common/record_version.h"

namespace evpose::server {

// Collects the first error of a record. Decoding continues after it; the decoded values are not used then.
class RecordCheck {
 public:
  explicit RecordCheck(absl::string_view record) : record_(record) {}

  void Require(bool good, absl::string_view what) {
    if (!good && what_.empty()) what_ = std::string(what);
  }
  void Parse(absl::string_view bytes, google::protobuf::Message& message) {
    Require(ParseRecord(bytes, message), "it cannot be parsed");
  }
  absl::Status Finish() const {
    if (what_.empty()) return absl::OkStatus();
    return absl::DataLossError(absl::StrCat("the ", record_, " is damaged: ", what_));
  }

 private:
  const std::string record_;
  std::string what_;
};

// An enum that is absent keeps the default of `value`.
template <typename Value, typename Stored>
void EnumFromStored(Stored stored, RecordCheck& check, Value& value) {
  const bool is_known = google::protobuf::GetEnumDescriptor<Stored>()->FindValueByNumber(stored) != nullptr;
  check.Require(is_known, "a choice that this version does not know");
  if (is_known && stored != Stored()) value = EnumValue<Value>(stored);
}

using Numbers = google::protobuf::RepeatedField<double>;

inline void SetNumbers(const auto& matrix, Numbers& numbers) {
  numbers.Assign(matrix.data(), matrix.data() + matrix.size());
}

inline void GetNumbers(const Numbers& numbers, RecordCheck& check, auto& matrix) {
  const bool fits = numbers.size() == static_cast<int>(matrix.size());
  check.Require(fits, "a matrix or a vector has another size");
  if (fits) std::copy(numbers.begin(), numbers.end(), matrix.data());
}

// The value that earlier servers know and that comes nearest to `value` (proto/evpose/storage/README.md, rule 5).
inline TrackState Earlier(TrackState state) { return state == TrackState::kAmbiguous ? TrackState::kDegraded : state; }

inline InitializationStatus Earlier(InitializationStatus status) {
  switch (status) {
    case InitializationStatus::kNotEnoughMotion:
      return InitializationStatus::kWaitingForEvents;
    case InitializationStatus::kTooSmall:
      return InitializationStatus::kTooFewLines;
    case InitializationStatus::kNotSupported:
      return InitializationStatus::kNoPoseFits;
    default:
      return status;
  }
}

}  // namespace evpose::server
