// Positions of the object for a known rotation: which of the parallel lines is which (method.md 2.3).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/image_line.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/search_model.h"

namespace evpose {

struct PoseCandidate {
  RigidTransform camera_from_object;
  double cost = 0.0;  // rough: with widened uncertainties and the lines of a whole cell of views
};

// The cheapest candidates found so far, in no order, a bounded number; one for each pose up to a few degrees.
class BestCandidates {
 public:
  // A candidate that costs `margin` more than the best is dropped.
  BestCandidates(size_t capacity, double margin) : capacity_(capacity), margin_(margin) {
    candidates_.reserve(capacity);
  }
  void Add(const PoseCandidate& candidate);
  double cap() const { return cap_; }  // what a candidate must stay below to be kept
  const std::vector<PoseCandidate>& candidates() const { return candidates_; }

 private:
  size_t capacity_;
  double margin_;
  double cap_ = 1e300;
  std::vector<PoseCandidate> candidates_;
};

class PositionSearch {
 public:
  // All must outlive it.
  PositionSearch(const SearchModel& model, const CameraModel& camera, absl::Span<const ImageLine> lines,
                 const PoseSearchOptions& options);

  // Lays each of the long segments on each line that has a fitting direction and may be seen: a segment that shows the
  // whole line gives the position. The other segments judge it. Takes the positions that it scores from `budget`.
  void Search(const Eigen::Matrix3d& rotation, BestCandidates& best, int& budget);

 private:
  struct Part {  // of a line that may be seen, turned into the camera's attitude
    Eigen::Vector3d a, b;
    int direction = 0;
    double certain_ratio = 0.0;
  };

  struct Vote {
    Eigen::Vector3d position;
    int voter = 0;            // index of the segment
    uint32_t supporters = 0;  // bits of the segments that agree
  };

  void Prepare(const Eigen::Matrix3d& rotation);
  bool PositionFrom(const ImageLine& line, const Part& part, Eigen::Vector3d& position) const;
  void CastVotes();
  void CountSupport();
  bool Project(const Eigen::Vector3d& position);
  double Score(const Eigen::Vector3d& position, double cap);

  const SearchModel& model_;
  const CameraModel& camera_;
  const absl::Span<const ImageLine> lines_;
  const PoseSearchOptions& options_;
  Eigen::Vector3d bearing_ = Eigen::Vector3d::UnitZ();  // to the middle of the segments
  std::vector<Part> parts_;
  std::vector<std::vector<int>> fitting_;  // for each segment the parts whose direction fits
  std::vector<Vote> votes_;
  std::vector<Eigen::Vector2d> a_px_, b_px_;
  std::vector<double> covered_px_;
};

}  // namespace evpose
