#include "core/detection/line_set.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "absl/strings/str_format.h"

namespace evpose {
namespace {

// Lines of one stretch, at most: an owner is a small number, and the work is bounded.
constexpr size_t kMaxLines = 300;
constexpr int16_t kNobody = -1;
// A candidate of which more than this share belongs to lines already is one of them seen again.
constexpr double kMaxTakenRatio = 0.5;
// Merging: sine of the angle, and the difference of speeds as a share of the stretch's motion.
constexpr double kParallelSine = 0.06;
constexpr double kSameMotionPx = 1.5;
// Corners are crossings of lines that differ in direction by more than this sine: others meet nowhere in particular.
constexpr double kCrossingSine = 0.2;

class LineSelection {
 public:
  LineSelection(const EventStretch& stretch, const LineSetOptions& options)
      : stretch_(stretch), options_(options), fitter_(stretch, options.fit), owner_(stretch.events.size(), kNobody) {}

  void Add(const MovingLine& candidate) {
    if (lines_.size() >= kMaxLines || IsTaken(candidate)) return;
    MovingLine line = candidate;
    if (!fitter_.Fit(line) || !IsGood(line) || IsTaken(line)) return;
    const auto own = static_cast<int16_t>(lines_.size());
    for (const int32_t index : fitter_.EventsOf(line)) {
      if (owner_[index] == kNobody) owner_[index] = own;
    }
    lines_.push_back(line);
  }

  // Each event to the line that it is nearest to; lines that others have emptied go.
  void Settle() {
    std::vector<float> distance(stretch_.events.size(), 1e9f);
    std::fill(owner_.begin(), owner_.end(), kNobody);
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

  void Merge() {
    for (size_t i = 0; i < lines_.size(); ++i) {
      for (size_t j = i + 1; j < lines_.size();) {
        std::optional<MovingLine> merged = Merged(lines_[i], lines_[j]);
        if (merged) {
          lines_[i] = *merged;
          lines_.erase(lines_.begin() + j);
          j = i + 1;
        } else {
          ++j;
        }
      }
    }
  }

  // Ends that lie near a crossing with another line are put there, at every time.
  void FindCorners() {
    const std::vector<MovingLine> found = lines_;
    for (size_t i = 0; i < found.size(); ++i) {
      for (const int end : {0, 1}) PutInCorner(found, i, end);
    }
  }

  std::vector<MovingLine> Take() {
    std::stable_sort(lines_.begin(), lines_.end(),
                     [](const MovingLine& a, const MovingLine& b) { return a.num_events > b.num_events; });
    return std::move(lines_);
  }

 private:
  bool IsGood(const MovingLine& line) const {
    return line.num_events >= options_.min_events && line.length_px() >= options_.min_length_px &&
           line.num_events >= options_.min_events_per_px * line.length_px();
  }

  bool IsTaken(const MovingLine& line) {
    const std::vector<int32_t>& events = fitter_.EventsOf(line);
    const auto taken =
        std::count_if(events.begin(), events.end(), [this](int32_t index) { return owner_[index] != kNobody; });
    return static_cast<double>(taken) > kMaxTakenRatio * static_cast<double>(events.size());
  }

  // One line for the two when they are pieces, or the two sides, of one edge.
  std::optional<MovingLine> Merged(const MovingLine& a, const MovingLine& b) {
    const double half_s = stretch_.half_duration_s();
    double low = a.ends[0].s_px, high = a.ends[1].s_px;
    double begin_b = 1e9, end_b = -1e9;
    for (const int end : {0, 1}) {
      for (const double tau : {-half_s, half_s}) {
        const Eigen::Vector2d point = b.EndAt(end, tau) - a.origin_px;
        const double s = a.direction.dot(point);
        const double y =
            a.normal().dot(point) - a.offset_px - a.slope * s - (a.speed_px_per_s + a.slope_rate_per_s * s) * tau;
        if (std::abs(y) > options_.merge_px) return std::nullopt;
        begin_b = std::min(begin_b, s);
        end_b = std::max(end_b, s);
      }
    }
    const double gap = std::max(begin_b - high, low - end_b);
    if (gap > options_.corner_px) return std::nullopt;
    MovingLine merged = a.num_events >= b.num_events ? a : b;
    const MovingLine& other = a.num_events >= b.num_events ? b : a;
    for (const int polarity : {0, 1}) merged.is_polarity[polarity] = a.is_polarity[polarity] || b.is_polarity[polarity];
    for (const int end : {0, 1}) {
      const double s = merged.direction.dot(other.EndAt(end, 0.0) - merged.origin_px);
      merged.ends[0].s_px = std::min(merged.ends[0].s_px, s);
      merged.ends[1].s_px = std::max(merged.ends[1].s_px, s);
    }
    if (!fitter_.Fit(merged) || !IsGood(merged)) return std::nullopt;
    return merged;
  }

  void PutInCorner(const std::vector<MovingLine>& found, size_t i, int end) {
    const double half_s = stretch_.half_duration_s();
    const Eigen::Vector2d point = found[i].EndAt(end, 0.0);
    double nearest = options_.corner_px;
    for (size_t j = 0; j < found.size(); ++j) {
      if (j == i) continue;
      const std::optional<double> s[3] = {Crossing(found[i], found[j], -half_s), Crossing(found[i], found[j], 0.0),
                                          Crossing(found[i], found[j], half_s)};
      if (!s[0] || !s[1] || !s[2]) continue;
      const Eigen::Vector2d crossing = found[i].PointAt(*s[1], 0.0);
      const double on_other = found[j].direction.dot(crossing - found[j].origin_px);
      if (!found[j].IsAlong(on_other, 0.0, options_.corner_px)) continue;
      const double distance = (crossing - point).norm();
      if (distance >= nearest) continue;
      nearest = distance;
      lines_[i].ends[end] = {*s[1], (*s[2] - *s[0]) / std::max(2.0 * half_s, 1e-6)};
    }
  }

  // Where, along `line`, `other` crosses it.
  static std::optional<double> Crossing(const MovingLine& line, const MovingLine& other, double tau_s) {
    const Eigen::Vector2d p = line.PointAt(0.0, tau_s), q = other.PointAt(0.0, tau_s);
    const Eigen::Vector2d along = line.PointAt(1.0, tau_s) - p, across = other.PointAt(1.0, tau_s) - q;
    const double sine = along.x() * across.y() - along.y() * across.x();
    if (std::abs(sine) < kCrossingSine) return std::nullopt;
    const Eigen::Vector2d between = q - p;
    return (between.x() * across.y() - between.y() * across.x()) / sine;
  }

  const EventStretch& stretch_;
  const LineSetOptions& options_;
  LineFitter fitter_;
  std::vector<int16_t> owner_;
  std::vector<MovingLine> lines_;
};

}  // namespace

absl::Status LineSetOptions::Validate() const {
  const auto check = [](const char* name, double value, double low, double high) {
    if (value >= low && value <= high) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrFormat("%s is %g; it must lie in [%g, %g]", name, value, low, high));
  };
  absl::Status status = fit.Validate();
  status.Update(check("min_events", min_events, 8, 1e6));
  status.Update(check("min_length_px", min_length_px, 1.0, 1e4));
  status.Update(check("min_events_per_px", min_events_per_px, 0.0, 1e3));
  status.Update(check("merge_px", merge_px, 0.0, 100.0));
  status.Update(check("corner_px", corner_px, 0.0, 100.0));
  return status;
}

std::vector<MovingLine> SelectLines(const EventStretch& stretch, const std::vector<MovingLine>& candidates,
                                    const LineSetOptions& options) {
  LineSelection selection(stretch, options);
  for (const MovingLine& candidate : candidates) selection.Add(candidate);
  selection.Settle();
  selection.Merge();
  selection.FindCorners();
  return selection.Take();
}

}  // namespace evpose
