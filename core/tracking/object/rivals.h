// SPDX-License-Identifier: Apache-2.0

// Rivals of a pose: other poses of the object with nearly the same image. At first the events may not distinguish them
// from it (core/tracking/README.md, section 6).
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/association/visible_edges.h"
#include "core/geometry/motion_prior.h"
#include "core/models/object_model.h"
#include "core/numerics/math.h"

namespace evpose {

// Returns the state in which the direction `normal` at `point` (both in the object frame) is reflected at the plane
// through the point that is perpendicular to its ray (equation (9) of the README). The image of a disc with this
// normal is the same up to perspective. The point and its velocity stay; the direction moves as the mirror image does.
// The covariance is that of a new track for the pose, and for the twist that of `state`, enlarged.
MotionState MirroredState(const MotionState& state, const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                          double focal_px, const InitialPoseOptions& options);

// Returns the state of the object moved by `object_from_object`, with the same motion in space. Covariance as above.
MotionState MovedState(const MotionState& state, const RigidTransform& object_from_object, double focal_px,
                       const InitialPoseOptions& options);

// What is known about a rival before its test.
enum class RivalPrior {
  kEqual,
  // An earlier test excluded the rival, or the first pose was given. The comparison with it counts as undecided only if
  // the events prefer the rival by half of InitializationOptions::decision_sigma.
  kUnlikely,
};

// Finds when a flat face has passed the position in which the camera sees it edge-on, where its two inclinations have
// the same image. A track may continue on the wrong side.
class TurnedFaceDetector {
 public:
  // `edges` must outlive the detector. `inclined_rad`: the inclination at which the mirrored state is due.
  TurnedFaceDetector(const ModelEdges& edges, double inclined_rad);

  // To be called with each tracked state; after a loss, Reset() must be called before. Returns an index in
  // ModelEdges::face_planes() if a rival must be tested now: the present state, mirrored at this plane. If several
  // planes are due at once, the index is that of the widest one, because the mirrored states of the other planes differ
  // too little from the mirrored state of this plane.
  std::optional<size_t> Update(const RigidTransform& camera_from_object, double focal_px);
  void Reset();

  // LoadState() requires the same model.
  void SaveState(StateWriter& writer) const { VisitState(writer, *this); }
  void LoadState(StateReader& reader) { VisitState(reader, *this); }

 private:
  enum class Side : uint8_t { kUnknown, kFront, kBack, kEdgeOn };

  static void VisitState(auto& archive, auto& self) {
    for (auto& side : self.sides_) archive(AtMost(side, Side::kEdgeOn));
  }

  const ModelEdges& edges_;
  const double inclined_sine_;
  std::vector<Side> sides_;  // sides of the planes
};

// What has been measured since a test of tilted rivals.
struct SinceTiltTest {
  Eigen::Vector3d ray = Eigen::Vector3d::Zero();  // unit vector in the object frame at the test
  double mean_residual_px = 0.0;                  // running mean
  double least_residual_px = 0.0;                 // its least value
  static void VisitState(auto& archive, auto& self) {
    archive(Finite(self.ray), Finite(self.mean_residual_px), Finite(self.least_residual_px));
  }
};

// Decides when the tilted rivals of a published pose must be tested (core/tracking/README.md, section 6).
class TiltTestTrigger {
 public:
  // `turned_rad`: the angle by which the view turns between two tests. `growth`: the ratio by which the residual grows.
  TiltTestTrigger(double turned_rad, double growth)
      : turned_cosine_(DeterministicSinCos(turned_rad).cos),
        partly_turned_cosine_(DeterministicSinCos(kPart * turned_rad).cos),
        growth_(growth) {}

  // To be called with each tracked pose. `point` is that of the object (object frame) to which the rays are drawn,
  // `residual_px` the root mean square of the residuals. True for the first pose, and whenever, since the last pose for
  // which the result was true, the ray has turned by the angle, or by a third of it while the mean residual of the
  // latest poses has grown by the ratio.
  bool Update(const RigidTransform& camera_from_object, const Eigen::Vector3d& point, double residual_px);
  // The next pose is a new one.
  void Reset() { test_.reset(); }

  void SaveState(StateWriter& writer) const { VisitState(writer, *this); }
  void LoadState(StateReader& reader) { VisitState(reader, *this); }

 private:
  static void VisitState(auto& archive, auto& self) { archive(self.test_); }

  // A residual also grows by clutter, beside an object that does not turn.
  static constexpr double kPart = 1.0 / 3.0;

  const double turned_cosine_;
  const double partly_turned_cosine_;
  const double growth_;
  std::optional<SinceTiltTest> test_;
};

// The rigid motions and directions of a model from which rivals of any pose follow.
class RivalGenerator {
 public:
  explicit RivalGenerator(const ObjectModel& model);

  // Returns the rivals of a state, at most kMaxRivals: half turns about the principal axes of the edges, or of the
  // surface if it has contours, quarter turns about those across which it is about equally wide, and the reflections of
  // these axes, each also after a half turn. Those that equal the state or an earlier rival by the symmetry of the
  // model, or nearly (`merge_rad`), are left out.
  std::vector<MotionState> RivalsOf(const MotionState& state, double focal_px, const InitialPoseOptions& options,
                                    double merge_rad) const;
  // Three half turns, two quarter turns about each axis, three reflections, and each reflection after each half turn.
  static constexpr int kMaxRivals = 21;

  // Returns the state turned by `tilt_rad` about four axes through the centroid that are perpendicular to its ray, 90
  // degrees apart. Those that equal the state by the symmetry of the model, or nearly (`merge_rad`), are left out.
  std::vector<MotionState> TiltedRivalsOf(const MotionState& state, double tilt_rad, double focal_px,
                                          const InitialPoseOptions& options, double merge_rad) const;
  // Centroid of the edges, or of the surface if the model has contours, in the object frame.
  const Eigen::Vector3d& centroid() const { return centroid_; }

 private:
  // Whether the rotations of both poses differ by less than `merge_rad` modulo the symmetries of the model.
  bool IsSame(const MotionState& a, const MotionState& b, double merge_rad) const;

  const ObjectModel& model_;
  Eigen::Vector3d centroid_ = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> axes_;          // principal axes that are determined
  std::vector<RigidTransform> half_turns_;     // about these, or across the axis of a round object
  std::vector<RigidTransform> quarter_turns_;  // about those across which the object is about equally wide
};

}  // namespace evpose
