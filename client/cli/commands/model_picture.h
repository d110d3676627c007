// SPDX-License-Identifier: Apache-2.0

// The picture of evpose models inspect: views of a model with the edge elements that the tracker uses.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "core/geometry/camera.h"
#include "core/models/object_model.h"

namespace evpose::client {

// Returns a PNG file with six views of the model, four oblique ones and two along the z axis; each shows the faces in
// grey, and the visible edge elements in the colour of their kind. Errors: INTERNAL if the image cannot be encoded.
absl::StatusOr<std::string> DrawModel(const ObjectModel& model, const std::string& title);

}  // namespace evpose::client
