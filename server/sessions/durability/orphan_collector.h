// SPDX-License-Identifier: Apache-2.0

// Deletes orphans: sessions that are only in the store, because their server died or the store was full. No server has
// a timer for their expiry.
#pragma once

#include <functional>
#include <map>
#include <string>

#include "absl/time/time.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Deletes sessions with an ownership record that has not changed for twice the expiry time. A live server renews the
// record of every session with an attached stream, and itself deletes expired sessions without one. The time without a
// change is measured by this server's own clock.
class OrphanCollector {
 public:
  OrphanCollector(Store& store, absl::Duration expiry) : store_(store), expiry_(expiry) {}

  // To be called several times within the expiry time, from one thread at a time. Waits for the store. `is_here`
  // returns whether this server has the session with that name.
  void Collect(absl::Time now, const std::function<bool(const std::string&)>& is_here);

 private:
  struct Seen {
    std::string lifecycle;
    absl::Time since;  // of the first run that read this record
  };

  void Delete(const std::string& name, const std::string& lifecycle);

  Store& store_;
  const absl::Duration expiry_;
  absl::Time last_run_ = absl::InfinitePast();
  std::map<std::string, Seen> seen_;
};

}  // namespace evpose::server
