// SPDX-License-Identifier: Apache-2.0

// Deletes orphans: sessions that are only in the store, because their server died or the store was full. No server has
// a timer for their expiry.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <string>

#include "absl/time/time.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Deletes sessions with a lifecycle record that has not changed for the expiry time. In a store that several servers
// share, it must not have changed for twice that time, because a live server renews the record of every session with an
// attached stream, and itself deletes expired sessions without one. The time without a change is measured by this
// server's own clock.
class OrphanCollector {
 public:
  using IsHere = std::function<bool(const std::string&)>;
  using OnGone = std::function<void(const std::string&)>;

  OrphanCollector(Store& store, absl::Duration expiry, bool shares_store)
      : store_(store), expiry_(expiry), time_without_change_(shares_store ? 2 * expiry : expiry) {}

  // To be called several times within the expiry time, from one thread at a time. Waits for the store. `is_here`
  // returns whether this server has the session with that name, and `num_here` is the number of those. `on_gone` is
  // called with the name of each session that was deleted or cannot be read. A damaged session stays in the store.
  void Collect(absl::Time now, size_t num_here, const IsHere& is_here, const OnGone& on_gone);

 private:
  struct Seen {
    std::string lifecycle;
    absl::Time since;  // of the first run that read this record
  };

  // Returns whether the session is gone, in the sense of `on_gone`.
  bool Delete(const std::string& name, const std::string& lifecycle, absl::Time now);

  Store& store_;
  const absl::Duration expiry_;
  const absl::Duration time_without_change_;
  absl::Time last_run_ = absl::InfinitePast();
  std::map<std::string, Seen> seen_;
};

}  // namespace evpose::server
