// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/tenant_quotas.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

// Bytes of responses that each tenant may have even if the limit of the server is reached: some hundred small ones.
constexpr uint64_t kOwnResponseBytes = 4u << 20;

uint64_t Sum(const std::map<std::string, uint64_t>& counts) {
  uint64_t sum = 0;
  for (const auto& [tenant, count] : counts) sum += count;
  return sum;
}

uint64_t CountOf(const std::map<std::string, uint64_t>& counts, const std::string& tenant) {
  const auto found = counts.find(tenant);
  return found == counts.end() ? 0 : found->second;
}

}  // namespace

class TenantQuotas::Reservation {
 public:
  Reservation(TenantQuotas& quotas, Counts& counts, const std::string& tenant)
      : quotas_(quotas), counts_(counts), tenant_(tenant) {}
  Reservation(const Reservation&) = delete;
  Reservation& operator=(const Reservation&) = delete;
  ~Reservation() {
    if (amount_ != 0) quotas_.Remove(counts_, tenant_, amount_);
  }
  // To be called with the lock of the quotas.
  void Count(uint64_t& count, uint64_t amount = 1) {
    count += amount;
    amount_ = amount;
  }

 private:
  TenantQuotas& quotas_;
  Counts& counts_;
  const std::string tenant_;
  uint64_t amount_ = 0;  // 0: not counted
};

absl::StatusOr<std::shared_ptr<const void>> TenantQuotas::AddStream(const std::string& tenant) {
  return Add(
      streams_, tenant,
      {options_.max_streams, options_.max_streams_of_server, QuotaLimit::kTenantStreams, "tenant_streams", "streams"});
}

absl::StatusOr<std::shared_ptr<const void>> TenantQuotas::AddWatcher(const std::string& tenant) {
  // A watcher is a stream, too, so the server has no other limit for watchers.
  return Add(watchers_, tenant,
             {options_.max_watchers, std::numeric_limits<uint32_t>::max(), QuotaLimit::kTenantWatchers,
              "tenant_watchers", "watchers"});
}

absl::StatusOr<std::shared_ptr<const void>> TenantQuotas::Add(Counts& counts, const std::string& tenant,
                                                              const CountLimit& limit) {
  const auto reservation = std::make_shared<Reservation>(*this, counts, tenant);
  const std::lock_guard lock(mutex_);
  if (Sum(counts) >= limit.max_of_server) {
    options_.metrics->quota_refusals[QuotaLimit::kMaxStreams].Add();
    return LimitReached(v1::TOO_MANY_STREAMS, "max_streams",
                        absl::StrCat("the server has its ", limit.max_of_server, " streams: try again later"),
                        kRetryDelay);
  }
  if (CountOf(counts, tenant) >= limit.max) {
    options_.metrics->quota_refusals[limit.metric].Add();
    return LimitReached(v1::TENANT_QUOTA, limit.subject,
                        absl::StrCat("this tenant has its ", limit.max, " ", limit.name,
                                     ": end one that is not needed, or try again later"),
                        kRetryDelay);
  }
  reservation->Count(counts[tenant]);
  return reservation;
}

absl::StatusOr<std::shared_ptr<const void>> TenantQuotas::AddResponse(const std::string& tenant, uint64_t bytes) {
  const auto reservation = std::make_shared<Reservation>(*this, response_bytes_, tenant);
  const std::lock_guard lock(mutex_);
  const uint64_t taken = CountOf(response_bytes_, tenant);
  const bool has_room = Sum(response_bytes_) + bytes <= 2 * options_.max_response_bytes;
  const uint64_t max =
      has_room ? options_.max_response_bytes : std::min(options_.max_response_bytes, kOwnResponseBytes);
  if (taken != 0 && taken + bytes > max) {
    options_.metrics->quota_refusals[QuotaLimit::kTenantResponses].Add();
    return LimitReached(v1::TENANT_QUOTA, "tenant_responses",
                        absl::StrCat("the response takes ", bytes,
                                     " bytes, and those that clients of this tenant have not read yet take ", taken,
                                     " of ", max, " bytes: read the responses of the other calls, or try again later"),
                        kRetryDelay);
  }
  reservation->Count(response_bytes_[tenant], bytes);
  return reservation;
}

void TenantQuotas::Remove(Counts& counts, const std::string& tenant, uint64_t amount) {
  const std::lock_guard lock(mutex_);
  const auto found = counts.find(tenant);
  found->second -= amount;
  if (found->second == 0) counts.erase(found);
}

std::shared_ptr<const void> TenantQuotas::AddHealthWatcher(const std::string& tenant) {
  const auto reservation = std::make_shared<Reservation>(*this, health_watchers_, tenant);
  const std::lock_guard lock(mutex_);
  reservation->Count(health_watchers_[tenant]);
  return reservation;
}

absl::Duration TenantQuotas::HealthPeriod(const std::string& tenant, absl::Duration period) const {
  if (options_.max_health_per_s == 0) return period;
  const std::lock_guard lock(mutex_);
  return std::max(period, absl::Seconds(CountOf(health_watchers_, tenant)) / options_.max_health_per_s);
}

absl::Duration TenantQuotas::ChargeBytes(const std::string& tenant, uint64_t bytes) {
  if (options_.max_bytes_per_s == 0) return absl::ZeroDuration();
  const std::lock_guard lock(mutex_);
  const absl::Time now = options_.now();
  const auto burst = static_cast<double>(options_.burst_bytes);
  Bucket& bucket = buckets_.try_emplace(tenant, Bucket{burst, now}).first->second;
  bucket.bytes = BytesAt(bucket, now) - static_cast<double>(bytes);
  bucket.filled_at = now;
  if (bucket.bytes >= 0.0) return absl::ZeroDuration();
  options_.metrics->quota_delays.Add();
  return absl::Seconds(-bucket.bytes / static_cast<double>(options_.max_bytes_per_s));
}

double TenantQuotas::BytesAt(const Bucket& bucket, absl::Time now) const {
  // A clock that is set back changes nothing.
  const absl::Duration since = std::max(now - bucket.filled_at, absl::ZeroDuration());
  const double filled = bucket.bytes + absl::ToDoubleSeconds(since) * static_cast<double>(options_.max_bytes_per_s);
  return std::min(filled, static_cast<double>(options_.burst_bytes));
}

}  // namespace evpose::server
