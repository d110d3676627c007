// SPDX-License-Identifier: Apache-2.0

// The message Mesh (proto/evpose/v1/mesh.proto): the file of a model in the format kMesh.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "core/mesh/types/raw_mesh.h"
#include "core/models/object_model.h"

namespace evpose::server {

// Returns `mesh`, in metres, as a serialized Mesh. Coordinates and normals are rounded to single precision; the normals
// are those of `exact_surface` if it is given. Precondition: the mesh is one that ParseMesh() accepts.
std::string EncodeMesh(const RawMesh& mesh);

// Reads a serialized Mesh of any bytes. Errors, INVALID_ARGUMENT with the field and the index: not a Mesh, a number
// that is not finite, a vector that is not a unit vector, an index out of range, a list of the wrong size, a shape
// without its parameters, more than `max_triangles` triangles or lines. Takes time and memory proportional to the
// bytes.
absl::StatusOr<RawMesh> ParseMesh(absl::Span<const uint8_t> bytes, size_t max_triangles);

// ParseObjectModel() for all formats of models, kMesh included.
absl::StatusOr<ObjectModel> ParseModelFile(
    absl::Span<const uint8_t> bytes, ModelFormat format, const ModelOptions& options,
    ModelStepListener on_step = [](absl::string_view) {});

}  // namespace evpose::server
