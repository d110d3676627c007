// SPDX-License-Identifier: Apache-2.0
#include "server/models/prepared_model.h"

#include <utility>

#include "evpose/storage/v1/model.pb.h"
#include "server/models/stored_symmetry.h"

namespace evpose::server {
namespace {

using Numbers = google::protobuf::RepeatedField<double>;

constexpr int kNumbersOfTransform = 12;

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

bool HasWholeParts(const storage::v1::PreparedModel& stored) {
  const auto num_vertices = static_cast<uint32_t>(stored.vertices_size() / 3);
  bool is_whole = stored.vertices_size() % 3 == 0 && stored.triangles_size() % 3 == 0 &&
                  stored.symmetries_size() % kNumbersOfTransform == 0;
  for (const uint32_t vertex : stored.triangles()) is_whole &= vertex < num_vertices;
  for (const auto& line : stored.lines()) is_whole &= line.points_size() == 6 && line.normals_size() % 3 == 0;
  return is_whole;
}

}  // namespace

std::string EncodePreparedModel(const ObjectModel& model) {
  storage::v1::PreparedModel stored;
  for (const Eigen::Vector3d& vertex : model.vertices) Append(vertex, *stored.mutable_vertices());
  for (const auto& triangle : model.triangles) stored.mutable_triangles()->Add(triangle.begin(), triangle.end());
  for (const ModelLine& line : model.lines) {
    auto& added = *stored.add_lines();
    Append(line.p1, *added.mutable_points());
    Append(line.p2, *added.mutable_points());
    for (const Eigen::Vector3d& normal : line.face_normals) Append(normal, *added.mutable_normals());
  }
  stored.set_diameter_m(model.diameter_m);
  for (const RigidTransform& symmetry : model.symmetries) {
    for (int row = 0; row < 3; ++row) Append(symmetry.rotation.row(row).transpose(), *stored.mutable_symmetries());
    Append(symmetry.translation_m, *stored.mutable_symmetries());
  }
  if (model.continuous_symmetry) *stored.mutable_continuous_symmetry() = ToStored(*model.continuous_symmetry);
  for (const std::string& notice : model.notices) stored.add_notices(notice);
  return stored.SerializeAsString();
}

absl::StatusOr<ObjectModel> DecodePreparedModel(absl::string_view encoded) {
  storage::v1::PreparedModel stored;
  if (!stored.ParseFromArray(encoded.data(), static_cast<int>(encoded.size())) || !HasWholeParts(stored)) {
    return absl::DataLossError("the prepared model cannot be parsed");
  }
  ObjectModel model;
  model.vertices = Vectors(stored.vertices());
  for (int at = 0; at < stored.triangles_size(); at += 3) {
    model.triangles.push_back({stored.triangles(at), stored.triangles(at + 1), stored.triangles(at + 2)});
  }
  for (const auto& line : stored.lines()) {
    model.lines.push_back({VectorAt(line.points(), 0), VectorAt(line.points(), 3), Vectors(line.normals())});
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
  return model;
}

}  // namespace evpose::server
