// SPDX-License-Identifier: Apache-2.0

// The part of the pose search that depends on the model alone, computed once for all images.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "core/models/object_model.h"
#include "core/models/visibility.h"

namespace evpose {

struct SearchLine {
  Eigen::Vector3d p1, p2;  // end points, object frame
  Eigen::Vector3d along;   // unit vector from p1 to p2
  double length_m = 0.0;
  int direction = 0;   // index into SearchModel::directions
  int model_line = 0;  // index into ObjectModel::lines
};

// Two directions that are assigned to two image lines. Pairs that a symmetry of the directions maps onto each other are
// one pair.
struct DirectionPair {
  int a = 0, b = 0;
  double cosine = 0.0;
  Eigen::Matrix3d frame;           // right-handed: v_a, the component of v_b orthogonal to it, and their cross product
  bool needs_half_circle = false;  // a symmetry reverses v_a: one half of the sweep repeats the other
  bool has_one_solution = false;   // a symmetry preserves v_a and reverses v_b: the second solution repeats the first
};

// Immutable after construction.
class SearchModel {
 public:
  // Copies the parts of the model that it needs. `faces` is the search tree of its triangles; null: computed here.
  explicit SearchModel(const ObjectModel& model, std::shared_ptr<const TriangleBvh> faces = nullptr);
  SearchModel(const SearchModel&) = delete;
  SearchModel& operator=(const SearchModel&) = delete;

  const std::vector<SearchLine>& lines() const { return lines_; }
  const std::vector<Eigen::Vector3d>& directions() const { return directions_; }
  const std::vector<Eigen::Matrix3d>& direction_symmetries() const { return direction_symmetries_; }
  // The assignments of directions to each other: symmetry rotations Q of the set of directions, one of each set that
  // the object's own symmetries make equivalent. A rotation R that follows from directions alone represents all R Q.
  const std::vector<Eigen::Matrix3d>& labellings() const { return labellings_; }
  // Number of the object's own symmetries, the identity included.
  size_t num_symmetries() const { return num_symmetries_; }
  // The near-symmetries among the labellings, with their shifts (line_near_symmetries.h).
  const std::vector<RigidTransform>& near_symmetries() const { return near_symmetries_; }
  // The most informative pair first, by the length of the lines that have the directions.
  const std::vector<DirectionPair>& pairs() const { return pairs_; }
  const Eigen::Vector3d& centre() const { return centre_; }
  double radius_m() const { return radius_m_; }  // of the smallest sphere about the centre that contains all lines

  // The lines that are visible from a direction (object frame, from the centre to the camera; any length).
  const std::vector<ViewLine>& View(const Eigen::Vector3d& to_camera) const;
  // All of them, by cell.
  const SearchViews::LineViews& views() const { return *views_; }
  double mean_view_size() const { return mean_view_size_; }  // mean number of lines in a view
  // Tests the visibility of lines; VisibleSegment::line is an index into lines().
  const VisibilityTester& visibility() const { return *visibility_; }

 private:
  void ChooseLines(const ObjectModel& model);
  void FindLabellings(const ObjectModel& model);
  void FindPairs();
  // Computes the views, or takes those that are stored with the model.
  void MakeViews(const std::shared_ptr<const SearchViews>& stored);
  bool AreOfThisModel(const SearchViews::LineViews& views) const;
  std::vector<ViewLine> MakeView(int cell) const;
  Eigen::Vector3d CellPoint(int cell, double u, double v) const;

  std::vector<SearchLine> lines_;
  std::vector<Eigen::Vector3d> directions_;
  std::vector<double> direction_lengths_m_;
  std::vector<Eigen::Matrix3d> direction_symmetries_, labellings_;
  size_t num_symmetries_ = 1;
  std::vector<RigidTransform> near_symmetries_;
  std::vector<DirectionPair> pairs_;
  Eigen::Vector3d centre_ = Eigen::Vector3d::Zero();
  double radius_m_ = 0.0;
  ObjectModel shape_;  // the lines that are searched for
  std::unique_ptr<VisibilityTester> visibility_;
  int cells_per_side_ = 1;  // the views are the cells of the six faces of a cube
  double mean_view_size_ = 0.0;
  std::shared_ptr<const SearchViews::LineViews> views_;  // by cell
};

// Keeps the model. `faces` as in SearchModel. Errors: those of CheckLinesDeterminePose.
absl::StatusOr<std::shared_ptr<const SearchModel>> MakeSearchModel(std::shared_ptr<const ObjectModel> model,
                                                                   std::shared_ptr<const TriangleBvh> faces = nullptr);

}  // namespace evpose
