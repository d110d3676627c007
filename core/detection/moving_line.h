// SPDX-License-Identifier: Apache-2.0

// A straight edge that moves and turns, and its robust fit to events.
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

// In its own frame, s along `direction` and y along (-direction.y, direction.x) from `origin`, the line is
// y = offset + slope s + (speed + slope_rate s) tau + acceleration tau^2 / 2: a plane in space and time, but for the
// last two. An object that turns by 1 rad/s turns a line of 200 px by 3 px at its ends in 30 ms, and a hand that turns
// back stops an edge within the stretch; a plane cannot follow that.
struct MovingLine {
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();
  Eigen::Vector2d direction = Eigen::Vector2d::UnitX();
  double offset_px = 0.0;
  double slope = 0.0;
  double speed_px_per_s = 0.0;
  double slope_rate_per_s = 0.0;
  double acceleration_px_per_s2 = 0.0;
  // Both ends along the line, s = s_px + speed tau; the first is the smaller.
  struct End {
    double s_px = 0.0;
    double speed_px_per_s = 0.0;
    // Events near this end came between these times only. An edge that sends none stands (core/detection/README.md,
    // section 3).
    double first_tau_s = -1e3;
    double last_tau_s = 1e3;
    bool may_grow = true;  // false where the line was cut from another
  };
  std::array<End, 2> ends;
  bool is_polarity[2] = {false, false};  // of the events that are its own
  int num_events = 0;
  double rms_px = 0.0;

  double length_px() const { return ends[1].s_px - ends[0].s_px; }
  Eigen::Vector2d normal() const { return {-direction.y(), direction.x()}; }
  double S(const StretchEvent& event) const {
    return direction.x() * (event.u_px - origin_px.x()) + direction.y() * (event.v_px - origin_px.y());
  }
  // Distance of the event from the line at the event's time, where s is the event's, to the side of the normal.
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
  // Where the end is; carried on beyond the times of its events by little.
  Eigen::Vector2d EndAt(int end, double tau_s) const;
  // The same line with the origin at its middle and slope and offset 0 at tau = 0.
  void Recentre();
};

DetectedLine ToDetectedLine(const MovingLine& line, double half_duration_s);

struct MovingLineOptions {
  // Pixels: farthest event of a line, after the fit. Rounding and an edge's several events spread them by 0.4 to 0.7
  // rms behind a sharp lens, and by 1.2 behind one that blurs by 1.5 px.
  double gate_px = 3.0;
  // Radians per second: how fast lines turn, one standard deviation; keeps short lines from bending to their noise.
  double turn_rad_per_s = 2.0;
  // Pixels per second squared: how fast lines change their speed, one standard deviation: a hand's 3 m/s^2 at 1 m.
  double acceleration_px_per_s2 = 3000.0;

  absl::Status Validate() const;
};

// Fits lines to the events of one stretch, which must outlive it.
class LineFitter {
 public:
  LineFitter(const EventStretch& stretch, const MovingLineOptions& options);

  // Fits `line`, which is near the truth (a pixel), to the events of its polarities, and its extent to where they lie
  // dense: grows it to both sides as far as the edge goes. False when nothing is left of it.
  bool Fit(MovingLine& line);
  // Like Fit, to the events that belong to it: `owner[event] == own`.
  bool FitOwned(MovingLine& line, const std::vector<int16_t>& owner, int16_t own);
  // When the line's events lie along two straight pieces rather than one: the two, cut where the bend is; neither grows
  // beyond it.
  std::optional<std::array<MovingLine, 2>> Split(const MovingLine& line);
  // Indices of the events of the line's polarities within the gate and its extent.
  const std::vector<int32_t>& EventsOf(const MovingLine& line);

 private:
  struct Sample {
    float s = 0.0f;
    float y = 0.0f;
    float tau_s = 0.0f;
    float residual = 0.0f;
  };
  void Collect(const MovingLine& line, double margin_px, double reach_px);
  void SolveRobustly(MovingLine& line, int passes, size_t max_events);
  bool FindExtent(MovingLine& line);
  void FindEndSpeeds(MovingLine& line);
  void FindEndTimes(MovingLine& line);

  const EventStretch& stretch_;
  MovingLineOptions options_;
  std::array<EventGrid, 4> grids_;  // by polarities: those of a line alone are looked at
  std::vector<int32_t> indices_;
  std::vector<Sample> samples_;
  std::vector<float> along_;
  const std::vector<int16_t>* owner_ = nullptr;
  int16_t own_ = -1;
};

}  // namespace evpose
