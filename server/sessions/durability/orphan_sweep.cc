// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/orphan_sweep.h"

#include <utility>
#include <vector>

#include "server/telemetry/session_log.h"

namespace evpose::server {

void OrphanSweep::Sweep(absl::Time now, const std::function<bool(const std::string&)>& is_here) {
  const auto lifecycles = store_.ReadLifecycles();
  if (!lifecycles.ok()) return;  // whoever needs the store says so
  // After a while without the store, or without running, nothing is known: the others may have had to wait, too.
  if (now - std::exchange(last_sweep_, now) > expiry_) seen_.clear();
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

void OrphanSweep::Delete(const std::string& name, const std::string& lifecycle) {
  // Taken first: from now on nobody can change what is looked at. A client that has come back meanwhile keeps its
  // session; its stream is told to attach again.
  const auto taken = store_.TakeSession(name);
  if (!taken.ok() || taken->session.lifecycle != lifecycle) return;
  const absl::Status status = store_.DeleteHeldSession(name, taken->lease->fencing_number());
  SessionLog log(name, taken->session.record.tenant);
  if (status.ok()) {
    log.Deleted("", "no server has it, and it has expired", 0);
  } else if (!absl::IsAborted(status)) {
    log.NotDeleted(status);
  }
}

}  // namespace evpose::server
