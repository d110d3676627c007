// SPDX-License-Identifier: Apache-2.0

// The sessions in the store that wait until somebody needs them. They are counted, because each keeps its slot.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <utility>

#include "absl/strings/string_view.h"

namespace evpose::server {

class WaitingSessions {
 public:
  // `name` is not known yet.
  void Add(std::string name, const std::string& tenant) {
    ++num_of_tenants_[tenant];
    tenants_.emplace(std::move(name), tenant);
  }
  // Returns whether the session waited.
  bool Remove(absl::string_view name) {
    const auto found = tenants_.find(name);
    if (found == tenants_.end()) return false;
    const auto count = num_of_tenants_.find(found->second);
    if (--count->second == 0) num_of_tenants_.erase(count);
    tenants_.erase(found);
    return true;
  }
  bool Contains(absl::string_view tenant, absl::string_view name) const {
    const auto found = tenants_.find(name);
    return found != tenants_.end() && found->second == tenant;
  }
  size_t size() const { return tenants_.size(); }
  bool empty() const { return tenants_.empty(); }
  size_t size_of(absl::string_view tenant) const {
    const auto count = num_of_tenants_.find(tenant);
    return count == num_of_tenants_.end() ? 0 : count->second;
  }

 private:
  std::map<std::string, std::string, std::less<>> tenants_;    // by name
  std::map<std::string, size_t, std::less<>> num_of_tenants_;  // no zeros
};

}  // namespace evpose::server
