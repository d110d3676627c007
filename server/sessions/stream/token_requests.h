// SPDX-License-Identifier: Apache-2.0

// Calls that wait until a new resume token has been persisted.
#pragma once

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include "absl/functional/any_invocable.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace evpose::server {

struct TokenRequest {
  uint64_t lifecycle = 0;  // number of the lifecycle record with the token
  std::string token;
  absl::AnyInvocable<void(absl::StatusOr<std::string>)> done;
};

// Not thread-safe.
class TokenRequests {
 public:
  void Add(TokenRequest request) { waiting_.push_back(std::move(request)); }

  // Removes and returns, in the order of Add, the requests that can be answered: those whose record has been persisted,
  // or all when the session is closed.
  std::vector<TokenRequest> RemoveAnswerable(uint64_t persisted_lifecycle, bool is_closed) {
    const auto rest = std::stable_partition(waiting_.begin(), waiting_.end(), [&](const TokenRequest& request) {
      return is_closed || request.lifecycle <= persisted_lifecycle;
    });
    std::vector<TokenRequest> answerable(std::make_move_iterator(waiting_.begin()), std::make_move_iterator(rest));
    waiting_.erase(waiting_.begin(), rest);
    return answerable;
  }

 private:
  std::vector<TokenRequest> waiting_;
};

}  // namespace evpose::server
