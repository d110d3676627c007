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

absl::Status ServerOptions::Validate() const {
  constexpr uint32_t kMaxChunkBytes = 64u << 20;
  constexpr uint32_t kMinPoseLogCapacity = 4096;
  // Far above any memory; sums of it do not overflow.
  constexpr uint64_t kMaxCreditBytes = 1ull << 40;
  constexpr int kMaxWorkers = 1024;
  constexpr uint64_t kMinSessionMemory = 1'000'000;
  constexpr uint32_t kMaxCalls = 1u << 20;
  constexpr absl::Duration kMinListenerTimeout = absl::Seconds(1);
  constexpr uint64_t kMinTransportBytes = 64ull << 20;
  constexpr int kMaxSlowThreads = 64;
  constexpr uint32_t kMaxCpuSeconds = 3600;
  constexpr uint64_t kMinPreparationBytes = 64u << 20;  // libraries and a small model
  if (!listen_address.empty()) {
    const auto address = ParseListenAddress(listen_address);
    if (!address.ok()) return InvalidField("listen_address", address.status().message());
  }
  if (const absl::Status status = tls.Validate(); !status.ok()) return InvalidField("tls", status.message());
  if (worker_threads < 0 || worker_threads > kMaxWorkers) {
    return InvalidField("worker_threads", absl::StrCat("is ", worker_threads, "; 0 (one per core) to ", kMaxWorkers));
  }
  if (slow_threads < 1 || slow_threads > kMaxSlowThreads) {
    return InvalidField("slow_threads", absl::StrCat("is ", slow_threads, "; 1 to ", kMaxSlowThreads));
  }
  if (!model_preparer.empty() && access(model_preparer.c_str(), X_OK) != 0) {
    return InvalidField("model_preparer", absl::StrCat(model_preparer, " cannot be run: install it there"));
  }
  if (model_budget.cpu_seconds == 0 || model_budget.cpu_seconds > kMaxCpuSeconds) {
    return InvalidField("model_budget.cpu_seconds",
                        absl::StrCat("is ", model_budget.cpu_seconds, "; 1 to ", kMaxCpuSeconds));
  }
  if (model_budget.memory_bytes < kMinPreparationBytes) {
    return InvalidField("model_budget.memory_bytes",
                        absl::StrCat("is ", model_budget.memory_bytes, "; at least ", kMinPreparationBytes));
  }
  if (max_uploads == 0) return InvalidField("max_uploads", "is 0; at least 1");
  const auto check_cpu = [](const char* field, double limit) {
    constexpr double kLeast = 0.01, kMost = 1024.0;  // a session with less would not process a chunk in minutes
    if (limit == 0.0 || (limit >= kLeast && limit <= kMost)) return absl::OkStatus();
    return InvalidField(field, absl::StrCat("is ", limit, "; 0 (no limit), or ", kLeast, " to ", kMost));
  };
  EVPOSE_RETURN_IF_ERROR(check_cpu("max_session_cpu", max_session_cpu));
  EVPOSE_RETURN_IF_ERROR(check_cpu("tenant.max_cpu", tenant.max_cpu.value_or(0.0)));
  if (max_sessions == 0) return InvalidField("max_sessions", "is 0; at least 1");
  if (max_session_memory < kMinSessionMemory) {
    return InvalidField("max_session_memory", absl::StrCat("is ", max_session_memory, "; at least ", kMinSessionMemory,
                                                           "; a session of a small camera takes some ten million"));
  }
  if (max_model_bytes == 0) return InvalidField("max_model_bytes", "is 0; at least 1");
  if (max_model_store_bytes < max_model_bytes) {
    return InvalidField("max_model_store_bytes", absl::StrCat("is ", max_model_store_bytes, "; at least ",
                                                              max_model_bytes, ", the size of the largest model"));
  }
  if (max_chunk_bytes < 8 || max_chunk_bytes > kMaxChunkBytes) {
    return InvalidField("max_chunk_bytes", absl::StrCat("is ", max_chunk_bytes, "; 8 to ", kMaxChunkBytes));
  }
  if (credit_bytes < max_chunk_bytes || credit_bytes > kMaxCreditBytes) {
    return InvalidField("credit_bytes", absl::StrCat("is ", credit_bytes, "; at least ", max_chunk_bytes,
                                                     ", the size of the largest chunk, and at most ", kMaxCreditBytes));
  }
  if (pose_log_capacity < kMinPoseLogCapacity) {
    return InvalidField("pose_log_capacity",
                        absl::StrCat("is ", pose_log_capacity, "; at least ", kMinPoseLogCapacity));
  }
  if (tenant.max_model_bytes.value_or(0) != 0 && *tenant.max_model_bytes < max_model_bytes) {
    return InvalidField("tenant.max_model_bytes",
                        absl::StrCat("is ", *tenant.max_model_bytes, "; 0 (no own limit) or at least ", max_model_bytes,
                                     ", the size of the largest model"));
  }
  if (max_streams == 0) return InvalidField("max_streams", "is 0; at least 1");
  if (max_calls_per_connection == 0 || max_calls_per_connection > kMaxCalls) {
    return InvalidField("max_calls_per_connection",
                        absl::StrCat("is ", max_calls_per_connection, "; 1 to ", kMaxCalls));
  }
  for (const auto& [field, duration] :
       {std::pair("attach_timeout", attach_timeout), std::pair("upload_timeout", upload_timeout),
        std::pair("session_expiry", session_expiry), std::pair("store_check_period", store_check_period)}) {
    if (duration <= absl::ZeroDuration()) return InvalidField(field, "must be positive");
    EVPOSE_RETURN_IF_ERROR(CheckDuration(field, duration));
  }
  if (listener_timeout < kMinListenerTimeout) {
    return InvalidField("listener_timeout", absl::StrCat("is ", absl::FormatDuration(listener_timeout), "; at least ",
                                                         absl::FormatDuration(kMinListenerTimeout)));
  }
  if (stream_idle_timeout < absl::ZeroDuration()) {
    return InvalidField("stream_idle_timeout", "must not be negative; 0: no limit");
  }
  if (const uint64_t min_bytes = std::max<uint64_t>(kMinTransportBytes, 16ull * max_chunk_bytes);
      max_transport_bytes < min_bytes) {
    return InvalidField("max_transport_bytes", absl::StrCat("is ", max_transport_bytes, "; at least ", min_bytes,
                                                            ", 64 MiB and 16 of the largest chunks"));
  }
  EVPOSE_RETURN_IF_ERROR(CheckDuration("listener_timeout", listener_timeout));
  EVPOSE_RETURN_IF_ERROR(CheckDuration("stream_idle_timeout", stream_idle_timeout));
  return CheckDuration("drain_timeout", drain_timeout);
}

}  // namespace evpose::server
