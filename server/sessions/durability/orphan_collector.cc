// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/orphan_collector.h"

#include <utility>
#include <vector>

#include "server/telemetry/session_log.h"

namespace evpose::server {

void OrphanCollector::Collect(absl::Time now, const std::function<bool(const std::string&)>& is_here) {
  const auto lifecycles = store_.ReadLifecycles();
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
    if (now - since >= 2 * expiry_) {
      Delete(stored.name, stored.lifecycle);
    } else {
      seen_[stored.name] = {stored.lifecycle, since};
    }
  }
}

void OrphanCollector::Delete(const std::string& name, const std::string& lifecycle) {
  // The lease is taken first: from now on no other server can change the record. A client that has returned meanwhile
  // keeps its session, but its stream is fenced and has to attach again.
  const auto taken = store_.TakeSession(name);
  if (!taken.ok() || taken->session.lifecycle != lifecycle) return;
  const absl::Status status = store_.DeleteHeldSession(name, taken->lease->token());
  SessionLog log(name, taken->session.record.tenant);
  if (status.ok()) {
    log.Deleted("", "no server has it, and it has expired", 0);
  } else if (!absl::IsAborted(status)) {
    log.NotDeleted(status);
  }
}

}  // namespace evpose::server
