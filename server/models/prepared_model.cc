// SPDX-License-Identifier: Apache-2.0
#include "server/models/prepared_model.h"

#include <utility>

#include "core/base/status_macros.h"
#include "evpose/storage/v1/model.pb.h"
#include "server/models/stored_symmetry.h"
#include "server/models/stored_views.h"

namespace evpose::server {
namespace {

using Numbers = google::protobuf::RepeatedField<double>;
using storage::v1::PreparedModel;

constexpr int kNumbersOfTransform = 12;  // nine of the rotation and three of the translation

void Append(const Eigen::Vector3d& vector, Numbers& numbers) {
  for (const double number : {vector.x(), vector.y(), vector.z()}) numbers.Add(number);
}

Eigen::Vector3d VectorAt(const Numbers& numbers, int at) {
  return {numbers.Get(at), numbers.Get(at + 1), numbers.Get(at + 2)};
}

std::vector<Eigen::Vector3d> Vectors(const Numbers& numbers) {
  std::vector<Eigen::Vector3d> vectors;
  vectors.reserve(static_cast<size_t>(numbers.size() / 3));
  for (int at = 0; at < numbers.size(); at += 3) vectors.push_back(VectorAt(numbers, at));
  return vectors;
}

template <typename Enum>
bool IsAtMost(uint32_t number, Enum last) {
  return number <= static_cast<uint32_t>(last);
}

bool IsWholeSurface(const PreparedModel& stored) {
  const int num_triangles = stored.region_of_size();
  if (stored.regions().empty()) return num_triangles == 0 && stored.corner_normals().empty();
  bool is_whole = num_triangles == stored.triangles_size() / 3 && stored.corner_normals_size() == 9 * num_triangles;
  const auto num_regions = static_cast<uint32_t>(stored.regions_size());
  for (const uint32_t region : stored.region_of()) is_whole &= region < num_regions;
  for (const auto& region : stored.regions()) {
    is_whole &= IsAtMost(region.shape(), RegionShape::kFree) && region.point_size() == 3 && region.axis_size() == 3;
  }
  return is_whole;
}

bool HasWholeParts(const PreparedModel& stored) {
  const auto num_vertices = static_cast<uint32_t>(stored.vertices_size() / 3);
  bool is_whole = stored.vertices_size() % 3 == 0 && stored.triangles_size() % 3 == 0 &&
                  stored.symmetries_size() % kNumbersOfTransform == 0 && IsWholeSurface(stored);
  for (const uint32_t vertex : stored.triangles()) is_whole &= vertex < num_vertices;
  is_whole &= stored.facet_edges_size() % 2 == 0;
  const auto num_sides = static_cast<uint32_t>(stored.triangles_size());
  for (const uint32_t side : stored.facet_edges()) is_whole &= side < num_sides;
  for (const auto& line : stored.lines()) {
    is_whole &= line.points_size() == 6 && line.normals_size() % 3 == 0 && IsAtMost(line.kind(), EdgeKind::kPainted);
  }
  for (const auto& curve : stored.curves()) {
    is_whole &= curve.points_size() % 3 == 0 && curve.points_size() >= 6 &&
                IsAtMost(curve.kind(), EdgeKind::kPainted) && curve.normals_size() == 2 * (curve.points_size() - 3);
  }
  return is_whole;
}

void EncodeCurve(const EdgeCurve& curve, PreparedModel::Curve& added) {
  added.set_kind(static_cast<uint32_t>(curve.kind));
  for (const Eigen::Vector3d& point : curve.points) Append(point, *added.mutable_points());
  for (const auto& normals : curve.face_normals) {
    for (const Eigen::Vector3d& normal : normals) Append(normal, *added.mutable_normals());
  }
  added.set_turn_rad(curve.turn_rad);
}

EdgeCurve DecodeCurve(const PreparedModel::Curve& stored) {
  EdgeCurve curve;
  curve.kind = static_cast<EdgeKind>(stored.kind());
  curve.points = Vectors(stored.points());
  for (int at = 0; at < stored.normals_size(); at += 6) {
    curve.face_normals.push_back({VectorAt(stored.normals(), at), VectorAt(stored.normals(), at + 3)});
  }
  curve.turn_rad = stored.turn_rad();
  return curve;
}

void EncodeSurface(const SmoothSurface& surface, PreparedModel& stored) {
  for (const SurfaceRegion& region : surface.regions) {
    auto& added = *stored.add_regions();
    added.set_shape(static_cast<uint32_t>(region.shape));
    Append(region.point, *added.mutable_point());
    Append(region.axis, *added.mutable_axis());
    added.set_radius_m(region.radius_m);
    added.set_half_angle_rad(region.half_angle_rad);
    added.set_is_convex(region.is_convex);
  }
  stored.mutable_region_of()->Add(surface.region_of.begin(), surface.region_of.end());
  stored.mutable_corner_normals()->Reserve(static_cast<int>(9 * surface.normals.size()));
  for (const auto& corners : surface.normals) {
    for (const Eigen::Vector3f& normal : corners) {
      stored.mutable_corner_normals()->Add(normal.data(), normal.data() + 3);
    }
  }
}

SmoothSurface DecodeSurface(const PreparedModel& stored) {
  SmoothSurface surface;
  for (const auto& region : stored.regions()) {
    surface.regions.push_back({.shape = static_cast<RegionShape>(region.shape()),
                               .point = VectorAt(region.point(), 0),
                               .axis = VectorAt(region.axis(), 0),
                               .radius_m = region.radius_m(),
                               .half_angle_rad = region.half_angle_rad(),
                               .is_convex = region.is_convex()});
  }
  surface.region_of.assign(stored.region_of().begin(), stored.region_of().end());
  surface.normals.resize(surface.region_of.size());
  const float* number = stored.corner_normals().data();
  for (auto& corners : surface.normals) {
    for (Eigen::Vector3f& normal : corners) {
      normal = {number[0], number[1], number[2]};
      number += 3;
    }
  }
  return surface;
}

}  // namespace

std::string EncodePreparedModel(const ObjectModel& model) {
  PreparedModel stored;
  for (const Eigen::Vector3d& vertex : model.vertices) Append(vertex, *stored.mutable_vertices());
  for (const auto& triangle : model.triangles) stored.mutable_triangles()->Add(triangle.begin(), triangle.end());
  for (const ModelLine& line : model.lines) {
    auto& added = *stored.add_lines();
    Append(line.p1, *added.mutable_points());
    Append(line.p2, *added.mutable_points());
    for (const Eigen::Vector3d& normal : line.face_normals) Append(normal, *added.mutable_normals());
    added.set_kind(static_cast<uint32_t>(line.kind));
  }
  for (const EdgeCurve& curve : model.curves) EncodeCurve(curve, *stored.add_curves());
  EncodeSurface(model.surface, stored);
  for (const auto& sides : model.facet_edges) stored.mutable_facet_edges()->Add(sides.begin(), sides.end());
  stored.set_diameter_m(model.diameter_m);
  for (const RigidTransform& symmetry : model.symmetries) {
    for (int row = 0; row < 3; ++row) Append(symmetry.rotation.row(row).transpose(), *stored.mutable_symmetries());
    Append(symmetry.translation_m, *stored.mutable_symmetries());
  }
  if (model.continuous_symmetry) *stored.mutable_continuous_symmetry() = ToStored(*model.continuous_symmetry);
  for (const std::string& notice : model.notices) stored.add_notices(notice);
  if (model.views != nullptr) *stored.mutable_views() = ToStored(*model.views);
  return stored.SerializeAsString();
}

std::string EncodePreparedViews(const SearchViews& views) {
  PreparedModel stored;  // protobuf merges the fields of two encodings in succession
  *stored.mutable_views() = ToStored(views);
  return stored.SerializeAsString();
}

absl::StatusOr<ObjectModel> DecodePreparedModel(absl::string_view encoded) {
  PreparedModel stored;
  if (!stored.ParseFromArray(encoded.data(), static_cast<int>(encoded.size())) || !HasWholeParts(stored)) {
    return absl::DataLossError("the prepared model cannot be parsed");
  }
  ObjectModel model;
  model.vertices = Vectors(stored.vertices());
  model.triangles.reserve(static_cast<size_t>(stored.triangles_size() / 3));
  for (int at = 0; at < stored.triangles_size(); at += 3) {
    model.triangles.push_back({stored.triangles(at), stored.triangles(at + 1), stored.triangles(at + 2)});
  }
  for (const auto& line : stored.lines()) {
    model.lines.push_back({VectorAt(line.points(), 0), VectorAt(line.points(), 3), Vectors(line.normals()),
                           static_cast<EdgeKind>(line.kind())});
  }
  for (const auto& curve : stored.curves()) model.curves.push_back(DecodeCurve(curve));
  model.surface = DecodeSurface(stored);
  for (int at = 0; at < stored.facet_edges_size(); at += 2) {
    model.facet_edges.push_back({stored.facet_edges(at), stored.facet_edges(at + 1)});
  }
  model.diameter_m = stored.diameter_m();
  for (int at = 0; at < stored.symmetries_size(); at += kNumbersOfTransform) {
    RigidTransform symmetry;
    for (int row = 0; row < 3; ++row)
      symmetry.rotation.row(row) = VectorAt(stored.symmetries(), at + 3 * row).transpose();
    symmetry.translation_m = VectorAt(stored.symmetries(), at + 9);
    model.symmetries.push_back(symmetry);
  }
  model.continuous_symmetry = SymmetryOf(stored);
  for (const std::string& notice : stored.notices()) model.notices.push_back(notice);
  if (stored.has_views()) {
    EVPOSE_ASSIGN_OR_RETURN(model.views, ViewsOf(stored.views()));
  }
  return model;
}

}  // namespace evpose::server
