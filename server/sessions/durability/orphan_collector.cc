// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/orphan_collector.h"

#include <optional>
#include <utility>
#include <vector>

#include "server/sessions/durability/session_codec.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {
namespace {

// Bounds the memory and the time of one run, to some megabytes and some tenths of a second. Orphans beyond it are found
// when these have been deleted: live sessions have newer records.
constexpr size_t kMaxOrphansAtOnce = 10'000;

// Returns nullopt if the records cannot be read.
std::optional<SessionSums> SumsOf(const StoredSession& stored, absl::Time now) {
  const auto config = DecodeConfig(stored.record.config);
  const auto lifecycle = DecodeLifecycle(stored.lifecycle);
  if (!config.ok() || !lifecycle.ok()) return std::nullopt;
  SessionCheckpoint checkpoint;
  if (!stored.checkpoint.empty()) {
    auto decoded = DecodeCheckpoint(stored.checkpoint, config->objects.size());
    if (!decoded.ok()) return std::nullopt;
    checkpoint = *std::move(decoded);
  }
  return SessionSums{.health = StoredHealth(checkpoint, *lifecycle),
                     .lifetime = now - stored.record.create_time,
                     .was_reported = checkpoint.has_ended || lifecycle->lost_from_seq > 0};
}

}  // namespace

void OrphanCollector::Collect(absl::Time now, size_t num_here, const IsHere& is_here, const OnGone& on_gone) {
  const auto lifecycles = store_.ReadOldestLifecycles(num_here + kMaxOrphansAtOnce);
  if (!lifecycles.ok()) return;  // the callers that need the store report its errors
  // If the store was unreachable for a while, or this function was not called, the measured times do not count: the
  // other servers may have been unable to renew their records.
  if (now - std::exchange(last_run_, now) > expiry_) seen_.clear();
  std::map<std::string, Seen> before = std::exchange(seen_, {});
  for (const StoredLifecycle& stored : *lifecycles) {
    if (is_here(stored.name)) continue;
    const auto known = before.find(stored.name);
    const bool is_unchanged = known != before.end() && known->second.lifecycle == stored.lifecycle;
    const absl::Time since = is_unchanged ? known->second.since : now;
    if (now - since >= time_without_change_) {
      if (Delete(stored.name, stored.lifecycle, now)) on_gone(stored.name);
    } else {
      seen_[stored.name] = {stored.lifecycle, since};
    }
  }
}

bool OrphanCollector::Delete(const std::string& name, const std::string& lifecycle, absl::Time now) {
  // The lease is acquired first: from now on no other server can change the record. A client that has returned
  // meanwhile keeps its session, but its stream is fenced and has to attach again.
  const auto acquired = store_.AcquireSession(name);
  if (absl::IsDataLoss(acquired.status())) {
    SessionLog(name, "").NotResumed(acquired.status());
    return true;
  }
  if (!acquired.ok() || acquired->session.lifecycle != lifecycle) return false;
  const absl::Status status = store_.DeleteHeldSession(name, acquired->lease->token());
  SessionLog log(name, acquired->session.record.tenant);
  if (status.ok()) {
    if (const std::optional<SessionSums> sums = SumsOf(acquired->session, now)) {
      log.Orphaned(*sums);
    } else {
      log.DeletedUnread("", "no server has it, and it cannot be read");
    }
  } else if (!absl::IsAborted(status)) {
    log.NotDeleted(status);
  }
  return status.ok();
}

}  // namespace evpose::server
