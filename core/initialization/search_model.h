// SPDX-License-Identifier: Apache-2.0

// What the pose search knows of a model beforehand: all that does not depend on an image.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

struct SearchLine {
  Eigen::Vector3d p1, p2;  // object frame
  Eigen::Vector3d along;   // unit, p1 to p2
  double length_m = 0.0;
  int direction = 0;   // index into SearchModel::directions
  int model_line = 0;  // index into ObjectModel::lines
};

// Two directions to lay on two image lines. Pairs that a symmetry of the directions maps onto each other are one.
struct DirectionPair {
  int a = 0, b = 0;
  double cosine = 0.0;
  Eigen::Matrix3d frame;      // right-handed: v_a, the part of v_b at right angles to it, their cross product
  bool half_circle = false;   // a symmetry turns v_a round: half of the sweep repeats the other half
  bool one_solution = false;  // a symmetry keeps v_a and turns v_b round: of the two solutions each repeats the other
};

// A line in a view: the part that may be seen, and how much of the whole must be seen, from everywhere in the view.
struct ViewLine {
  int line = 0;  // index into SearchModel::lines
  double begin = 0.0, end = 1.0;
  double certain_ratio = 0.0;
};

// Immutable after construction.
class SearchModel {
 public:
  // Keeps copies of what it needs.
  explicit SearchModel(const ObjectModel& model);
  SearchModel(const SearchModel&) = delete;
  SearchModel& operator=(const SearchModel&) = delete;

  const std::vector<SearchLine>& lines() const { return lines_; }
  const std::vector<Eigen::Vector3d>& directions() const { return directions_; }
  const std::vector<Eigen::Matrix3d>& direction_symmetries() const { return direction_symmetries_; }
  // Rotations Q among the symmetries of the directions, one of each set that the object's own symmetries make equal:
  // a rotation R found from directions alone stands for all R Q.
  const std::vector<Eigen::Matrix3d>& labellings() const { return labellings_; }
  // Of those the ones that the object's lines nearly repeat, with their shifts: lookalikes.h.
  const std::vector<RigidTransform>& lookalikes() const { return lookalikes_; }
  // The most telling first: by the length of the lines that have the directions.
  const std::vector<DirectionPair>& pairs() const { return pairs_; }
  const Eigen::Vector3d& centre() const { return centre_; }
  double radius_m() const { return radius_m_; }  // of the sphere about the centre that holds all lines

  // The lines to be seen from a direction (object frame, from the centre to the camera; any length).
  const std::vector<ViewLine>& View(const Eigen::Vector3d& to_camera) const;
  double mean_view_size() const { return mean_view_size_; }  // lines
  // Visible parts at a pose; VisibleSegment::line is an index into lines().
  std::vector<VisibleSegment> VisibleParts(const CameraModel& camera, const RigidTransform& camera_from_object) const;

 private:
  void ChooseLines(const ObjectModel& model);
  void FindLabellings(const ObjectModel& model);
  void FindPairs();
  void MakeViews();
  std::vector<ViewLine> MakeView(int cell) const;
  Eigen::Vector3d CellPoint(int cell, double u, double v) const;

  std::vector<SearchLine> lines_;
  std::vector<Eigen::Vector3d> directions_;
  std::vector<double> direction_lengths_m_;
  std::vector<Eigen::Matrix3d> direction_symmetries_, labellings_;
  std::vector<RigidTransform> lookalikes_;
  std::vector<DirectionPair> pairs_;
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
  double radius_m_ = 0.0;
  ObjectModel shape_;  // the faces, and the lines that are searched for
  std::unique_ptr<VisibilityTester> visibility_;
  int cells_per_side_ = 1;  // views are the cells of a cube's six faces
  double mean_view_size_ = 0.0;
  std::vector<std::vector<ViewLine>> views_;  // by cell
};

// Keeps the model. Errors: those of CheckLinesDeterminePose.
absl::StatusOr<std::shared_ptr<const SearchModel>> MakeSearchModel(std::shared_ptr<const ObjectModel> model);

}  // namespace evpose
