// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_factory.h"

#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/initialization/check_lines.h"
#include "server/runtime/client_text.h"
#include "server/runtime/errors.h"
#include "server/runtime/random_name.h"
#include "server/sessions/durability/pose_codec.h"
#include "server/sessions/durability/session_codec.h"

namespace evpose::server {
namespace {

// The error for a client, from an error of the store.
absl::Status StoreError(absl::string_view name, const absl::Status& status) {
  switch (status.code()) {
    case absl::StatusCode::kNotFound:
      return SessionNotFound(name);
    case absl::StatusCode::kDataLoss:
      return WithReason(
          absl::DataLossError(absl::StrCat(name, " cannot be resumed because its stored state is damaged (",
                                           status.message(), "): delete it and create a new one")),
          v1::SESSION_DAMAGED, {{"session", std::string(name)}});
    default:
      return FromStore(status);
  }
}

absl::Status Damaged(absl::string_view what) { return absl::DataLossError(what); }

absl::StatusOr<std::vector<StoredPose>> DecodeLog(const std::vector<PoseSegment>& segments, size_t num_objects) {
  std::vector<StoredPose> poses;
  for (const PoseSegment& segment : segments) {
    EVPOSE_ASSIGN_OR_RETURN(std::vector<StoredPose> more, DecodePoses(segment, num_objects));
    if (!poses.empty() && more.front().pose_seq != poses.back().pose_seq + 1) {
      return Damaged(absl::StrCat("the poses before ", more.front().pose_seq, " are missing"));
    }
    std::move(more.begin(), more.end(), std::back_inserter(poses));
  }
  return poses;
}

// `after_pose_seq`: `stored` has only the poses after this one.
absl::StatusOr<SessionBeginning> DecodeBeginning(const StoredSession& stored, size_t num_objects,
                                                 uint64_t after_pose_seq = 0) {
  SessionBeginning beginning;
  EVPOSE_ASSIGN_OR_RETURN(beginning.lifecycle, DecodeLifecycle(stored.lifecycle));
  EVPOSE_ASSIGN_OR_RETURN(beginning.poses, DecodeLog(stored.poses, num_objects));
  if (!stored.checkpoint.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(beginning.checkpoint, DecodeCheckpoint(stored.checkpoint, num_objects));
    const uint64_t last = beginning.poses.empty() ? after_pose_seq : beginning.poses.back().pose_seq;
    if (last < beginning.checkpoint.health.poses) {
      return Damaged(absl::StrCat("the poses up to ", beginning.checkpoint.health.poses, " are missing"));
    }
  }
  return beginning;
}

SessionInfo Describe(const SessionRecord& record, SessionConfig config, const SessionBeginning& beginning,
                     absl::Duration expiry) {
  SessionInfo info = {.name = record.name, .config = std::move(config), .create_time = record.create_time};
  SessionSnapshot& snapshot = info.snapshot;
  snapshot.health = StoredHealth(beginning.checkpoint, beginning.lifecycle);
  snapshot.health.objects.resize(info.config.objects.size());
  const std::optional<absl::Time> detached_at = beginning.lifecycle.detached_at;
  snapshot.state = detached_at.has_value() ? SessionState::kDetached : SessionState::kAttached;
  if (beginning.checkpoint.has_ended) snapshot.state = SessionState::kEnded;
  if (detached_at.has_value()) snapshot.expire_time = *detached_at + expiry;
  return info;
}

}  // namespace

absl::Status SessionNotFound(absl::string_view name) {
  return WithReason(
      absl::NotFoundError(absl::StrCat("there is no session \"", Shortened(name),
                                       "\": it was never created, was deleted, or expired; create a new one")),
      v1::SESSION_NOT_FOUND, {{"session", Shortened(name)}});
}

absl::StatusOr<SessionFactory::Models> SessionFactory::UseModels(const std::string& tenant, const SessionConfig& config,
                                                                 bool are_charged) const {
  Models models;
  for (const ObjectConfig& object : config.objects) {
    EVPOSE_ASSIGN_OR_RETURN(ModelUse use, models_.UseStored(tenant, object.model));
    if (const absl::Status status = CheckIsTrackable(*use.model); !status.ok()) {
      return InvalidField(absl::StrCat("config.objects[", models.models.size(), "].model"), status.message());
    }
    if (are_charged) {
      EVPOSE_ASSIGN_OR_RETURN(MemoryCharge charge, options_.memory->Charge(tenant, {}, MemoryOfModels({use.model})));
      models.charges.push_back(std::move(charge));
    }
    models.models.push_back(std::move(use.model));
    models.uses.push_back(std::move(use.use));
  }
  return models;
}

SessionParts SessionFactory::MakeParts(const std::string& name, const std::string& tenant) const {
  return {.name = name,
          .tenant = tenant,
          .limits = options_.limits,
          .clocks = options_.clocks,
          .metrics = options_.metrics};
}

SessionMemory SessionFactory::MemoryOf(const SessionConfig& config,
                                       const std::vector<std::shared_ptr<const ObjectModel>>& models) const {
  const SessionLimits& limits = options_.limits;
  return MaxSessionMemory(
      config, models,
      {limits.credit_bytes, limits.max_chunk_bytes, limits.pose_log_capacity, limits.writes_checkpoints});
}

absl::StatusOr<std::shared_ptr<Session>> SessionFactory::MakeNew(const std::string& tenant, const SessionConfig& config,
                                                                 const std::string& request_id) const {
  absl::StatusOr<Models> models = UseModels(tenant, config, /*are_charged=*/true);
  if (!models.ok()) return absl::IsDataLoss(models.status()) ? FromStore(models.status()) : models.status();
  EVPOSE_ASSIGN_OR_RETURN(MemoryCharge charge, options_.memory->Charge(tenant, MemoryOf(config, models->models),
                                                                       MemoryOfModels(models->models)));
  EVPOSE_ASSIGN_OR_RETURN(const std::string name, store_.NewSessionName(tenant, request_id));
  SessionParts parts = MakeParts(name, tenant);
  EVPOSE_ASSIGN_OR_RETURN(parts.pipeline, SlowExecutor::OrCancelled([&] {
                            return SessionPipeline::Create(config, models->models, options_.make_tracker);
                          }));
  parts.pipeline->HoldCharge(std::move(charge.tracking));
  parts.memory_charge = std::move(charge.other);
  EVPOSE_ASSIGN_OR_RETURN(parts.resume_token, RandomHex128());
  parts.config = config;
  parts.model_uses = std::move(models->uses);
  parts.create_time = options_.clocks.wall();
  parts.beginning.lifecycle = {.token_digest = TokenDigest(parts.resume_token), .detached_at = parts.create_time};
  const SessionRecord record = {.name = parts.name,
                                .tenant = tenant,
                                .request_id = request_id,
                                .create_time = parts.create_time,
                                .config = EncodeConfig(config)};
  auto lease = store_.CreateSession(record, EncodeLifecycle(parts.beginning.lifecycle));
  if (absl::IsAlreadyExists(lease.status())) return lease.status();
  if (!lease.ok()) return StoreError(parts.name, lease.status());
  if (const absl::Status status = CheckModelsStored(tenant, config); !status.ok()) {
    (void)store_.DeleteSession(parts.name);  // no client has its name; if the deletion fails, it expires
    return status;
  }
  parts.lease = *std::move(lease);
  return Session::Start(std::move(parts), pool_);
}

// To be called after the session has been stored: a server that deletes a model searches for sessions afterwards.
absl::Status SessionFactory::CheckModelsStored(const std::string& tenant, const SessionConfig& config) const {
  for (const ObjectConfig& object : config.objects) {
    EVPOSE_RETURN_IF_ERROR(models_.CheckStored(tenant, object.model));
  }
  return absl::OkStatus();
}

absl::StatusOr<SessionFactory::Resumed> SessionFactory::Resume(absl::string_view name) const {
  auto acquired = store_.AcquireSession(name);
  if (!acquired.ok()) return StoreError(name, acquired.status());
  Resumed out = {.record = acquired->session.record};
  auto session = Restore(std::move(acquired->session), std::move(acquired->lease));
  if (!session.ok()) return StoreError(name, session.status());
  out.session = *std::move(session);
  return out;
}

absl::StatusOr<std::shared_ptr<Session>> SessionFactory::Restore(StoredSession stored,
                                                                 std::unique_ptr<SessionLease> lease) const {
  SessionParts parts = MakeParts(stored.record.name, stored.record.tenant);
  EVPOSE_ASSIGN_OR_RETURN(parts.config, DecodeConfig(stored.record.config));
  EVPOSE_ASSIGN_OR_RETURN(parts.beginning, DecodeBeginning(stored, parts.config.objects.size()));
  parts.stored_poses = std::move(stored.poses);
  const bool has_ended = parts.beginning.checkpoint.has_ended;
  auto models = UseModels(stored.record.tenant, parts.config, /*are_charged=*/false);
  // An ended session is readable without its models.
  const std::vector<std::shared_ptr<const ObjectModel>> used = models.ok() ? models->models : Models().models;
  SessionMemory memory = MemoryOf(parts.config, used);
  if (has_ended) memory.tracking_bytes = 0;
  MemoryCharge charge = options_.memory->ChargeBeyondLimit(
      stored.record.tenant, memory, has_ended ? std::vector<ModelMemory>() : MemoryOfModels(used));
  parts.memory_charge = std::move(charge.other);
  if (has_ended && models.ok()) parts.model_uses = std::move(models->uses);
  if (!has_ended) {
    if (absl::IsNotFound(models.status())) return Damaged(models.status().message());
    EVPOSE_RETURN_IF_ERROR(models.status());
    EVPOSE_ASSIGN_OR_RETURN(parts.pipeline, RestorePipeline(parts.config, models->models, parts.beginning));
    parts.pipeline->HoldCharge(std::move(charge.tracking));
    parts.model_uses = std::move(models->uses);
  }
  parts.lease = std::move(lease);
  parts.create_time = stored.record.create_time;
  const std::optional<TrackingRestarted> restarted = parts.beginning.restarted;
  std::shared_ptr<Session> session = Session::Start(std::move(parts), pool_);
  const uint64_t charged_bytes = options_.memory->charged_bytes();
  if (charged_bytes > options_.memory->max_bytes()) {
    session->log().MemoryExceeded(charged_bytes, options_.memory->max_bytes());
  }
  if (restarted.has_value()) {
    session->log().TrackerStateUnreadable(restarted->detail, restarted->after_seq + 1, session->Watch().last_pose_seq);
  }
  return session;
}

absl::StatusOr<std::unique_ptr<SessionPipeline>> SessionFactory::RestorePipeline(
    const SessionConfig& config, const std::vector<std::shared_ptr<const ObjectModel>>& models,
    SessionBeginning& beginning) const {
  const auto create = [&](auto function) {
    return SlowExecutor::OrCancelled([&] { return function(config, models, options_.make_tracker); });
  };
  EVPOSE_ASSIGN_OR_RETURN(auto pipeline, create(SessionPipeline::Create));
  SessionCheckpoint& checkpoint = beginning.checkpoint;
  if (!checkpoint.pipeline.has_value()) return pipeline;
  const PipelineState state = *std::exchange(checkpoint.pipeline, std::nullopt);
  if (const absl::Status loaded = pipeline->LoadTracker(state.tracker); !loaded.ok()) {
    EVPOSE_ASSIGN_OR_RETURN(pipeline, create(SessionPipeline::CreateSearching));
    // The new tracker does not reproduce the stored poses after the checkpoint.
    if (!beginning.poses.empty()) {
      checkpoint.health.poses = std::max(checkpoint.health.poses, beginning.poses.back().pose_seq);
    }
    beginning.restarted = {checkpoint.processed_seq, std::string(loaded.message()), checkpoint.health.poses};
  }
  EVPOSE_RETURN_IF_ERROR(pipeline->LoadPosition(state.position));
  return pipeline;
}

absl::StatusOr<SessionFactory::Stored> SessionFactory::Read(absl::string_view name, uint64_t after_pose_seq) const {
  auto stored = store_.ReadSession(name, after_pose_seq);
  if (!stored.ok()) return StoreError(name, stored.status());
  auto decoded = Decode(*std::move(stored), after_pose_seq);
  if (!decoded.ok()) return StoreError(name, decoded.status());
  return decoded;
}

absl::StatusOr<std::vector<SessionFactory::Stored>> SessionFactory::ReadWithoutPoses(
    const std::vector<std::string>& names) const {
  auto sessions = store_.ReadWithoutPoses(names);
  if (!sessions.ok()) return FromStore(sessions.status());
  std::vector<Stored> decoded;
  for (StoredSession& session : *sessions) {
    auto one = Decode(std::move(session), kAfterAllPoses);
    if (one.ok()) decoded.push_back(*std::move(one));
  }
  return decoded;
}

absl::StatusOr<SessionFactory::Stored> SessionFactory::Decode(StoredSession stored, uint64_t after_pose_seq) const {
  EVPOSE_ASSIGN_OR_RETURN(SessionConfig config, DecodeConfig(stored.record.config));
  EVPOSE_ASSIGN_OR_RETURN(SessionBeginning beginning, DecodeBeginning(stored, config.objects.size(), after_pose_seq));
  Stored out = {.record = std::move(stored.record), .lifecycle = beginning.lifecycle};
  out.info = Describe(out.record, std::move(config), beginning, options_.limits.expiry);
  out.poses = std::move(beginning.poses);
  return out;
}

}  // namespace evpose::server
