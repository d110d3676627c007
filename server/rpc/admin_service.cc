// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/admin_service.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "core/base/status_macros.h"
#include "core/base/version.h"
#include "server/rpc/common/authentication.h"
#include "server/rpc/common/conversion.h"
#include "server/runtime/enum_number.h"
#include "server/runtime/errors.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

absl::Status CheckIsOperator(const Caller& caller, absl::string_view action) {
  if (caller.is_operator) return absl::OkStatus();
  return WithReason(absl::PermissionDeniedError(absl::StrCat("the caller is not an operator and may not ", action,
                                                             ": use a token that the token file marks as `operator`")),
                    v1::NOT_OPERATOR);
}

static_assert(EnumNumber(LogLevel::kOff) == v1::LogLevel_MAX);
static_assert(EnumNumber(StoreKind::kPostgresql) == v1::StoreKind_MAX);

absl::StatusOr<LogLevel> LogLevelFromProto(v1::LogLevel level) {
  if (level >= v1::LOG_LEVEL_DEBUG && level <= v1::LOG_LEVEL_OFF) return EnumValue<LogLevel>(level);
  return InvalidField("level", absl::StrCat("is ", level, "; 1 (debug) to 5 (off)"));
}

// Writes the line at the more verbose of the two levels, so that it is in the log in both directions.
void ChangeLogLevel(const Caller& caller, LogLevel before, LogLevel after) {
  if (after < before) SetLogLevel(after);
  Log(LogLevel::kInfo, "log_level_changed",
      {{"tenant", caller.tenant}, {"peer", caller.peer}, {"from", LogLevelName(before)}, {"to", LogLevelName(after)}});
  SetLogLevel(after);
}

}  // namespace

grpc::ServerUnaryReactor* AdminServiceImpl::GetServerInfo(grpc::CallbackServerContext* context,
                                                          const v1::GetServerInfoRequest*, v1::ServerInfo* response) {
  return FinishUnary(services_, context, response, [this, response](const Caller& caller) {
    const SessionManager::Options& options = services_.sessions.options();
    const BuildVersion build = ThisBuild();
    response->set_version(build.version);
    response->set_commit(build.commit);
    response->set_active_sessions(caller.is_operator ? services_.sessions.num_sessions()
                                                     : services_.sessions.num_sessions_of(caller.tenant));
    response->set_max_sessions(options.max_sessions);
    response->set_draining(!services_.sessions.CheckNotDraining().ok());
    response->set_max_chunk_bytes(options.limits.max_chunk_bytes);
    response->set_store(EnumNumber<v1::StoreKind>(services_.store.kind()));
    response->set_max_model_bytes(services_.max_model_bytes);
    response->set_pose_log_capacity(options.limits.pose_log_capacity);
    *response->mutable_session_expiry() = ToProto(options.limits.expiry);
    if (caller.is_operator) response->set_skipped_events(services_.sessions.skipped_events());
    *response->mutable_time() = ToProto(absl::Now());
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* AdminServiceImpl::Drain(grpc::CallbackServerContext* context, const v1::DrainRequest* request,
                                                  v1::DrainResponse* response) {
  return FinishUnary(services_, context, response, [this, request, response](const Caller& caller) -> absl::Status {
    EVPOSE_RETURN_IF_ERROR(CheckIsOperator(caller, "drain the server"));
    const absl::Duration deadline = request->has_timeout() ? FromProto(request->timeout()) : services_.drain_timeout;
    if (deadline < absl::ZeroDuration()) {
      return InvalidField("timeout", "is below 0; give the time that streams may take to finish");
    }
    services_.drainer.Drain(deadline);
    response->set_remaining_sessions(services_.sessions.num_attached());
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* AdminServiceImpl::SetLogLevel(grpc::CallbackServerContext* context,
                                                        const v1::SetLogLevelRequest* request,
                                                        v1::SetLogLevelResponse* response) {
  return FinishUnary(services_, context, response, [request, response](const Caller& caller) -> absl::Status {
    EVPOSE_RETURN_IF_ERROR(CheckIsOperator(caller, "set the log level"));
    EVPOSE_ASSIGN_OR_RETURN(const LogLevel level, LogLevelFromProto(request->level()));
    const LogLevel before = CurrentLogLevel();
    response->set_previous_level(EnumNumber<v1::LogLevel>(before));
    ChangeLogLevel(caller, before, level);
    return absl::OkStatus();
  });
}

}  // namespace evpose::server
