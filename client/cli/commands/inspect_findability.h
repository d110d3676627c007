// SPDX-License-Identifier: Apache-2.0

// Prints from which views and at which sizes an object can be found (evpose models inspect), as text and as JSON.
#pragma once

#include <ostream>
#include <vector>

#include "client/cli/common/command.h"
#include "core/evaluation/findability.h"
#include "core/geometry/camera.h"
#include "core/models/object_model.h"

namespace evpose::client {

Json FindabilityJson(const std::vector<ViewFindability>& views, const ObjectModel& model, const CameraModel& camera);
void PrintFindability(const std::vector<ViewFindability>& views, const ObjectModel& model, const CameraModel& camera,
                      std::ostream& out);

}  // namespace evpose::client
