// SPDX-License-Identifier: Apache-2.0
#include "server/stores/common/record_version.h"

#include "server/stores/common/yielding_serialization.h"

namespace evpose::server {

const uint32_t kTrackerStateVersion = 11;
const uint32_t kPreparationVersion = 12;

std::string SerializeRecord(const google::protobuf::Message& record) { return SerializeYielding(record); }

bool ParseRecord(absl::string_view bytes, google::protobuf::Message& record) {
  return record.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()));
}

}  // namespace evpose::server
