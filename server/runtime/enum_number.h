// SPDX-License-Identifier: Apache-2.0

// The numbers by which the API and the store identify the values of an enumeration: from 1, in the order of the C++
// enumeration. 0 is UNSPECIFIED. Files that use these functions assert that the last value has the largest number of
// the API or the store.
#pragma once

#include <type_traits>

namespace evpose::server {

template <typename Number = int, typename Value>
constexpr Number EnumNumber(Value value) {
  static_assert(std::is_enum_v<Value>);
  return static_cast<Number>(static_cast<int>(value) + 1);
}

// The reverse, for the numbers of known values.
template <typename Value>
constexpr Value EnumValue(int number) {
  return static_cast<Value>(number - 1);
}

}  // namespace evpose::server
