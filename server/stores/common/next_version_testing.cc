// SPDX-License-Identifier: Apache-2.0

// The records of a version after this one: higher versions of what is derived, and a field that this version does not
// know, in every message of every record. It replaces record_version.cc in evpose-server-next.
#include <memory>
#include <vector>

#include "google/protobuf/descriptor.h"
#include "google/protobuf/unknown_field_set.h"
#include "server/stores/common/record_version.h"
#include "server/stores/common/yielding_serialization.h"

namespace evpose::server {
namespace {

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::UnknownField;

// No message of this version has a field of this number. Absent: written by this version.
constexpr int kLaterField = 1000;
constexpr uint64_t kLaterValue = 0x6c61746572;

// Calls `visit` for a message and all messages in it.
void VisitMessages(Message& message, const auto& visit) {
  visit(message);
  const google::protobuf::Reflection& reflection = *message.GetReflection();
  std::vector<const FieldDescriptor*> fields;
  reflection.ListFields(message, &fields);
  for (const FieldDescriptor* field : fields) {
    if (field->cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE) continue;
    if (!field->is_repeated()) {
      VisitMessages(*reflection.MutableMessage(&message, field), visit);
      continue;
    }
    for (int i = 0; i < reflection.FieldSize(message, field); ++i) {
      VisitMessages(*reflection.MutableRepeatedMessage(&message, field, i), visit);
    }
  }
}

bool IsOfThisVersionOrNext(const Message& message) {
  const auto& unknown = message.GetReflection()->GetUnknownFields(message);
  if (unknown.field_count() == 0) return true;
  const UnknownField& field = unknown.field(0);
  return unknown.field_count() == 1 && field.number() == kLaterField && field.type() == UnknownField::TYPE_VARINT &&
         field.varint() == kLaterValue;
}

}  // namespace

// No version of the server comes to these numbers.
const uint32_t kTrackerStateVersion = 1'000'000;
const uint32_t kPreparationVersion = 1'000'000;

std::string SerializeRecord(const Message& record) {
  const std::unique_ptr<Message> later(record.New());
  later->CopyFrom(record);
  VisitMessages(*later, [](Message& message) {
    auto& unknown = *message.GetReflection()->MutableUnknownFields(&message);
    unknown.Clear();
    unknown.AddVarint(kLaterField, kLaterValue);
  });
  return SerializeYielding(*later);
}

bool ParseRecord(absl::string_view bytes, Message& record) {
  if (!record.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return false;
  bool is_known = true;
  VisitMessages(record, [&is_known](Message& message) { is_known = is_known && IsOfThisVersionOrNext(message); });
  return is_known;
}

}  // namespace evpose::server
