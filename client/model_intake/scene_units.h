// SPDX-License-Identifier: Apache-2.0

// Whether a file has the format that its name states, and the unit in which it is written.
#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "client/model_intake/scene_reader.h"

namespace evpose::client {

// `contents` is the file. Error: INVALID_ARGUMENT if it cannot be of the format, if a COLLADA file states a unit that
// is not above zero, or if an OFF file is cut off.
absl::Status CheckContents(absl::string_view contents, SceneFormat format);

// Metres per unit of a 3MF file. Assimp reads the coordinates alone. Error: INVALID_ARGUMENT for an archive without a
// model or an unknown unit.
absl::StatusOr<double> MetresPerUnitOf3mf(const std::string& path);

}  // namespace evpose::client
