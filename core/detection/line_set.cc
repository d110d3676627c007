// SPDX-License-Identifier: Apache-2.0
#include "core/detection/line_set.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/base/check_range.h"

namespace evpose {
namespace {

// Maximum number of lines of a stretch, which bounds the work; the index of a line must fit into 16 bits.
constexpr size_t kMaxLines = 300;
constexpr int16_t kNoOwner = -1;
constexpr int kMaxSplits = 3;  // depth of the recursion, which bounds the work: eight pieces
// Smallest sine of the angle between two lines that form a corner (4 degrees). The crossing of nearly parallel lines is
// undetermined.
constexpr double kCrossingSine = 0.07;
// Below this sine (24 degrees) the gates of two lines overlap over a long distance, so that their ends are less
// accurate. The limit corner_px then grows in inverse proportion to the sine, up to this factor.
constexpr double kFlatSine = 0.4;
constexpr double kFlatReach = 2.0;
// Maximum distance along the line of the corresponding ends of a stripe's sides, and maximum variation of the distance
// between the sides, pixels: they end together and are parallel.
constexpr double kStripeEndPx = 10.0;
constexpr double kStripeParallelPx = 1.2;
// A merged line must have at least this share of the events of its two pieces.
constexpr double kMergedEventsRatio = 0.8;
// Corners may shorten a line to this share of min_length_px: its events were those of a line that is long enough.
constexpr double kShortenedRatio = 0.8;
constexpr double kMinSegmentPx = 1.0;  // a shorter segment has no direction

class LineSelection {
 public:
  LineSelection(const EventStretch& stretch, const LineSetOptions& options)
      : stretch_(stretch), options_(options), fitter_(stretch, options.fit), owner_(stretch.events.size(), kNoOwner) {}

  // Fits a candidate, splits it if it is bent, and adds the lines that pass the tests of the options.
  void Add(const MovingLine& candidate, int splits = 0) {
    if (lines_.size() >= kMaxLines || IsDuplicate(candidate)) return;
    MovingLine line = candidate;
    if (!fitter_.Fit(line)) return;
    if (splits < kMaxSplits) {
      if (const auto pieces = fitter_.Split(line)) {
        for (const MovingLine& piece : *pieces) Add(piece, splits + 1);
        return;
      }
    }
    if (!IsGood(line) || IsDuplicate(line)) return;
    const auto own = static_cast<int16_t>(lines_.size());
    for (const int32_t index : fitter_.EventsOf(line)) {
      if (owner_[index] == kNoOwner) owner_[index] = own;
    }
    lines_.push_back(line);
  }

  // Assigns each event to its nearest line, fits the lines to their own events, and removes lines with too few of them.
  void AssignEvents() {
    std::vector<float> distance(stretch_.events.size(), 1e9f);
    std::fill(owner_.begin(), owner_.end(), kNoOwner);
    for (size_t i = 0; i < lines_.size(); ++i) {
      for (const int32_t index : fitter_.EventsOf(lines_[i])) {
        const StretchEvent& event = stretch_.events[index];
        const auto residual = static_cast<float>(std::abs(lines_[i].Residual(event, lines_[i].S(event))));
        if (residual >= distance[index]) continue;
        distance[index] = residual;
        owner_[index] = static_cast<int16_t>(i);
      }
    }
    std::vector<MovingLine> kept;
    for (size_t i = 0; i < lines_.size(); ++i) {
      MovingLine line = lines_[i];
      if (fitter_.FitOwned(line, owner_, static_cast<int16_t>(i)) && IsGood(line)) kept.push_back(line);
    }
    lines_ = std::move(kept);
  }

  // Merges lines that are pieces of one edge.
  void MergePieces() {
    for (size_t i = 0; i < lines_.size(); ++i) {
      for (size_t j = i + 1; j < lines_.size();) {
        const std::optional<MovingLine> merged = Merged(lines_[i], lines_[j]);
        if (merged) {
          lines_[i] = *merged;
          lines_.erase(lines_.begin() + static_cast<std::ptrdiff_t>(j));
          j = i + 1;
        } else {
          ++j;
        }
      }
    }
  }

  // Returns the lines, with one line for the two sides of a stripe.
  std::vector<DetectedLine> MergeStripes() const {
    std::vector<DetectedLine> detected;
    std::vector<bool> is_done(lines_.size(), false);
    for (size_t i = 0; i < lines_.size(); ++i) {
      if (is_done[i]) continue;
      detected.push_back(ToDetectedLine(lines_[i], stretch_.half_duration_s()));
      for (size_t j = i + 1; j < lines_.size(); ++j) {
        if (is_done[j] || lines_[i].is_polarity[0] == lines_[j].is_polarity[0]) continue;
        const DetectedLine other = ToDetectedLine(lines_[j], stretch_.half_duration_s());
        const std::optional<DetectedLine> stripe = Stripe(detected.back(), other);
        if (!stripe) continue;
        detected.back() = *stripe;
        is_done[j] = true;
        break;
      }
    }
    return detected;
  }

 private:
  bool IsGood(const MovingLine& line) const {
    return line.num_events >= options_.min_events && line.length_px() >= options_.min_length_px &&
           line.num_events >= options_.min_events_per_px * line.length_px() && line.rms_px <= options_.max_rms_px;
  }

  bool IsDuplicate(const MovingLine& line) {
    const std::vector<int32_t>& events = fitter_.EventsOf(line);
    const auto owned =
        std::count_if(events.begin(), events.end(), [this](int32_t index) { return owner_[index] != kNoOwner; });
    return static_cast<double>(owned) > options_.max_owned_ratio * static_cast<double>(events.size());
  }

  // Returns one line for both if they are pieces of one edge.
  std::optional<MovingLine> Merged(const MovingLine& a, const MovingLine& b) {
    const MovingLine& longer = a.length_px() >= b.length_px() ? a : b;
    const MovingLine& other = a.length_px() >= b.length_px() ? b : a;
    const double half_s = stretch_.half_duration_s();
    MovingLine merged = longer;
    double begin = 1e9, end = -1e9;
    for (const int k : {0, 1}) {
      for (const double tau : {-half_s, half_s}) {
        const Eigen::Vector2d point = other.EndAt(k, tau) - longer.origin_px;
        const double s = longer.direction.dot(point);
        const double y = longer.normal().dot(point);
        if (std::abs(y - longer.Y(s, tau)) > options_.merge_px) return std::nullopt;
      }
      const double s = longer.direction.dot(other.EndAt(k, 0.0) - longer.origin_px);
      begin = std::min(begin, s);
      end = std::max(end, s);
    }
    if (std::max(begin - longer.ends[1].s_px, longer.ends[0].s_px - end) > options_.corner_px) return std::nullopt;
    for (const int polarity : {0, 1}) merged.is_polarity[polarity] = a.is_polarity[polarity] || b.is_polarity[polarity];
    merged.ends[0] = {};
    merged.ends[1] = {};
    merged.ends[0].s_px = std::min(longer.ends[0].s_px, begin);
    merged.ends[1].s_px = std::max(longer.ends[1].s_px, end);
    if (!fitter_.Fit(merged) || !IsGood(merged) || fitter_.Split(merged)) return std::nullopt;
    if (merged.num_events < kMergedEventsRatio * (a.num_events + b.num_events)) return std::nullopt;
    return merged;
  }

  // Returns the line between both if they are the sides of a stripe.
  std::optional<DetectedLine> Stripe(const DetectedLine& a, DetectedLine b) const {
    if ((a.at_end.p2_px - a.at_end.p1_px).dot(b.at_end.p2_px - b.at_end.p1_px) < 0.0) {
      std::swap(b.at_begin.p1_px, b.at_begin.p2_px);
      std::swap(b.at_end.p1_px, b.at_end.p2_px);
      b.normal_velocity_px_per_s = -b.normal_velocity_px_per_s;
    }
    const Eigen::Vector2d along = (a.at_end.p2_px - a.at_end.p1_px).normalized();
    const Eigen::Vector2d normal(-along.y(), along.x());
    const Eigen::Vector2d between[4] = {b.at_begin.p1_px - a.at_begin.p1_px, b.at_begin.p2_px - a.at_begin.p2_px,
                                        b.at_end.p1_px - a.at_end.p1_px, b.at_end.p2_px - a.at_end.p2_px};
    double low = 1e9, high = -1e9;
    for (const Eigen::Vector2d& way : between) {
      if (std::abs(along.dot(way)) > kStripeEndPx) return std::nullopt;
      low = std::min(low, normal.dot(way));
      high = std::max(high, normal.dot(way));
    }
    if (std::max(std::abs(low), std::abs(high)) > options_.stripe_px || high - low > kStripeParallelPx) {
      return std::nullopt;
    }
    const auto mean = [](const ImageSegment& p, const ImageSegment& q) {
      return ImageSegment{0.5 * (p.p1_px + q.p1_px), 0.5 * (p.p2_px + q.p2_px)};
    };
    return DetectedLine{mean(a.at_begin, b.at_begin), mean(a.at_end, b.at_end),
                        0.5 * (a.normal_velocity_px_per_s + b.normal_velocity_px_per_s), a.num_events + b.num_events,
                        std::sqrt(0.5 * (a.rms_px * a.rms_px + b.rms_px * b.rms_px))};
  }

  const EventStretch& stretch_;
  const LineSetOptions& options_;
  LineFitter fitter_;
  std::vector<int16_t> owner_;  // by event: index of its line, or kNoOwner
  std::vector<MovingLine> lines_;
};

struct Crossing {
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  // The larger of the distances of the point from the end of the first line and from the nearest point of the second.
  double distance_px = 0.0;
  double reach = 1.0;  // factor of the limit corner_px
};

// Returns the crossing of the infinite lines through `line` and `other`; nullopt if they are nearly parallel.
std::optional<Crossing> FindCrossing(const ImageSegment& line, int end, const ImageSegment& other) {
  const double length = line.length_px(), other_length = other.length_px();
  if (length < kMinSegmentPx || other_length < kMinSegmentPx) return std::nullopt;
  const Eigen::Vector2d along = (line.p2_px - line.p1_px) / length, across = (other.p2_px - other.p1_px) / other_length;
  const double sine = along.x() * across.y() - along.y() * across.x();
  if (std::abs(sine) < kCrossingSine) return std::nullopt;
  const Eigen::Vector2d between = other.p1_px - line.p1_px;
  const double s = (between.x() * across.y() - between.y() * across.x()) / sine;
  const double on_other = (between.x() * along.y() - between.y() * along.x()) / sine;
  const double beyond_other = std::max({0.0, -on_other, on_other - other_length});
  return Crossing{line.p1_px + s * along, std::max(std::abs(s - (end == 0 ? 0.0 : length)), beyond_other),
                  std::clamp(kFlatSine / std::abs(sine), 1.0, kFlatReach)};
}

// Moves ends that lie near the crossing with another line, at both times, to the crossing. It is a corner, or the
// outline of a surface that hides the rest of the line.
void MoveEndsToCorners(std::vector<DetectedLine>& lines, double corner_px) {
  const std::vector<DetectedLine> found = lines;
  for (size_t i = 0; i < found.size(); ++i) {
    for (const int end : {0, 1}) {
      double nearest = corner_px;
      for (size_t j = 0; j < found.size(); ++j) {
        if (j == i) continue;
        const std::optional<Crossing> begin = FindCrossing(found[i].at_begin, end, found[j].at_begin);
        const std::optional<Crossing> now = FindCrossing(found[i].at_end, end, found[j].at_end);
        if (!begin || !now) continue;
        const double distance = std::max(begin->distance_px, now->distance_px) / now->reach;
        if (distance >= nearest) continue;
        nearest = distance;
        (end == 0 ? lines[i].at_begin.p1_px : lines[i].at_begin.p2_px) = begin->point;
        (end == 0 ? lines[i].at_end.p1_px : lines[i].at_end.p2_px) = now->point;
      }
    }
  }
}

}  // namespace

absl::Status LineSetOptions::Validate() const {
  absl::Status status = fit.Validate();
  status.Update(CheckRange("min_events", min_events, 8, 1e6));
  status.Update(CheckRange("min_length_px", min_length_px, 1.0, 1e4));
  status.Update(CheckRange("max_rms_px", max_rms_px, 0.1, 100.0));
  status.Update(CheckRange("min_events_per_px", min_events_per_px, 0.0, 1e3));
  status.Update(CheckRange("max_owned_ratio", max_owned_ratio, 0.0, 1.0));
  status.Update(CheckRange("merge_px", merge_px, 0.0, 100.0));
  status.Update(CheckRange("stripe_px", stripe_px, 0.0, 100.0));
  status.Update(CheckRange("corner_px", corner_px, 0.0, 100.0));
  return status;
}

std::vector<DetectedLine> SelectLines(const EventStretch& stretch, const std::vector<MovingLine>& candidates,
                                      const LineSetOptions& options) {
  LineSelection selection(stretch, options);
  for (const MovingLine& candidate : candidates) selection.Add(candidate);
  selection.AssignEvents();
  selection.MergePieces();
  std::vector<DetectedLine> lines = selection.MergeStripes();
  MoveEndsToCorners(lines, options.corner_px);
  std::erase_if(lines, [&options](const DetectedLine& line) {
    return std::min(line.at_begin.length_px(), line.at_end.length_px()) < kShortenedRatio * options.min_length_px;
  });
  std::stable_sort(lines.begin(), lines.end(),
                   [](const DetectedLine& a, const DetectedLine& b) { return a.num_events > b.num_events; });
  return lines;
}

}  // namespace evpose
