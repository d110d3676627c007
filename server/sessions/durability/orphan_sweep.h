// SPDX-License-Identifier: Apache-2.0

// Sessions that are in the store alone, because their server died, or the store had no room for them: nobody's timer
// expires them.
#pragma once

#include <functional>
#include <map>
#include <string>

#include "absl/time/time.h"
#include "server/stores/common/store.h"

namespace evpose::server {

// Deletes those of which no server has shown for twice the time of expiry that it has them. A live server shows it: it
// renews the lifecycle of a session that a stream is attached to, and deletes one that none is when it expires. What
// counts is how long this server has seen no change, by its own clock alone.
class OrphanSweep {
 public:
  OrphanSweep(Store& store, absl::Duration expiry) : store_(store), expiry_(expiry) {}

  // To be called several times within the time of expiry, never two at once. Waits for the store. `is_here`: this
  // server has the session with that name.
  void Sweep(absl::Time now, const std::function<bool(const std::string&)>& is_here);

 private:
  struct Seen {
    std::string lifecycle;
    absl::Time since;
  };

  void Delete(const std::string& name, const std::string& lifecycle);

  Store& store_;
  const absl::Duration expiry_;
  absl::Time last_sweep_ = absl::InfinitePast();
  std::map<std::string, Seen> seen_;
};

}  // namespace evpose::server
