// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/scene_reader.h"

#include <assimp/config.h>
#include <assimp/mesh.h>
#include <assimp/scene.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <assimp/Importer.hpp>
#include <cmath>
#include <exception>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/model_intake/gltf_contents.h"
#include "client/model_intake/scene_files.h"
#include "client/model_intake/scene_images.h"
#include "client/model_intake/scene_units.h"
#include "client/model_intake/three_mf_reader.h"
#include "core/base/counted.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/mesh/mesh_repair.h"

namespace evpose::client {
namespace {

// Nodes of a scene; an assembly has some thousand.
constexpr size_t kMaxNodes = 1'000'000;

struct PlacedNode {
  const aiNode* node;
  Eigen::Affine3d scene_from_node;
};

Eigen::Affine3d ToEigen(const aiMatrix4x4& m) {
  Eigen::Affine3d transform;
  transform.matrix() << m.a1, m.a2, m.a3, m.a4, m.b1, m.b2, m.b3, m.b4, m.c1, m.c2, m.c3, m.c4, 0.0, 0.0, 0.0, 1.0;
  return transform;
}

Eigen::Vector3d ToEigen(const aiVector3D& v) { return {v.x, v.y, v.z}; }

// Collects the meshes of a scene. Every index that Assimp returns is checked, because some of its readers pass on those
// of the file.
class SceneCollector {
 public:
  SceneCollector(const aiScene& scene, size_t max_triangles, std::vector<std::string> notices)
      : scene_(scene), counter_({.max_triangles = max_triangles}) {
    out_.mesh.lines_are_all = false;
    out_.notices = std::move(notices);
  }

  absl::StatusOr<Scene> Collect(SceneImages images) {
    std::vector<PlacedNode> open = {{scene_.mRootNode, Eigen::Affine3d::Identity()}};
    for (size_t visited = 0; !open.empty(); ++visited) {
      if (visited == kMaxNodes) return absl::InvalidArgumentError(absl::StrCat("has more than ", kMaxNodes, " nodes"));
      const auto [node, parent] = open.back();
      open.pop_back();
      const Eigen::Affine3d placed = parent * ToEigen(node->mTransformation);
      for (unsigned i = 0; i < node->mNumMeshes; ++i) {
        if (node->mMeshes[i] >= scene_.mNumMeshes)
          return absl::InvalidArgumentError("a node names a mesh that is not there");
        EVPOSE_RETURN_IF_ERROR(AddMesh(*scene_.mMeshes[node->mMeshes[i]], placed, images));
      }
      for (unsigned i = node->mNumChildren; i > 0; --i) open.push_back({node->mChildren[i - 1], placed});
    }
    EVPOSE_RETURN_IF_ERROR(CheckHasElements());
    NotePoints();
    NoteLines();
    FinishCorners();
    TakeNotices(out_.mesh, out_.notices);
    out_.images = std::move(images).Take(out_.notices);
    return std::move(out_);
  }

 private:
  absl::Status AddMesh(const aiMesh& mesh, const Eigen::Affine3d& placed, SceneImages& images) {
    const auto first = static_cast<uint32_t>(out_.mesh.points.size());
    const Eigen::Matrix3d linear = placed.linear();
    const double determinant = linear.determinant();
    // Normals are mapped by the inverse transpose. The matrix of cofactors is a multiple of it, and exists for singular
    // transforms, too.
    Eigen::Matrix3d cofactors;
    for (int i = 0; i < 3; ++i) cofactors.col(i) = linear.col((i + 1) % 3).cross(linear.col((i + 2) % 3));
    if (determinant < 0.0) cofactors = -cofactors;
    const auto [image, channel] = images.ImageOf(mesh);
    for (unsigned i = 0; i < mesh.mNumVertices; ++i) {
      const Eigen::Vector3d point = placed * ToEigen(mesh.mVertices[i]);
      if (!point.allFinite()) return absl::InvalidArgumentError("a coordinate is not finite");
      out_.mesh.points.push_back(point);
      Eigen::Vector3d normal = Eigen::Vector3d::Zero();
      if (mesh.HasNormals()) normal = cofactors * ToEigen(mesh.mNormals[i]);
      const double length = normal.norm();
      if (length > 0.0 && std::isfinite(length)) normal /= length;
      point_normals_.push_back(normal.cast<float>());
      Eigen::Vector2d position = Eigen::Vector2d::Zero();
      if (image >= 0) position = ToEigen(mesh.mTextureCoords[channel][i]).head<2>();
      point_positions_.push_back(position);
    }
    for (unsigned i = 0; i < mesh.mNumFaces; ++i) {
      EVPOSE_RETURN_IF_ERROR(AddFace(mesh.mFaces[i], mesh.mNumVertices, first, determinant < 0.0));
    }
    out_.image_of.resize(out_.mesh.triangles.size(), image);
    return absl::OkStatus();
  }

  absl::Status AddFace(const aiFace& face, unsigned num_vertices, uint32_t first, bool is_mirrored) {
    corners_.clear();
    for (unsigned i = 0; i < face.mNumIndices; ++i) {
      if (face.mIndices[i] >= num_vertices) {
        return absl::InvalidArgumentError(absl::StrCat("a face has the vertex index ", face.mIndices[i],
                                                       ", but its mesh has ", num_vertices, " vertices"));
      }
      corners_.push_back(first + face.mIndices[i]);
    }
    if (corners_.size() == 2) {
      EVPOSE_RETURN_IF_ERROR(counter_.AddLines(1));
      out_.mesh.lines.push_back({corners_[0], corners_[1]});
    }
    if (corners_.size() == 1) ++num_points_;
    if (corners_.size() < 3) return absl::OkStatus();
    EVPOSE_RETURN_IF_ERROR(counter_.AddFace(corners_.size()));
    if (is_mirrored) std::reverse(corners_.begin(), corners_.end());
    AppendPolygon(corners_, out_.mesh);
    return absl::OkStatus();
  }

  absl::Status CheckHasElements() const {
    if (!out_.mesh.triangles.empty() || !out_.mesh.lines.empty()) return absl::OkStatus();
    if (out_.mesh.points.empty()) return absl::InvalidArgumentError("has no triangle and no line");
    return absl::InvalidArgumentError(
        absl::StrCat("has ", Counted(out_.mesh.points.size(), "point"),
                     ", but no triangle and no line: a cloud of points has no surface; export the faces of the object, "
                     "or compute a mesh from the points"));
  }

  void NotePoints() {
    if (num_points_ == 0) return;
    out_.notices.push_back(absl::StrCat(Counted(num_points_, "point element"),
                                        " of the file not used: single points have no visible edges"));
  }

  void NoteLines() {
    if (out_.mesh.lines.empty() || out_.mesh.triangles.empty()) return;
    out_.notices.push_back(absl::StrCat(Counted(out_.mesh.lines.size(), "line"),
                                        " of the file taken as visible edges that are drawn on the surface; export the "
                                        "model without lines if nothing is drawn there"));
  }

  // Values of points become those of corners; then points that nothing uses are removed, because they would count as a
  // part of the object's size.
  void FinishCorners() {
    const bool has_normals = std::any_of(point_normals_.begin(), point_normals_.end(),
                                         [](const Eigen::Vector3f& normal) { return !normal.isZero(0.0f); });
    for (const auto& [a, b, c] : out_.mesh.triangles) {
      if (has_normals) out_.mesh.corner_normals.push_back({point_normals_[a], point_normals_[b], point_normals_[c]});
      out_.image_positions.push_back({point_positions_[a], point_positions_[b], point_positions_[c]});
    }
    DropUnusedPoints(out_.mesh);
  }

  const aiScene& scene_;
  ElementCounter counter_;
  Scene out_;
  size_t num_points_ = 0;  // elements of one corner
  std::vector<uint32_t> corners_;
  std::vector<Eigen::Vector3f> point_normals_;
  std::vector<Eigen::Vector2d> point_positions_;
};

const aiScene* Import(Assimp::Importer& importer, const std::string& path, const std::string& contents) {
  importer.SetIOHandler(new SceneFiles(path, contents));  // which the importer deletes
  // The axes stay those of the file, so that a pose refers to the coordinates of the CAD model. The unit of COLLADA is
  // applied by Assimp, as a scale of the root node.
  importer.SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_IGNORE_UP_DIRECTION, true);
  importer.SetPropertyBool(AI_CONFIG_IMPORT_NO_SKELETON_MESHES, true);
  return importer.ReadFile(path, 0);
}

}  // namespace

absl::StatusOr<Scene> ReadScene(const std::string& path, SceneFormat format, size_t max_triangles) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string contents, ReadFile(path, kMaxModelFileBytes));
  EVPOSE_RETURN_IF_ERROR(CheckContents(contents, format));
  GltfContents gltf;
  if (format == SceneFormat::kGltf || format == SceneFormat::kGlb) {
    EVPOSE_ASSIGN_OR_RETURN(gltf, CheckGltf(contents));
  }
  try {
    if (format == SceneFormat::k3mf) return Read3mf(path, max_triangles);
    Assimp::Importer importer;
    const aiScene* const scene = Import(importer, path, contents);
    if (scene == nullptr || scene->mRootNode == nullptr) {
      return absl::InvalidArgumentError(absl::StrCat(
          "cannot be read: ", importer.GetErrorString(),
          gltf.has_draco ? "; its triangles are compressed by KHR_draco_mesh_compression: export it without "
                           "compression"
                         : ""));
    }
    return SceneCollector(*scene, max_triangles, std::move(gltf.notices))
        .Collect(SceneImages(*scene, path, gltf.are_images_read));
  } catch (const std::exception& error) {  // exceptions of Assimp and OpenCV
    return absl::InvalidArgumentError(absl::StrCat("cannot be read: ", error.what()));
  }
}

}  // namespace evpose::client
