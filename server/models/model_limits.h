// SPDX-License-Identifier: Apache-2.0

// The limits on the bytes of models and on uploads under way, for the server and for each tenant.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// Thread-safe.
class ModelLimits {
 public:
  struct Options {
    // ServerOptions (server/rpc/server.h) has the reasons of these defaults.
    uint64_t max_model_bytes = 64ull << 20;
    // Largest size of all files and of what was derived from them, including the received bytes of uploads.
    uint64_t max_store_bytes = 512ull << 20;
    uint64_t max_tenant_bytes = 512ull << 20;  // the same for one tenant
    uint32_t max_uploads = 64;                 // under way at a time
    uint32_t max_tenant_uploads = 64;          // number of uploads of one tenant
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };

  // Constructor and destructor lock, so that ThreadSanitizer sees that all calls are between them.
  explicit ModelLimits(Options options) : options_(std::move(options)) { const std::lock_guard lock(mutex_); }
  ~ModelLimits() { const std::lock_guard lock(mutex_); }

  // An upload under way. It counts, with the bytes that have arrived, until it is destroyed. For one thread at a time.
  class Upload {
   public:
    Upload(ModelLimits& limits, std::string tenant) : limits_(limits), tenant_(std::move(tenant)) {}
    Upload(const Upload&) = delete;
    Upload& operator=(const Upload&) = delete;
    ~Upload() { limits_.End(tenant_, bytes_); }

    // Checks that a file of this size would fit now. It is not reserved: bytes count when they arrive. Errors:
    // INVALID_ARGUMENT (header.size_bytes) for a size of 0 or above max_model_bytes; those of Add().
    absl::Status Declare(uint64_t size_bytes) const { return limits_.CheckSize(tenant_, size_bytes); }
    // Counts received bytes. Errors: RESOURCE_EXHAUSTED (MODEL_STORE_FULL, or TENANT_QUOTA when the tenant's own limit
    // is reached).
    absl::Status Add(uint64_t bytes);

   private:
    ModelLimits& limits_;
    const std::string tenant_;
    uint64_t bytes_ = 0;
  };
  // Errors: RESOURCE_EXHAUSTED (TOO_MANY_UPLOADS, or TENANT_QUOTA when the tenant's own limit is reached).
  absl::StatusOr<std::unique_ptr<Upload>> BeginUpload(const std::string& tenant);

  // Checks that further bytes of the tenant would fit now, without counting them. Errors: as Upload::Add().
  absl::Status Check(const std::string& tenant, uint64_t bytes);
  // Count a stored model, also beyond the limits.
  void AddStored(const std::string& tenant, uint64_t bytes);
  void RemoveStored(const std::string& tenant, uint64_t bytes);

 private:
  struct Usage {
    uint64_t bytes = 0;
    uint32_t uploads = 0;
  };

  absl::Status CheckSize(const std::string& tenant, uint64_t size_bytes);
  absl::Status Receive(const std::string& tenant, uint64_t bytes);
  void End(const std::string& tenant, uint64_t bytes);
  absl::Status CheckRoom(const std::string& tenant, uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void AddBytes(const std::string& tenant, uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void Release(const std::string& tenant, const Usage& usage) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Options options_;
  std::mutex mutex_;
  Usage all_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, Usage> by_tenant_ ABSL_GUARDED_BY(mutex_);  // of a tenant without any use: zero or absent
};

}  // namespace evpose::server
