// SPDX-License-Identifier: Apache-2.0

// Quotas of a tenant besides those of sessions and models: streams, watchers, bytes of responses, messages with health
// and payload bytes per second. They are the same for all tenants. The limit of streams of the whole server is beside
// them, so that a stream that is refused for the quota of its tenant does not count for it.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/telemetry/metrics.h"

namespace evpose::server {

// Thread-safe.
class TenantQuotas {
 public:
  struct Options {
    // ServerOptions (server/rpc/server.h) has the reasons of these defaults.
    uint32_t max_streams = 8192;  // Track and Watch streams
    uint32_t max_streams_of_server = 8192;
    uint32_t max_watchers = 4096;
    // Bytes of the responses that their clients have not read yet; all tenants together may have twice as many.
    uint64_t max_response_bytes = 64u << 20;
    uint32_t max_health_per_s = 0;  // messages to all watchers of health of a tenant; 0: no limit
    uint64_t max_bytes_per_s = 0;   // sum over all Track streams of a tenant; 0: no limit
    // Bytes that may arrive at once after a pause; at least one chunk, so that a chunk never waits for itself.
    uint64_t burst_bytes = 4u << 20;
    std::function<absl::Time()> now;
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };
  explicit TenantQuotas(Options options) : options_(std::move(options)) {}

  // Count a stream, and a watcher, of the tenant until the result is destroyed. Errors: RESOURCE_EXHAUSTED
  // (TENANT_QUOTA, and for a stream TOO_MANY_STREAMS beyond the limit of the server).
  absl::StatusOr<std::shared_ptr<const void>> AddStream(const std::string& tenant);
  absl::StatusOr<std::shared_ptr<const void>> AddWatcher(const std::string& tenant);

  // Counts the memory of a response of the tenant until the result is destroyed. A tenant without another response is
  // never refused. While all tenants together have reached the limit of the server, a tenant is refused only above
  // kOwnResponseBytes (4 MiB). So tenants that do not read their responses exclude no other one. Errors:
  // RESOURCE_EXHAUSTED (TENANT_QUOTA).
  absl::StatusOr<std::shared_ptr<const void>> AddResponse(const std::string& tenant, uint64_t bytes);

  // Counts a watcher of health of the tenant until the result is destroyed, in addition to AddWatcher().
  std::shared_ptr<const void> AddHealthWatcher(const std::string& tenant);
  // The time until the next message to a watcher of health that asks for `period`: longer while all watchers of the
  // tenant together would exceed the limit if each had this period.
  absl::Duration HealthPeriod(const std::string& tenant, absl::Duration period) const;

  // Counts received bytes, and returns the time for which the stream must not be read: zero within the limit. If each
  // stream waits so long, the tenant exceeds the limit by at most one message of each stream, however many there are.
  absl::Duration ChargeBytes(const std::string& tenant, uint64_t bytes);

 private:
  struct Bucket {
    double bytes = 0.0;  // bytes that may arrive now; negative: excess to be waited for
    absl::Time filled_at;
  };
  using Counts = std::map<std::string, uint64_t>;  // by tenant, no zeros
  struct CountLimit {
    uint32_t max = 0;
    uint32_t max_of_server = 0;  // sum over all tenants
    QuotaLimit metric;
    const char* subject;
    const char* name;
  };
  // Holds a part of a quota of the tenant, by default one unit, from Count() until it is destroyed. It is made before
  // the count, because an allocation that fails after it would leave the count too high.
  class Reservation;
  absl::StatusOr<std::shared_ptr<const void>> Add(Counts& counts, const std::string& tenant, const CountLimit& limit);
  void Remove(Counts& counts, const std::string& tenant, uint64_t amount);
  double BytesAt(const Bucket& bucket, absl::Time now) const;

  const Options options_;
  mutable std::mutex mutex_;
  Counts streams_ ABSL_GUARDED_BY(mutex_);
  Counts watchers_ ABSL_GUARDED_BY(mutex_);
  Counts health_watchers_ ABSL_GUARDED_BY(mutex_);
  Counts response_bytes_ ABSL_GUARDED_BY(mutex_);
  std::map<std::string, Bucket> buckets_ ABSL_GUARDED_BY(mutex_);  // tenants that have sent bytes
};

}  // namespace evpose::server
