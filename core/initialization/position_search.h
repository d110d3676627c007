// SPDX-License-Identifier: Apache-2.0

// Positions of the object for a known rotation: which of the parallel lines is which (core/initialization/README.md).
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

// Two stages, because scoring is dear: segments vote for positions, rotation by rotation; then the best supported of
// all positions are scored.
class PositionSearch {
 public:
  // All must outlive it.
  PositionSearch(const SearchModel& model, const CameraModel& camera, absl::Span<const SearchSegment> lines,
                 const PoseSearchOptions& options);

  // Lays each of the long segments on each line that has a fitting direction and may be seen: a segment that shows the
  // whole line gives the position. Positions that several segments agree on are kept.
  void Vote(const Eigen::Matrix3d& rotation);
  // About how many votes a rotation takes, and how many have been cast.
  double ExpectedVotes() const;
  int num_votes() const { return num_votes_; }
  // Scores the `max_scored` best supported positions since the last call.
  void Score(int max_scored, BestCandidates& best);

 private:
  struct Part {            // of a line that may be seen, turned into the camera's attitude
    Eigen::Vector3d a, b;  // ends
    Eigen::Vector3d middle;
    double length_m = 0.0;
    double certain_ratio = 0.0;
  };
  struct SingleVote {  // small: they are sorted
    float x = 0.0f, y = 0.0f, z = 0.0f;
    uint16_t voter = 0;       // bit of the segment
    uint16_t supporters = 0;  // bits of the segments that agree, and how many
    int support = 0;

    void AddSupporter(uint16_t bit) {
      support += (supporters & bit) == 0 ? 1 : 0;
      supporters |= bit;
    }
  };
  struct Position {
    Eigen::Vector3d position;
    int rotation = 0;  // index into rotations_
    int support = 0;   // segments that agree
  };

  void Prepare(const Eigen::Matrix3d& rotation);
  void CastVotes();
  void CountSupport();
  void KeepBest(int rotation);
  bool Project(const Eigen::Vector3d& position);
  double Cost(const Eigen::Vector3d& position, double cap);

  const SearchModel& model_;
  const CameraModel& camera_;
  const absl::Span<const SearchSegment> lines_;
  const PoseSearchOptions& options_;
  Eigen::Vector3d bearing_ = Eigen::Vector3d::UnitZ();  // to the middle of the segments
  int num_votes_ = 0;
  std::vector<Eigen::Matrix3d> rotations_;
  std::vector<Position> positions_;

  // For the rotation at hand.
  std::vector<Part> parts_;      // by direction
  std::vector<int> first_part_;  // of each direction, and one more
  std::vector<int> next_part_;
  std::vector<Eigen::Vector3d> turned_;    // directions
  std::vector<std::vector<int>> fitting_;  // for each segment the directions that fit
  std::vector<SingleVote> votes_;
  std::vector<Eigen::Vector2d> a_px_, b_px_;
  std::vector<double> covered_px_;
};

}  // namespace evpose
