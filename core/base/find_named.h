// SPDX-License-Identifier: Apache-2.0

// Look-up of the elements of a table by their names, as they stand on a command line.
#pragma once

#include <iterator>
#include <ranges>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/substitute.h"

namespace evpose {

// Returns the element with this `name`. INVALID_ARGUMENT with `problem`, in which $0 stands for the name, and the known
// names.
template <typename Items, typename Item = std::ranges::range_value_t<Items>>
absl::StatusOr<Item> FindNamed(const Items& items, const std::string& name, const char* problem) {
  for (const Item& item : items) {
    if (name == item.name) return item;
  }
  const auto append_name = [](std::string* text, const Item& item) { absl::StrAppend(text, std::string(item.name)); };
  return absl::InvalidArgumentError(
      absl::StrCat(absl::Substitute(problem, name), "; known are: ", absl::StrJoin(items, ", ", append_name)));
}

// Returns the elements with these names, in the order of the names; all elements if there are no names. Errors: those
// of FindNamed().
template <typename Items, typename Item = std::ranges::range_value_t<Items>>
absl::StatusOr<std::vector<Item>> FindAllNamed(const Items& items, const std::vector<std::string>& names,
                                               const char* problem) {
  if (names.empty()) return std::vector<Item>(std::begin(items), std::end(items));
  std::vector<Item> found;
  for (const std::string& name : names) {
    const absl::StatusOr<Item> item = FindNamed(items, name, problem);
    if (!item.ok()) return item.status();
    found.push_back(*item);
  }
  return found;
}

}  // namespace evpose
