// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "core/base/state_io.h"

namespace evpose {

// Returns the bytes of a saved state with these values, one after the other.
template <typename... Values>
std::string Saved(const Values&... values) {
  StateWriter writer;
  writer(values...);
  return writer.Take();
}

// Restores `object`. Returns whether `bytes` are a state of it, without further ones.
template <typename Object>
bool IsRestored(const std::string& bytes, Object& object) {
  StateReader reader(bytes);
  reader(object);
  return reader.Finish().ok();
}

}  // namespace evpose
