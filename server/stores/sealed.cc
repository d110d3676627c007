// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sealed.h"

#include <array>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"

namespace evpose::server {
namespace {

constexpr size_t kSealBytes = 4;

uint32_t Crc(absl::string_view bytes) { return Crc32c({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}); }

// The bytes may be large and are read once: what is sealed is the checksum of the bytes beside their name.
uint32_t SealFor(absl::string_view what, absl::string_view bytes) {
  StateWriter writer;
  writer.Bytes(what);
  writer(Crc(bytes));
  return Crc(writer.Take());
}

absl::Status DamagedChecksum(absl::string_view what) {
  return absl::DataLossError(absl::StrCat(what, " is damaged: its checksum does not match"));
}

std::string RecordOf(absl::string_view session) { return absl::StrCat("the record of ", session); }
std::string ModelHeaderOf(absl::string_view tenant, absl::string_view name) {
  return absl::StrCat("the record of ", name, tenant.empty() ? "" : " of tenant ", tenant);
}
std::string ModelBytesOf(absl::string_view name) { return absl::StrCat("the file of ", name); }

}  // namespace

std::string Seal(absl::string_view what, std::string bytes) {
  const uint32_t seal = SealFor(what, bytes);
  bytes.append(reinterpret_cast<const char*>(&seal), kSealBytes);
  return bytes;
}

absl::StatusOr<std::string> Unseal(absl::string_view what, std::string sealed) {
  if (sealed.size() < kSealBytes) return DamagedChecksum(what);
  const uint32_t seal = SealOf(sealed);
  sealed.resize(sealed.size() - kSealBytes);
  if (seal != SealFor(what, sealed)) return DamagedChecksum(what);
  return sealed;
}

uint32_t SealOf(absl::string_view sealed) {
  uint32_t seal = 0;
  if (sealed.size() >= kSealBytes) std::memcpy(&seal, sealed.data() + sealed.size() - kSealBytes, kSealBytes);
  return seal;
}

std::string CheckpointOf(absl::string_view session) { return absl::StrCat("the checkpoint of ", session); }

std::string LifecycleOf(absl::string_view session) { return absl::StrCat("the lifecycle of ", session); }

std::string PosesOf(absl::string_view session, uint64_t first_pose_seq, uint64_t last_pose_seq) {
  return absl::StrCat("the poses ", first_pose_seq, " to ", last_pose_seq, " of ", session);
}

std::string SealRecord(const SessionRecord& record) {
  StateWriter writer;
  writer(record.tenant, record.request_id, absl::ToUnixNanos(record.create_time), record.config);
  return Seal(RecordOf(record.name), writer.Take());
}

absl::StatusOr<SessionRecord> UnsealRecord(absl::string_view session, std::string sealed) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, Unseal(RecordOf(session), std::move(sealed)));
  SessionRecord record;
  record.name = std::string(session);
  int64_t create_time_ns = 0;
  StateReader reader(bytes);
  reader(record.tenant, record.request_id, create_time_ns, record.config);
  if (!reader.Finish().ok()) return DamagedChecksum(RecordOf(session));
  record.create_time = absl::FromUnixNanos(create_time_ns);
  return record;
}

std::string SealModelHeader(const ModelRecord& model) {
  StateWriter writer;
  writer(static_cast<uint8_t>(model.format), model.metres_per_unit, model.crease_angle_deg,
         absl::ToUnixNanos(model.create_time));
  return Seal(ModelHeaderOf(model.tenant, model.name), writer.Take());
}

absl::StatusOr<ModelRecord> UnsealModelHeader(absl::string_view tenant, absl::string_view name, std::string sealed) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, Unseal(ModelHeaderOf(tenant, name), std::move(sealed)));
  ModelRecord model;
  model.tenant = std::string(tenant);
  model.name = std::string(name);
  uint8_t format = 0;
  int64_t create_time_ns = 0;
  StateReader reader(bytes);
  reader(AtMost(format, static_cast<uint8_t>(ModelFormat::kStl)), model.metres_per_unit, model.crease_angle_deg,
         create_time_ns);
  if (!reader.Finish().ok()) return DamagedChecksum(ModelHeaderOf(tenant, name));
  model.format = static_cast<ModelFormat>(format);
  model.create_time = absl::FromUnixNanos(create_time_ns);
  return model;
}

std::string SealModelBytes(const ModelRecord& model) {
  return Seal(ModelBytesOf(model.name),
              std::string(reinterpret_cast<const char*>(model.bytes->data()), model.bytes->size()));
}

absl::StatusOr<std::shared_ptr<const std::vector<uint8_t>>> UnsealModelBytes(absl::string_view name,
                                                                             std::string sealed) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, Unseal(ModelBytesOf(name), std::move(sealed)));
  return std::make_shared<const std::vector<uint8_t>>(bytes.begin(), bytes.end());
}

absl::Status CheckWhole(absl::string_view session, const std::vector<PoseSegment>& poses, uint64_t first_pose_seq_kept,
                        uint64_t next_pose_seq) {
  uint64_t expected = poses.empty() ? next_pose_seq : poses.front().first_pose_seq;
  bool whole = poses.empty() ? first_pose_seq_kept >= next_pose_seq : expected <= first_pose_seq_kept;
  for (const PoseSegment& segment : poses) {
    whole = whole && segment.first_pose_seq == expected;
    expected = segment.last_pose_seq + 1;
  }
  if (whole && expected == next_pose_seq) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat("poses of ", session, " are missing between ", first_pose_seq_kept, " and ", next_pose_seq - 1));
}

}  // namespace evpose::server
