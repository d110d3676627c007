// SPDX-License-Identifier: Apache-2.0
#include "server/stores/common/checked_records.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/numerics/hash.h"
#include "evpose/storage/v1/store.pb.h"
#include "server/runtime/enum_number.h"
#include "server/stores/common/record_version.h"

namespace evpose::server {
namespace {

constexpr size_t kChecksumBytes = 4;  // of CRC-32C

uint32_t Crc(absl::string_view bytes) { return Crc32c({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}); }

// The checksum covers the name and the checksum of the bytes, so that large bytes need not be copied behind the name.
uint32_t ComputeChecksum(absl::string_view what, absl::string_view bytes) {
  StateWriter writer;
  writer.Bytes(what);
  writer(Crc(bytes));
  return Crc(writer.Take());
}

absl::Status Damaged(absl::string_view what, absl::string_view why) {
  return absl::DataLossError(absl::StrCat(what, " is damaged: ", why));
}

absl::Status DamagedChecksum(absl::string_view what) { return Damaged(what, "its checksum does not match"); }

static_assert(EnumNumber(ModelFormat::kMesh) == storage::v1::ModelFormat_MAX);

std::string RecordOf(absl::string_view session) { return absl::StrCat("the record of ", session); }
std::string ModelHeaderOf(absl::string_view tenant, absl::string_view name) {
  return absl::StrCat("the record of ", name, tenant.empty() ? "" : " of tenant ", tenant);
}
std::string ModelBytesOf(absl::string_view name) { return absl::StrCat("the file of ", name); }

}  // namespace

std::string AddChecksum(absl::string_view what, std::string bytes) {
  const uint32_t checksum = ComputeChecksum(what, bytes);
  bytes.append(reinterpret_cast<const char*>(&checksum), kChecksumBytes);
  return bytes;
}

std::string CopyWithChecksum(absl::string_view what, absl::string_view bytes) {
  // A piece is copied in about 0.1 ms, a tenth of a turn.
  constexpr size_t kPieceBytes = size_t{1} << 20;
  std::string copy;
  copy.reserve(bytes.size() + kChecksumBytes);
  for (size_t begin = 0; begin < bytes.size(); begin += kPieceBytes) {
    absl::StrAppend(&copy, bytes.substr(begin, kPieceBytes));
    YieldPoint();
  }
  return AddChecksum(what, std::move(copy));
}

absl::StatusOr<std::string> VerifyChecksum(absl::string_view what, std::string encoded) {
  if (encoded.size() < kChecksumBytes) return DamagedChecksum(what);
  const uint32_t checksum = ChecksumOf(encoded);
  encoded.resize(encoded.size() - kChecksumBytes);
  if (checksum != ComputeChecksum(what, encoded)) return DamagedChecksum(what);
  return encoded;
}

uint32_t ChecksumOf(absl::string_view encoded) {
  uint32_t checksum = 0;
  if (encoded.size() >= kChecksumBytes)
    std::memcpy(&checksum, encoded.data() + encoded.size() - kChecksumBytes, kChecksumBytes);
  return checksum;
}

std::string CheckpointOf(absl::string_view session) { return absl::StrCat("the checkpoint of ", session); }

std::string LifecycleOf(absl::string_view session) { return absl::StrCat("the lifecycle of ", session); }

std::string PosesOf(absl::string_view session, uint64_t first_pose_seq, uint64_t last_pose_seq) {
  return absl::StrCat("the poses ", first_pose_seq, " to ", last_pose_seq, " of ", session);
}

std::string EncodeRecord(const SessionRecord& record) {
  storage::v1::SessionRecord stored;
  stored.set_tenant(record.tenant);
  stored.set_request_id(record.request_id);
  stored.set_create_time_ns(absl::ToUnixNanos(record.create_time));
  stored.set_config(record.config);
  return AddChecksum(RecordOf(record.name), SerializeRecord(stored));
}

absl::StatusOr<SessionRecord> DecodeRecord(absl::string_view session, std::string encoded) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, VerifyChecksum(RecordOf(session), std::move(encoded)));
  storage::v1::SessionRecord stored;
  if (!ParseRecord(bytes, stored)) return Damaged(RecordOf(session), "it cannot be parsed");
  return SessionRecord{.name = std::string(session),
                       .tenant = stored.tenant(),
                       .request_id = stored.request_id(),
                       .create_time = absl::FromUnixNanos(stored.create_time_ns()),
                       .config = stored.config()};
}

std::string EncodeModelHeader(const ModelRecord& model) {
  storage::v1::ModelHeader stored;
  stored.set_format(EnumNumber<storage::v1::ModelFormat>(model.reading.format));
  stored.set_metres_per_unit(model.reading.metres_per_unit);
  stored.set_crease_angle_deg(model.reading.crease_angle_deg);
  stored.set_keeps_facets(!model.reading.is_smooth);
  stored.set_create_time_ns(absl::ToUnixNanos(model.create_time));
  stored.set_summary(model.summary);
  stored.set_file_bytes(model.bytes->size());
  return AddChecksum(ModelHeaderOf(model.tenant, model.name), SerializeRecord(stored));
}

absl::StatusOr<ModelRecord> DecodeModelHeader(absl::string_view tenant, absl::string_view name, std::string encoded,
                                              uint64_t encoded_bytes) {
  const std::string what = ModelHeaderOf(tenant, name);
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, VerifyChecksum(what, std::move(encoded)));
  storage::v1::ModelHeader stored;
  if (!ParseRecord(bytes, stored)) return Damaged(what, "it cannot be parsed");
  if (stored.format() < storage::v1::MODEL_FORMAT_OBJ || stored.format() > storage::v1::MODEL_FORMAT_MESH) {
    return Damaged(what, "the format of the file is unknown");
  }
  const uint64_t all_bytes = encoded_bytes - std::min<uint64_t>(encoded_bytes, kChecksumBytes);
  if (stored.file_bytes() > all_bytes) return Damaged(ModelBytesOf(name), "it is too short");
  return ModelRecord{.name = std::string(name),
                     .tenant = std::string(tenant),
                     .reading = {.format = EnumValue<ModelFormat>(stored.format()),
                                 .metres_per_unit = stored.metres_per_unit(),
                                 .crease_angle_deg = stored.crease_angle_deg(),
                                 .is_smooth = !stored.keeps_facets()},
                     .create_time = absl::FromUnixNanos(stored.create_time_ns()),
                     .summary = stored.summary(),
                     .file_bytes = stored.file_bytes() > 0 ? stored.file_bytes() : all_bytes};
}

std::string EncodeModelBytes(const ModelRecord& model) {
  std::string all(reinterpret_cast<const char*>(model.bytes->data()), model.bytes->size());
  return AddChecksum(ModelBytesOf(model.name), all.append(model.prepared));
}

absl::Status DecodeModelBytes(const std::string& encoded, ModelRecord& model) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string all, VerifyChecksum(ModelBytesOf(model.name), encoded));
  const auto file_end = all.begin() + static_cast<std::ptrdiff_t>(std::min<uint64_t>(model.file_bytes, all.size()));
  model.bytes = std::make_shared<const std::vector<uint8_t>>(all.begin(), file_end);
  model.prepared.assign(file_end, all.end());
  return absl::OkStatus();
}

absl::Status CheckWhole(absl::string_view session, const std::vector<PoseSegment>& poses, uint64_t first_pose_seq_kept,
                        uint64_t next_pose_seq) {
  uint64_t expected = poses.empty() ? next_pose_seq : poses.front().first_pose_seq;
  bool is_whole = poses.empty() ? first_pose_seq_kept >= next_pose_seq : expected <= first_pose_seq_kept;
  for (const PoseSegment& segment : poses) {
    is_whole = is_whole && segment.first_pose_seq == expected;
    expected = segment.last_pose_seq + 1;
  }
  if (is_whole && expected == next_pose_seq) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat("poses of ", session, " are missing between ", first_pose_seq_kept, " and ", next_pose_seq - 1));
}

bool IsMissingOrDamaged(const absl::Status& status) { return absl::IsNotFound(status) || absl::IsDataLoss(status); }

void NoteDamage(absl::string_view what, const absl::Status& status, std::vector<std::string>& damage) {
  if (absl::IsDataLoss(status)) damage.push_back(absl::StrCat(what, ": ", status.message()));
}

}  // namespace evpose::server
