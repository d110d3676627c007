// SPDX-License-Identifier: Apache-2.0

// Measures where the lines of a model are in the image, from the events of short intervals of a tracked recording
// (core/calibration/README.md, section 2). The bundle adjustment of a camera calibration is fitted to the result.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/association/visible_edges.h"
#include "core/events/correlated_events.h"
#include "core/events/event.h"
#include "core/geometry/camera.h"
#include "core/geometry/rigid_transform.h"
#include "core/numerics/robust.h"

namespace evpose {

// An interval in which the object moves by a few pixels.
struct CalibrationInterval {
  int recording = 0;
  int64_t t_us = 0;         // its middle, to which the pose belongs
  int64_t duration_us = 0;  // of the events
  RigidTransform camera_from_object;
  Vector6d twist = Vector6d::Zero();  // as PoseEstimate::twist
  bool is_degraded = false;           // the pose was DEGRADED, as all poses are with a wrong camera
  std::vector<Event> events;
};

// The mean position of the events of a piece of a line.
struct LineSample {
  int interval = 0;
  int line = 0;                                      // TrackedLine::curve
  Eigen::Vector3d point = Eigen::Vector3d::Zero();   // of the line, object frame, metres
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();   // on the sensor, where the events have the line at that point
  Eigen::Vector2d normal = Eigen::Vector2d::Zero();  // unit, across the line
  double sigma_px = 1.0;                             // expected standard error
  // Side of the darker surface along the normal: 1 or -1; 0 for a line without a majority of one polarity.
  double dark_side = 0.0;
  double motion = 0.0;          // sign of the motion along the normal: 1 or -1
  double speed_px_per_s = 0.0;  // across the line, magnitude
  double events_per_px2 = 0.0;  // of the whole line in the interval, per swept area
  double num_events = 0.0;
};

// The defaults are validated as those of CameraCalibrationOptions, and by tests/bench/real/calibration.py on real
// recordings of small sensors, which have few events for each piece.
struct LineSampleOptions {
  // Largest distance, pixels, of the events of a line from its expected position; at most a third of the distance to
  // the nearest other line, so that the events of that line are outside.
  double gate_px = 4.0;
  // Smallest such distance at which a piece is used, pixels: three standard deviations of the events. Lines that are
  // nearer than three times as much and parallel to the piece are measured together with it.
  double min_gate_px = 2.0;
  // Length of the pieces, pixels: the lens bends them by less than 0.05 px, and they have enough events.
  double piece_px = 20.0;
  // Shortest pieces, of lines that are shorter than six of the others, pixels: they still have enough events.
  double min_piece_px = 6.0;
  // Smallest number of events of a piece, for their mean.
  double min_events = 12.0;
  // For intervals that have less than `min_samples` otherwise, of a small sensor or a fast motion: this number of
  // events, and either pieces that are at least a third of their line, or this distance from the expected position, at
  // which the events of a line 4.5 px away are two standard deviations outside. What gives the most samples is used.
  int min_samples = 24;
  double min_events_if_sparse = 6.0;
  double min_gate_if_sparse_px = 1.5;
  // Smallest normal speed, px/s: a slower line has too few events to be distinguished from noise.
  double min_speed_px_per_s = 20.0;
  // Correlated events that count as one, and error of the model of an edge, pixels, as in sensor_calibration.h.
  double events_per_information = kCorrelatedEvents;
  double model_error_px = 0.05;
  // Smallest share by which one polarity predominates for the darker side to be known.
  double min_kappa = 0.5;
};

// Not thread-safe. Keeps a reference to `edges`.
class LineSampler {
 public:
  // `camera` must be valid.
  LineSampler(const CameraModel& camera, const ModelEdges& edges, const LineSampleOptions& options = {});

  // Appends the samples of an interval, whose index they get.
  void Sample(const CalibrationInterval& interval, int index, std::vector<LineSample>& samples);

 private:
  struct Piece {
    int line = 0;
    Eigen::Vector3d point;               // its middle, object frame
    Eigen::Vector2d begin, middle, end;  // on the sensor
    Eigen::Vector2d along, normal;       // unit
    double half_px = 0.0;
    double bow_px = 0.0;             // of the ends across the tangent in the middle
    double normal_speed_px_s = 0.0;  // along the normal
    double along_speed_px_s = 0.0;
    double gate_px = 0.0;
    // Distances along the normal from this line to those that are so near and so nearly parallel that their events are
    // measured together with its own.
    std::vector<double> companions_px;
    std::vector<double> distances_px;
    double polarity[2] = {0.0, 0.0};
  };

  // How the lines of an interval are measured.
  struct Cut {
    double pieces_per_line = 0.0;  // at least, except of short lines
    double min_events = 0.0;
    double min_gate_px = 0.0;
  };

  std::vector<LineSample> SampleWith(const Cut& cut, const CalibrationInterval& interval, int index);
  void MakePieces(const Cut& cut, const CalibrationInterval& interval);
  void AddPieces(const TrackedLine& line, double pieces_per_line, const CalibrationInterval& interval);
  bool ProjectPoint(const RigidTransform& pose, const Eigen::Vector3d& point, Eigen::Vector2d& pixel) const;
  void SetGates(double min_gate_px);
  // True if `other` is so near and parallel to `piece` that it is measured together with it: among its companions.
  bool AddCompanion(const Piece& other, double min_gate_px, Piece& piece) const;
  void EnterCells(int index);
  void AddEvent(const Event& event, double tau_s);
  void Finish(Piece& piece, double min_events, int index, std::vector<LineSample>& samples) const;
  // Sets the density of the events of the samples of one interval.
  void SetDensities(double duration_s, absl::Span<LineSample> samples) const;

  const CameraModel camera_;
  const LineSampleOptions options_;
  const ExpTable table_;
  VisibleEdges visible_;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<std::vector<int>> cells_;  // indices of the pieces near each cell of the image
  std::vector<int> used_cells_;
  std::vector<Piece> pieces_;
};

}  // namespace evpose
