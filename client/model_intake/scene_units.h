// SPDX-License-Identifier: Apache-2.0

// Whether a file has the format that its name states, is complete and has a valid unit.
#pragma once

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "client/model_intake/scene_reader.h"

namespace evpose::client {

// `contents` is the file. Error: INVALID_ARGUMENT if it cannot be of the format, if a COLLADA file states a unit that
// is not above zero, or if an OFF file is cut off.
absl::Status CheckContents(absl::string_view contents, SceneFormat format);

}  // namespace evpose::client
