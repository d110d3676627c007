// SPDX-License-Identifier: Apache-2.0
#include "core/association/line_events.h"

#include "core/numerics/reusable_vector.h"

namespace evpose {
namespace {

// The bearing of an event, displaced by the distance of the arc from its line.
Eigen::Vector2d StraightenedBearing(const Observation& event, const ImageLine& arc) {
  const Eigen::Vector2d across = arc.a.head<2>();
  const double sagitta_px = arc.ArcOffsetAt(arc.AlongPx(event.u_px, event.v_px));
  return Eigen::Vector2d(event.bx, event.by) - sagitta_px / across.squaredNorm() * across;
}

}  // namespace

void LineEvents::Sort(absl::Span<const Observation> events, size_t num_lines, absl::Span<const ImageLine> lines) {
  num_lines_ = num_lines;
  Reserve(events.size());
  AssignDefaults(4 * num_lines, counts_);
  for (const Observation& event : events) {
    for (const uint16_t line : event.Lines()) ++counts_[KeyOf(event, line)];
  }
  MakeGroups();
  shared_.clear();
  const auto image_of = [&](uint16_t line) {
    return lines.empty() || lines[line].sagitta_px == 0.0 ? nullptr : &lines[line];
  };
  has_others_ = false;
  for (const Observation& event : events) {
    has_others_ |= event.others_per_px > 0.0f;
    std::array<uint32_t, Observation::kMaxLines> places;
    for (int i = 0; i < event.num_lines; ++i) places[i] = Place(event, event.lines[i], image_of(event.lines[i]));
    if (event.num_lines > 1) shared_.push_back({places, event.num_lines, event.others_per_px});
  }
}

void LineEvents::Reserve(size_t num_events) {
  if (num_events <= capacity_) return;
  capacity_ = 2 * num_events;
  shared_.reserve(capacity_);
  // In the worst case each candidate of each event needs an EventLanes of its own.
  lanes_.reserve(capacity_ * Observation::kMaxLines);
}

void LineEvents::MakeGroups() {
  groups_.clear();
  groups_.reserve(counts_.capacity());
  next_.clear();
  next_.reserve(counts_.capacity());
  size_t num_lanes = 0;
  for (size_t key = 0; key < counts_.size(); ++key) {
    if (key == 2 * num_lines_) first_shared_ = num_lanes;
    if (counts_[key] == 0) continue;
    LineGroup& group = groups_.emplace_back();
    group.is_shared = key >= 2 * num_lines_;
    group.line = static_cast<uint16_t>(key / 2 % num_lines_);
    group.polarity = key % 2;
    group.first = static_cast<uint32_t>(num_lanes - (group.is_shared ? first_shared_ : 0));
    next_.push_back(group.first * kNumLanes);
    num_lanes += (counts_[key] + kNumLanes - 1) / kNumLanes;
    counts_[key] = static_cast<uint32_t>(groups_.size() - 1);
  }
  lanes_.resize(num_lanes);
  size_t begin = 0;
  for (size_t i = 0; i < groups_.size(); ++i) {
    const bool is_last = i + 1 == groups_.size();
    const size_t end = is_last ? num_lanes : groups_[i + 1].first + (groups_[i + 1].is_shared ? first_shared_ : 0);
    groups_[i].events = absl::MakeConstSpan(lanes_).subspan(begin, end - begin);
    lanes_[end - 1] = EventLanes();  // it may have unused lanes; all others are overwritten
    begin = end;
  }
}

inline uint32_t LineEvents::Place(const Observation& event, int line, const ImageLine* image) {
  const uint32_t number = counts_[KeyOf(event, line)];
  const uint32_t place = next_[number]++;
  LineGroup& group = groups_[number];
  const Eigen::Vector2d bearing =
      image == nullptr ? Eigen::Vector2d(event.bx, event.by) : StraightenedBearing(event, *image);
  if (place == group.first * kNumLanes) {
    group.origin = bearing;
    group.origin_px = {event.u_px, event.v_px};
  }
  EventLanes& lanes = lanes_[place / kNumLanes + (group.is_shared ? first_shared_ : 0)];
  const uint32_t lane = place % kNumLanes;
  lanes.bx[lane] = static_cast<float>(bearing.x() - group.origin.x());
  lanes.by[lane] = static_cast<float>(bearing.y() - group.origin.y());
  lanes.u_px[lane] = static_cast<float>(event.u_px - group.origin_px.x());
  lanes.v_px[lane] = static_cast<float>(event.v_px - group.origin_px.y());
  lanes.tau_s[lane] = static_cast<float>(event.tau_s);
  lanes.others_per_px[lane] = event.others_per_px;
  lanes.reversal_probability[lane] = static_cast<float>(event.ReversalProbability());
  lanes.is_event[lane] = 1.0f;
  return place;
}

}  // namespace evpose
