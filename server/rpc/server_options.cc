// SPDX-License-Identifier: Apache-2.0

// The checks of ServerOptions.
#include <unistd.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/connections/listen_address.h"
#include "server/rpc/server.h"
#include "server/runtime/errors.h"

namespace evpose::server {

absl::Status CheckDuration(absl::string_view field, absl::Duration duration) {
  if (duration < absl::ZeroDuration()) return InvalidField(field, "must not be negative");
  if (duration <= kLongestDuration) return absl::OkStatus();
  return InvalidField(field, absl::StrCat("is ", absl::FormatDuration(duration), "; at most a year, ",
                                          absl::ToInt64Seconds(kLongestDuration), " s"));
}

namespace {

// Checks where the server listens and how many threads it has.
absl::Status CheckServing(const ServerOptions& options) {
  // These are above the cores of any machine, and above the work that a store and preparations can do at a time.
  constexpr int kMaxWorkers = 1024;
  constexpr int kMaxSlowThreads = 64;
  if (!options.listen_address.empty()) {
    const auto address = ParseListenAddress(options.listen_address);
    if (!address.ok()) return InvalidField("listen_address", address.status().message());
  }
  if (const absl::Status status = options.tls.Validate(); !status.ok()) return InvalidField("tls", status.message());
  if (options.worker_threads < 0 || options.worker_threads > kMaxWorkers) {
    return InvalidField("worker_threads",
                        absl::StrCat("is ", options.worker_threads, "; give 0 (one per core) to ", kMaxWorkers));
  }
  if (options.slow_threads >= 1 && options.slow_threads <= kMaxSlowThreads) return absl::OkStatus();
  return InvalidField("slow_threads", absl::StrCat("is ", options.slow_threads, "; give 1 to ", kMaxSlowThreads));
}

// The preparation, size and number of models.
absl::Status CheckModels(const ServerOptions& options) {
  constexpr uint32_t kMaxCpuSeconds = 3600;             // the largest meshes take seconds
  constexpr uint64_t kMinPreparationBytes = 64u << 20;  // libraries and a small model
  if (!options.model_preparer.empty() && access(options.model_preparer.c_str(), X_OK) != 0) {
    return InvalidField("model_preparer", absl::StrCat(options.model_preparer, " cannot be run: install it there"));
  }
  const auto& budget = options.model_budget;
  if (budget.cpu_seconds == 0 || budget.cpu_seconds > kMaxCpuSeconds) {
    return InvalidField("model_budget.cpu_seconds",
                        absl::StrCat("is ", budget.cpu_seconds, "; give 1 to ", kMaxCpuSeconds));
  }
  if (budget.memory_bytes < kMinPreparationBytes) {
    return InvalidField("model_budget.memory_bytes",
                        absl::StrCat("is ", budget.memory_bytes, "; give at least ", kMinPreparationBytes));
  }
  if (options.max_uploads == 0) return InvalidField("max_uploads", "is 0; give at least 1");
  if (options.max_model_bytes == 0) return InvalidField("max_model_bytes", "is 0; give at least 1");
  if (options.max_model_store_bytes < options.max_model_bytes) {
    return InvalidField("max_model_store_bytes",
                        absl::StrCat("is ", options.max_model_store_bytes, "; give at least ", options.max_model_bytes,
                                     ", the size of the largest model"));
  }
  const uint64_t tenant_bytes = options.tenant.max_model_bytes.value_or(0);
  if (tenant_bytes == 0 || tenant_bytes >= options.max_model_bytes) return absl::OkStatus();
  return InvalidField("tenant.max_model_bytes",
                      absl::StrCat("is ", tenant_bytes, "; give 0 (no own limit) or at least ", options.max_model_bytes,
                                   ", the size of the largest model"));
}

absl::Status CheckLoad(double limit) {
  constexpr double kLeast = 0.1;  // a smaller bound would refuse sessions of a server that is nearly idle
  if (limit == 0.0 || (limit >= kLeast && limit < 1.0)) return absl::OkStatus();
  return InvalidField("max_load",
                      absl::StrCat("is ", limit, "; give 0 (no bound), or at least ", kLeast, " and below 1"));
}

absl::Status CheckCpu(const char* field, double limit) {
  constexpr double kLeast = 0.01, kMost = 1024.0;  // a session with less would not process a chunk in minutes
  if (limit == 0.0 || (limit >= kLeast && limit <= kMost)) return absl::OkStatus();
  return InvalidField(field, absl::StrCat("is ", limit, "; give 0 (no limit), or ", kLeast, " to ", kMost));
}

// The number of sessions and what each may use.
absl::Status CheckSessions(const ServerOptions& options) {
  // Less than any session takes: a smaller value is a number of megabytes instead of bytes.
  constexpr uint64_t kMinSessionMemory = 1'000'000;
  constexpr uint32_t kMinPoseLogCapacity = 4096;  // ServerOptions::pose_log_capacity has the reason
  // Less than 4096 poses take: a smaller value is a number of megabytes instead of bytes.
  constexpr uint64_t kMinPoseLogBytes = 500'000;
  EVPOSE_RETURN_IF_ERROR(CheckCpu("max_session_cpu", options.max_session_cpu));
  EVPOSE_RETURN_IF_ERROR(CheckCpu("tenant.max_cpu", options.tenant.max_cpu.value_or(0.0)));
  EVPOSE_RETURN_IF_ERROR(CheckLoad(options.max_load));
  if (options.max_sessions == 0) return InvalidField("max_sessions", "is 0; give at least 1");
  if (options.max_session_memory < kMinSessionMemory) {
    return InvalidField("max_session_memory",
                        absl::StrCat("is ", options.max_session_memory, "; give at least ", kMinSessionMemory,
                                     "; a session of a small camera takes some ten million"));
  }
  if (options.pose_log_bytes < kMinPoseLogBytes) {
    return InvalidField("pose_log_bytes", absl::StrCat("is ", options.pose_log_bytes, "; give at least ",
                                                       kMinPoseLogBytes, ": the last 4096 poses are always kept"));
  }
  if (options.pose_log_capacity >= kMinPoseLogCapacity) return absl::OkStatus();
  return InvalidField("pose_log_capacity",
                      absl::StrCat("is ", options.pose_log_capacity, "; give at least ", kMinPoseLogCapacity));
}

// The streams and connections, and the bytes under way.
absl::Status CheckStreams(const ServerOptions& options) {
  constexpr uint32_t kMaxChunkBytes = 64u << 20;  // sixteen of them need 1 GiB of max_transport_bytes (below)
  // Far above any memory; sums of it do not overflow.
  constexpr uint64_t kMaxCreditBytes = 1ull << 40;
  constexpr uint32_t kMaxCalls = 1u << 20;              // far more than one connection can use
  constexpr uint64_t kMinTransportBytes = 64ull << 20;  // 1280 connections at 50 kB each
  if (options.max_chunk_bytes < 8 || options.max_chunk_bytes > kMaxChunkBytes) {
    return InvalidField("max_chunk_bytes",
                        absl::StrCat("is ", options.max_chunk_bytes, "; give 8 to ", kMaxChunkBytes));
  }
  if (options.credit_bytes < options.max_chunk_bytes || options.credit_bytes > kMaxCreditBytes) {
    return InvalidField("credit_bytes",
                        absl::StrCat("is ", options.credit_bytes, "; give at least ", options.max_chunk_bytes,
                                     ", the size of the largest chunk, and at most ", kMaxCreditBytes));
  }
  if (options.max_streams == 0) return InvalidField("max_streams", "is 0; give at least 1");
  if (options.max_calls_per_connection == 0 || options.max_calls_per_connection > kMaxCalls) {
    return InvalidField("max_calls_per_connection",
                        absl::StrCat("is ", options.max_calls_per_connection, "; give 1 to ", kMaxCalls));
  }
  const uint64_t min_bytes = std::max<uint64_t>(kMinTransportBytes, 16ull * options.max_chunk_bytes);
  if (options.max_transport_bytes >= min_bytes) return absl::OkStatus();
  return InvalidField("max_transport_bytes", absl::StrCat("is ", options.max_transport_bytes, "; give at least ",
                                                          min_bytes, ", 64 MiB and 16 of the largest chunks"));
}

absl::Status CheckTimes(const ServerOptions& options) {
  // A busy machine delays the connections of the check by less than a second.
  constexpr absl::Duration kMinListenerTimeout = absl::Seconds(1);
  for (const auto& [field, duration] :
       {std::pair("attach_timeout", options.attach_timeout), std::pair("upload_timeout", options.upload_timeout),
        std::pair("response_timeout", options.response_timeout), std::pair("session_expiry", options.session_expiry),
        std::pair("store_check_period", options.store_check_period)}) {
    if (duration <= absl::ZeroDuration()) return InvalidField(field, "must be positive");
    EVPOSE_RETURN_IF_ERROR(CheckDuration(field, duration));
  }
  if (options.listener_timeout < kMinListenerTimeout) {
    return InvalidField("listener_timeout",
                        absl::StrCat("is ", absl::FormatDuration(options.listener_timeout), "; give at least ",
                                     absl::FormatDuration(kMinListenerTimeout)));
  }
  if (options.stream_idle_timeout < absl::ZeroDuration()) {
    return InvalidField("stream_idle_timeout", "must not be negative; 0: no limit");
  }
  EVPOSE_RETURN_IF_ERROR(CheckDuration("listener_timeout", options.listener_timeout));
  EVPOSE_RETURN_IF_ERROR(CheckDuration("stream_idle_timeout", options.stream_idle_timeout));
  return CheckDuration("drain_timeout", options.drain_timeout);
}

}  // namespace

absl::Status ServerOptions::Validate() const {
  for (const auto check : {CheckServing, CheckModels, CheckSessions, CheckStreams, CheckTimes}) {
    EVPOSE_RETURN_IF_ERROR(check(*this));
  }
  return absl::OkStatus();
}

}  // namespace evpose::server
