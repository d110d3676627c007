// SPDX-License-Identifier: Apache-2.0

// The observations of a window grouped by candidate line and polarity, with four of them in each vector (structure of
// arrays). The passes of an estimator can then use vector instructions and need no lookup of an event's lines.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "absl/types/span.h"
#include "core/association/association.h"
#include "core/numerics/lanes.h"

namespace evpose {

// Observations in vector lanes. Coordinates are relative to an origin in the image, so that single precision suffices:
// its rounding is 1e-5 px within the width of a sensor.
struct EventLanes {
  Lanes bx = {};  // bearing minus LineGroup::origin
  Lanes by = {};
  Lanes u_px = {};  // undistorted pixel minus LineGroup::origin_px
  Lanes v_px = {};
  Lanes tau_s = {};                 // Observation::tau_s
  Lanes others_per_px = {};         // Observation::others_per_px
  Lanes reversal_probability = {};  // Observation::ReversalProbability()
  Lanes is_event = {};              // 1 in used lanes, 0 in unused ones
};

// The events of one polarity with the same candidate line. Events with this line as their only candidate and events
// with several candidates (shared) are in separate groups; a shared event is in one group for each of its candidates.
struct LineGroup {
  uint16_t line = 0;       // index of the candidate line
  uint8_t polarity = 0;    // 0: OFF, 1: ON
  bool is_shared = false;  // the events have other candidates, too
  uint32_t first = 0;      // index of the group's first EventLanes, among those of groups with the same is_shared
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();     // bearing of the group's first event
  Eigen::Vector2d origin_px = Eigen::Vector2d::Zero();  // its undistorted pixel
  absl::Span<const EventLanes> events;
};

// Computes the positions of a group's events relative to its line. The line may have moved since the events were
// sorted. Always inlined, so that the functions in core/numerics/target_clones.h use the instructions of their clones.
class GroupLine {
 public:
  [[gnu::always_inline]] GroupLine(const LineGroup& group, const ImageLine& line)
      : a_(Across(line.a_expected, group)),
        a_dot_(Across(line.a_dot, group)),
        along_{AllLanes(line.direction.x()), AllLanes(line.direction.y()),
               AllLanes(line.AlongPx(group.origin_px.x(), group.origin_px.y()))},
        along_dot_(AllLanes(line.along_dot_px_per_s)),
        border_{AllLanes(line.border[0]), AllLanes(line.border[1])},
        length_px_(AllLanes(line.length_px)) {}

  // The same quantities as evpose::DistancePx() and evpose::AlongPx().
  [[gnu::always_inline]] Lanes DistancePx(const EventLanes& event) const {
    return At(a_, event.bx, event.by) + event.tau_s * At(a_dot_, event.bx, event.by);
  }
  [[gnu::always_inline]] Lanes AlongPx(const EventLanes& event) const {
    return At(along_, event.u_px, event.v_px) - event.tau_s * along_dot_;
  }
  Lanes length_px() const { return length_px_; }
  // Returns the mask of the used lanes with |distance| <= gate_px and a position between the line's ends, as
  // ImageLine::Spans() without margins.
  [[gnu::always_inline]] LaneMask IsGated(const EventLanes& event, Lanes distance_px, Lanes along_px,
                                          Lanes gate_px) const {
    return (Abs(distance_px) <= gate_px) & (along_px + border_[0] * distance_px >= 0.0f) &
           (along_px + border_[1] * distance_px <= length_px_) & (event.is_event > 0.0f);
  }

 private:
  using Affine = std::array<Lanes, 3>;
  [[gnu::always_inline]] static Affine Across(const Eigen::Vector3d& a, const LineGroup& group) {
    return {AllLanes(a.x()), AllLanes(a.y()), AllLanes(a.dot(group.origin.homogeneous()))};
  }
  [[gnu::always_inline]] static Lanes At(const Affine& affine, Lanes x, Lanes y) {
    return affine[0] * x + affine[1] * y + affine[2];
  }

  const Affine a_, a_dot_, along_;
  const Lanes along_dot_;
  const std::array<Lanes, 2> border_;
  const Lanes length_px_;
};

class LineEvents {
 public:
  LineEvents() = default;
  LineEvents(absl::Span<const Observation> events, size_t num_lines) { Sort(events, num_lines); }

  // Replaces the contents. `num_lines` is the number of lines that the observations' indices refer to; `lines` are
  // their images, or empty if all are straight. The events of an arc are displaced across it by the distance of the arc
  // from its line, so that their distances from the line are those from the arc. Reuses memory.
  void Sort(absl::Span<const Observation> events, size_t num_lines, absl::Span<const ImageLine> lines = {});

  // The results of the accessors below are valid until the next Sort(). Groups that are not shared come first.
  absl::Span<const LineGroup> groups() const { return groups_; }

  // Whether an event may have been produced by another object (Observation::others_per_px).
  bool has_others() const { return has_others_; }

  // An event with several candidate lines.
  struct Shared {
    std::array<uint32_t, Observation::kMaxLines> places;
    uint8_t num_places = 0;
    float others_per_px = 0.0f;

    // The positions of the event in the shared groups: index of the EventLanes among all shared ones, times kNumLanes,
    // plus the lane.
    absl::Span<const uint32_t> Places() const { return absl::MakeConstSpan(places.data(), num_places); }
  };
  absl::Span<const Shared> shared() const { return shared_; }
  size_t num_shared_lanes() const { return lanes_.size() - first_shared_; }
  // Upper bound of the number of EventLanes, until a Sort() with more events than in any earlier one.
  size_t max_lanes() const { return lanes_.capacity(); }

 private:
  // Returns the group of an event and one of its lines, as an index that counts empty groups, in the order of groups_.
  size_t KeyOf(const Observation& event, int line) const {
    return (event.num_lines > 1 ? 2 * num_lines_ : 0) + 2 * static_cast<size_t>(line) + event.polarity;
  }
  // Reserves memory for twice this number of events with any candidate lines.
  void Reserve(size_t num_events);
  void MakeGroups();
  // Writes the event into the group of one of its lines, `image` its image or null if it is straight. Returns its
  // position (Shared::Places).
  uint32_t Place(const Observation& event, int line, const ImageLine* image);

  bool has_others_ = false;
  size_t num_lines_ = 0;
  size_t capacity_ = 0;           // number of events for which memory is reserved
  std::vector<uint32_t> counts_;  // by KeyOf(): number of events, later index into groups_
  std::vector<uint32_t> next_;    // by group: position of the next event
  std::vector<EventLanes> lanes_;
  size_t first_shared_ = 0;  // index into lanes_ of the first shared group's events
  std::vector<LineGroup> groups_;
  std::vector<Shared> shared_;
};

}  // namespace evpose
