// SPDX-License-Identifier: Apache-2.0

// The checks of a Mesh that ParseMesh() makes before it uses it.
#pragma once

#include <cstddef>

#include "absl/status/status.h"
#include "evpose/v1/mesh.pb.h"

namespace evpose::server {

absl::Status CheckMesh(const v1::Mesh& mesh, size_t max_triangles);

}  // namespace evpose::server
