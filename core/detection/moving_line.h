// SPDX-License-Identifier: Apache-2.0

// A straight edge that moves and rotates, and its robust fit to events (core/detection/README.md, section 2).
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/detection/event_grid.h"
#include "core/detection/event_stretch.h"
#include "core/detection/line_detector.h"

namespace evpose {

// Equation (2) of the README: in the line's own frame, with s along `direction` and y along (-direction.y, direction.x)
// from `origin`, the line is y = offset + slope s + (speed + slope_rate s) tau + acceleration tau^2 / 2. Without
// slope_rate and acceleration it is a plane in space and time, which cannot represent rotation or a change of speed.
struct MovingLine {
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d direction = Eigen::Vector2d::UnitX();
  double offset_px = 0.0;
  double slope = 0.0;
  double speed_px_per_s = 0.0;
  double slope_rate_per_s = 0.0;
  double acceleration_px_per_s2 = 0.0;
  // The two ends, at s = s_px + speed tau along the line; the first one has the smaller s.
  struct End {
    double s_px = 0.0;
    double speed_px_per_s = 0.0;
    // Time range of the events near this end. Outside of it the edge is at rest (core/detection/README.md, section 3).
    double first_tau_s = -1e3;
    double last_tau_s = 1e3;
    bool may_grow = true;  // false at the end where Split() separated the line from another
  };
  std::array<End, 2> ends;
  bool is_polarity[2] = {false, false};  // whether the line has OFF events, and ON events
  int num_events = 0;
  double rms_px = 0.0;

  double length_px() const { return ends[1].s_px - ends[0].s_px; }
  Eigen::Vector2d normal() const { return {-direction.y(), direction.x()}; }
  double S(const StretchEvent& event) const {
    return direction.x() * (event.u_px - origin_px.x()) + direction.y() * (event.v_px - origin_px.y());
  }
  // Returns the signed distance of the event from the line at the event's time, positive on the side of the normal. `s`
  // must be S(event).
  double Residual(const StretchEvent& event, double s) const {
    const double y = -direction.y() * (event.u_px - origin_px.x()) + direction.x() * (event.v_px - origin_px.y());
    return y - Y(s, event.tau_s);
  }
  double Y(double s, double tau_s) const {
    return offset_px + slope * s +
           (speed_px_per_s + slope_rate_per_s * s + 0.5 * acceleration_px_per_s2 * tau_s) * tau_s;
  }
  bool IsAlong(double s, double tau_s, double margin_px) const {
    return s >= ends[0].s_px + ends[0].speed_px_per_s * tau_s - margin_px &&
           s <= ends[1].s_px + ends[1].speed_px_per_s * tau_s + margin_px;
  }
  Eigen::Vector2d PointAt(double s, double tau_s) const { return origin_px + s * direction + Y(s, tau_s) * normal(); }
  // Returns the position of an end. Outside the time range of its events it moves on by at most 0.6 px.
  Eigen::Vector2d EndAt(int end, double tau_s) const;
  // Changes the frame: origin at the middle of the line, slope and offset 0 at tau = 0.
  void Recentre();
};

DetectedLine ToDetectedLine(const MovingLine& line, double half_duration_s);

struct MovingLineOptions {
  // Maximum distance of the events of a line after the fit, pixels. Their root mean square distance, from rounding and
  // the several events of an edge, is 0.4 to 0.7 px with a sharp lens and 1.2 px with a blur of 1.5 px. All values of
  // this struct are validated by simulated_lines_test and driving_lines_test.
  double gate_px = 3.0;
  // Standard deviation of the rotation of lines, rad/s: a prior, without which short lines would follow their noise.
  // 115 degrees per second, as of an object that is turned by hand.
  double turn_rad_per_s = 2.0;
  // Standard deviation of the acceleration of lines, px/s^2: a prior. 3 m/s^2 of a hand at 1 m, with f = 1000 px.
  double acceleration_px_per_s2 = 3000.0;
  // Bounds of the estimated standard deviation of the distances, pixels. The lower one is about the rounding of pixels
  // (0.29), the upper one that of a sharp lens: a larger one would admit the events of neighbouring edges.
  double min_sigma_px = 0.25;
  double max_sigma_px = 0.7;
  // An edge ends at a gap between its events of this many times their mean spacing, which chance hardly produces
  // (e^-10), but at a gap of at least min_gap_px and at most max_gap_px pixels.
  double gap_spacings = 10.0;
  double min_gap_px = 4.0;
  double max_gap_px = 12.0;
  // A line is split if the mean distances of its parts scatter by more than this, pixels, about one straight line and
  // hardly about two.
  double bent_px = 0.3;

  // Error: INVALID_ARGUMENT naming the field.
  absl::Status Validate() const;
};

// Fits lines to the events of one stretch, which must outlive it.
class LineFitter {
 public:
  LineFitter(const EventStretch& stretch, const MovingLineOptions& options);

  // Fits `line` to the events of its polarities. It must be within about a pixel of an edge. Its extent grows or
  // shrinks to the range in which the events are dense. Returns false if too few events are left.
  bool Fit(MovingLine& line);
  // Does the same with the events for which `owner[event] == own`.
  bool FitOwned(MovingLine& line, const std::vector<int16_t>& owner, int16_t own);
  // Returns two lines, separated at the bend, if two straight pieces fit the events of the line much better than one;
  // neither grows beyond the bend in later fits. Returns nullopt otherwise.
  std::optional<std::array<MovingLine, 2>> Split(const MovingLine& line);
  // Returns the indices of the events of the line's polarities within its gate and extent. Valid until the next call.
  const std::vector<int32_t>& EventsOf(const MovingLine& line);

 private:
  struct Sample {
    float s = 0.0f;
    float y = 0.0f;
    float tau_s = 0.0f;
    float residual = 0.0f;
  };
  // Sets samples_ and indices_ to the events within reach_px across the line and margin_px beyond its ends.
  void Collect(const MovingLine& line, double margin_px, double reach_px);
  // Fits equation (2) to samples_ by iteratively reweighted least squares with Tukey's weights.
  void SolveRobustly(MovingLine& line, int passes, size_t max_events);
  // Sets the ends to the range of dense events in samples_. Returns false if there are too few.
  bool FindExtent(MovingLine& line);
  // Sets the positions and speeds of the ends from the extents in the two halves of the stretch.
  void FindEndSpeeds(MovingLine& line);
  // Sets the time ranges of the events near the ends.
  void FindEndTimes(MovingLine& line);

  const EventStretch& stretch_;
  MovingLineOptions options_;
  std::array<EventGrid, 4> grids_;  // one for each set of polarities, so that a query returns no others
  std::vector<int32_t> indices_;
  std::vector<Sample> samples_;
  std::vector<float> along_;
  const std::vector<int16_t>* owner_ = nullptr;
  int16_t own_ = -1;
};

}  // namespace evpose
