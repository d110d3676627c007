// SPDX-License-Identifier: Apache-2.0

// Conversion of images of events and of the geometry of models. A server may send anything.
#include <zlib.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/conversion.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

absl::Status ImageError(absl::string_view what) { return absl::InternalError(absl::StrCat("image: ", what)); }
absl::Status GeometryError(absl::string_view what) { return absl::InternalError(absl::StrCat("geometry: ", what)); }

// The cells of an image of this size, unpacked.
absl::StatusOr<std::vector<uint8_t>> CellsFromProto(const v1::EventImage& message) {
  constexpr uint32_t kMaxSide = 4096;  // longest side of a camera's image, pixels
  if (message.width() == 0 || message.width() > kMaxSide || message.height() == 0 || message.height() > kMaxSide) {
    return ImageError(absl::StrCat("it has ", message.width(), " x ", message.height(), " cells"));
  }
  const size_t num_bytes = (static_cast<size_t>(message.width()) * message.height() + 3) / 4;
  const auto* const bytes = reinterpret_cast<const Bytef*>(message.cells().data());
  std::vector<uint8_t> cells(num_bytes);
  uLongf size = num_bytes;
  switch (message.encoding()) {
    case v1::EventImage::ENCODING_PACKED:
      if (message.cells().size() != num_bytes)
        return ImageError("its size and that of its cells contradict each other");
      std::copy_n(bytes, num_bytes, cells.begin());
      return cells;
    case v1::EventImage::ENCODING_ZLIB:
      if (uncompress(cells.data(), &size, bytes, message.cells().size()) != Z_OK || size != num_bytes) {
        return ImageError("its cells cannot be decompressed to its size");
      }
      return cells;
    default:
      return ImageError(absl::StrCat("its cells have the unknown encoding ", static_cast<int>(message.encoding())));
  }
}

EdgeKind EdgeKindFromProto(char kind) {
  const auto value = static_cast<uint8_t>(kind);
  return value < static_cast<uint8_t>(EdgeKind::kUnknown) ? static_cast<EdgeKind>(value) : EdgeKind::kUnknown;
}

absl::StatusOr<ObjectOutline> OutlineFromProto(const v1::ObjectOutline& message) {
  ObjectOutline outline;
  outline.object_id = message.object_id();
  if (v1::TrackState_IsValid(message.state())) outline.state = static_cast<TrackState>(message.state());
  outline.t_us = message.t_us();
  EVPOSE_ASSIGN_OR_RETURN(outline.camera_from_object, FromProto(message.camera_from_object()));
  if (static_cast<size_t>(message.segments_px_size()) != 4 * message.kinds().size()) {
    return absl::InternalError("the numbers of segments and of kinds contradict each other");
  }
  const float* at = message.segments_px().data();
  outline.segments.reserve(message.kinds().size());
  for (const char kind : message.kinds()) {
    const ObjectOutline::Segment segment = {{at[0], at[1]}, {at[2], at[3]}, EdgeKindFromProto(kind)};
    if (!segment.p1_px.allFinite() || !segment.p2_px.allFinite()) return absl::InternalError("a pixel is not finite");
    outline.segments.push_back(segment);
    at += 4;
  }
  return outline;
}

}  // namespace

absl::StatusOr<EventImage> FromProto(const v1::EventImage& message) {
  EventImage image = {.from_t_us = message.from_t_us(),
                      .to_t_us = message.to_t_us(),
                      .cell_px = static_cast<int>(message.cell_px()),
                      .width = static_cast<int>(message.width()),
                      .height = static_cast<int>(message.height()),
                      .num_events = message.num_events(),
                      .num_skipped = message.num_skipped()};
  if (image.cell_px != 1 && image.cell_px != 2 && image.cell_px != 4) {
    return ImageError(absl::StrCat("cell_px is ", message.cell_px()));
  }
  EVPOSE_ASSIGN_OR_RETURN(image.cells, CellsFromProto(message));
  for (const v1::ObjectOutline& outline : message.outlines()) {
    absl::StatusOr<ObjectOutline> converted = OutlineFromProto(outline);
    if (!converted.ok()) return ImageError(absl::StrCat("outline: ", converted.status().message()));
    image.outlines.push_back(*std::move(converted));
  }
  return image;
}

absl::StatusOr<ModelGeometry> FromProto(const v1::ModelGeometry& message) {
  if (message.vertices_m_size() % 3 != 0 || message.faces_size() % 3 != 0 || message.edges_m_size() % 6 != 0) {
    return GeometryError("its numbers are not those of whole vertices, faces and edges");
  }
  const auto is_finite = [](float number) { return std::isfinite(number); };
  if (!std::all_of(message.vertices_m().begin(), message.vertices_m().end(), is_finite) ||
      !std::all_of(message.edges_m().begin(), message.edges_m().end(), is_finite)) {
    return GeometryError("a number is not finite");
  }
  ModelGeometry geometry;
  geometry.is_simplified = message.simplified();
  const float* const vertices = message.vertices_m().data();
  for (int i = 0; i < message.vertices_m_size(); i += 3) geometry.vertices_m.emplace_back(vertices + i);
  for (int i = 0; i < message.faces_size(); i += 3) {
    const std::array<uint32_t, 3> face = {message.faces(i), message.faces(i + 1), message.faces(i + 2)};
    if (*std::max_element(face.begin(), face.end()) >= geometry.vertices_m.size()) {
      return GeometryError("a face has a vertex that does not exist");
    }
    geometry.faces.push_back(face);
  }
  const float* const edges = message.edges_m().data();
  for (int i = 0; i < message.edges_m_size(); i += 6) {
    geometry.edges_m.push_back({Eigen::Vector3f(edges + i), Eigen::Vector3f(edges + i + 3)});
  }
  return geometry;
}

}  // namespace evpose::client
