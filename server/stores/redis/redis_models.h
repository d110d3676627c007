// SPDX-License-Identifier: Apache-2.0

// The models of a store in Redis. The functions are those of Store.
#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/stores/common/store.h"
#include "server/stores/redis/redis_groups.h"

namespace evpose::server {

// Thread-safe.
class RedisModels {
 public:
  // `groups` must live as long as the object.
  explicit RedisModels(RedisGroups& groups) : groups_(groups) {}

  // NAME\nTENANT of all models, sorted, without those of groups that do not respond.
  absl::StatusOr<std::vector<std::string>> Members() const;
  absl::StatusOr<ModelRecord> Read(const std::string& member) const;
  absl::StatusOr<bool> Has(const std::string& member) const;
  // Returns all models except those of groups that do not respond.
  absl::StatusOr<std::vector<ModelRecord>> List() const;
  absl::Status Put(const ModelRecord& model);
  absl::Status Delete(const std::string& member);

 private:
  RedisGroups& groups_;
};

}  // namespace evpose::server
