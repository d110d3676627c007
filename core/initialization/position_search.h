// SPDX-License-Identifier: Apache-2.0

// Positions of the object for a known rotation: associates segments with one of several parallel lines
// (core/initialization/README.md, section 3).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/initialization/pose_search.h"
#include "core/initialization/search_model.h"
#include "core/initialization/search_segment.h"

namespace evpose {

struct PoseCandidate {
  RigidTransform camera_from_object;
  double cost = 0.0;  // approximate: with inflated standard deviations and the lines of a whole cell of views
};

// The cheapest candidates so far: unordered, bounded in number, one for each pose up to a few degrees.
class BestCandidates {
 public:
  // A candidate that costs more than the best one by more than `margin` is dropped.
  BestCandidates(size_t capacity, double margin) : capacity_(capacity), margin_(margin) {
    candidates_.reserve(capacity);
  }
  void Add(const PoseCandidate& candidate);
  double cap() const { return cap_; }  // only a candidate below this cost is kept
  const std::vector<PoseCandidate>& candidates() const { return candidates_; }

 private:
  size_t capacity_;
  double margin_;
  double cap_ = 1e300;
  std::vector<PoseCandidate> candidates_;
};

// Works in two stages, because scoring is expensive: segments vote for positions, rotation by rotation; then the best
// supported positions of all rotations are scored.
class PositionSearch {
 public:
  // All arguments must outlive the object.
  PositionSearch(const SearchModel& model, const CameraModel& camera, absl::Span<const SearchSegment> segments,
                 const PoseSearchOptions& options);

  // Matches each of the longest segments with each line that may be visible and has a fitting direction. A segment that
  // shows its whole line determines the position. Positions with the votes of several segments are kept.
  void Vote(const Eigen::Matrix3d& rotation);
  // Expected number of votes of a rotation, and the number of votes so far.
  double ExpectedVotes() const;
  int num_votes() const { return num_votes_; }
  // Scores the `max_scored` best supported positions since the previous call.
  void Score(int max_scored, BestCandidates& best);

 private:
  struct Part {            // part of a line that may be visible, rotated into the camera frame
    Eigen::Vector3d a, b;  // end points
    Eigen::Vector3d middle;
    double length_m = 0.0;
    double certain_ratio = 0.0;
  };
  struct SingleVote {  // compact, because votes are sorted
    float x = 0.0f, y = 0.0f, z = 0.0f;
    uint16_t voter = 0;       // bit of the segment
    uint16_t supporters = 0;  // bits of the segments that agree
    int support = 0;

    void AddSupporter(uint16_t bit) {
      support += (supporters & bit) == 0 ? 1 : 0;
      supporters |= bit;
    }
  };
  struct Position {
    Eigen::Vector3d position;
    int rotation = 0;  // index into rotations_
    int support = 0;   // number of segments that agree
  };

  void Prepare(const Eigen::Matrix3d& rotation);
  void CastVotes();
  void CountSupport();
  void KeepBest(int rotation);
  bool Project(const Eigen::Vector3d& position);
  double Cost(const Eigen::Vector3d& position, double cap);

  const SearchModel& model_;
  const CameraModel& camera_;
  const absl::Span<const SearchSegment> segments_;
  const PoseSearchOptions& options_;
  Eigen::Vector3d bearing_ = Eigen::Vector3d::UnitZ();  // to the centre of the segments
  int num_votes_ = 0;
  std::vector<Eigen::Matrix3d> rotations_;
  std::vector<Position> positions_;

  // State for the current rotation.
  std::vector<Part> parts_;      // grouped by direction
  std::vector<int> first_part_;  // start of each direction in parts_, and the end
  std::vector<int> next_part_;
  std::vector<Eigen::Vector3d> turned_;    // rotated directions
  std::vector<std::vector<int>> fitting_;  // for each segment the directions that fit
  std::vector<SingleVote> votes_;
  std::vector<Eigen::Vector2d> a_px_, b_px_;
  std::vector<double> covered_px_;
};

}  // namespace evpose
