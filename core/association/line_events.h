// SPDX-License-Identifier: Apache-2.0

// A window's events sorted by the lines that they may be of, four side by side: passes over them ask no event for its
// lines, and take vector instructions.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/numerics/lanes.h"

namespace evpose {

// Events as an estimator sees them (Observation). Single precision is enough for what lies within a sensor's width of a
// point: 1e-5 px.
struct EventLanes {
  Lanes bx = {};  // less LineGroup::origin
  Lanes by = {};
  Lanes u_px = {};  // less LineGroup::origin_px
  Lanes v_px = {};
  Lanes tau_s = {};
  Lanes competing = {};
  Lanes turn = {};      // 1 after an event of the other polarity, 1/2 where nobody knows
  Lanes is_event = {};  // 1; 0 where there is none
};

// The events of one polarity that may be of a line: of no other, or of others, too, where they are again.
struct LineGroup {
  uint16_t line = 0;
  uint8_t polarity = 0;
  bool is_shared = false;
  uint32_t first = 0;  // number of its first lanes, among those of the groups that are shared, or are not
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();
  absl::Span<const EventLanes> events;
};

// Where a group's events are about its line, which has moved since they were sorted.
class GroupLine {
 public:
  GroupLine(const LineGroup& group, const ImageLine& line)
      : a_(Across(line.a_expected, group)),
        a_dot_(Across(line.a_dot, group)),
        along_{AllLanes(line.direction.x()), AllLanes(line.direction.y()),
               AllLanes(line.AlongPx(group.origin_px.x(), group.origin_px.y()))},
        length_px_(AllLanes(line.length_px)) {}

  // As evpose::DistancePx and ImageLine::AlongPx.
  Lanes DistancePx(const EventLanes& event) const {
    return At(a_, event.bx, event.by) + event.tau_s * At(a_dot_, event.bx, event.by);
  }
  Lanes AlongPx(const EventLanes& event) const { return At(along_, event.u_px, event.v_px); }
  Lanes length_px() const { return length_px_; }
  // Whether it is an event, in a gate of so many pixels, and not beyond the line's ends.
  LaneMask IsGated(const EventLanes& event, Lanes distance_px, Lanes along_px, Lanes gate_px) const {
    return (Abs(distance_px) <= gate_px) & (along_px >= 0.0f) & (along_px <= length_px_) & (event.is_event > 0.0f);
  }

 private:
  using Affine = std::array<Lanes, 3>;
  static Affine Across(const Eigen::Vector3d& a, const LineGroup& group) {
    return {AllLanes(a.x()), AllLanes(a.y()), AllLanes(a.dot(group.origin.homogeneous()))};
  }
  static Lanes At(const Affine& affine, Lanes x, Lanes y) { return affine[0] * x + affine[1] * y + affine[2]; }

  const Affine a_, a_dot_, along_;
  const Lanes length_px_;
};

class LineEvents {
 public:
  LineEvents() = default;
  LineEvents(absl::Span<const Observation> events, size_t num_lines) { Sort(events, num_lines); }

  // Memory is used again.
  void Sort(absl::Span<const Observation> events, size_t num_lines);

  // All that follows is valid until the next Sort. Groups that are not shared come first.
  absl::Span<const LineGroup> groups() const { return groups_; }

  // An event that may be of several lines.
  struct Shared {
    std::array<uint32_t, Observation::kMaxLines> places;
    uint8_t num_places = 0;
    float competing = 0.0f;

    // Where it is among the shared groups: the number of its lanes times kNumLanes, and its lane.
    absl::Span<const uint32_t> Places() const { return absl::MakeConstSpan(places.data(), num_places); }
  };
  absl::Span<const Shared> shared() const { return shared_; }
  size_t num_shared_lanes() const { return lanes_.size() - first_shared_; }
  // They are no more than that until there are more events than there ever were.
  size_t max_lanes() const { return lanes_.capacity(); }

 private:
  // Groups in the order of groups_, empty ones too.
  size_t KeyOf(const Observation& event, int line) const {
    return (event.num_lines > 1 ? 2 * num_lines_ : 0) + 2 * static_cast<size_t>(line) + event.polarity;
  }
  // For so many events, and twice as many, whatever their lines are.
  void TakeRoom(size_t num_events);
  void MakeGroups();
  // Returns its place.
  uint32_t Place(const Observation& event, int line);

  size_t num_lines_ = 0;
  size_t room_ = 0;               // events that there is room for
  std::vector<uint32_t> counts_;  // by key; then the groups' numbers
  std::vector<uint32_t> next_;    // by group: the next event's place
  std::vector<EventLanes> lanes_;
  size_t first_shared_ = 0;  // of lanes_
  std::vector<LineGroup> groups_;
  std::vector<Shared> shared_;
};

}  // namespace evpose
