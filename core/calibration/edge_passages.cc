// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/edge_passages.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/association/association.h"
#include "core/association/visible_edges.h"
#include "core/base/status_macros.h"
#include "core/calibration/event_displacement.h"
#include "core/windows/pixel_history.h"

namespace evpose {
namespace {

constexpr int64_t kSlotUs = 1000;      // interval over which the motion is assumed to be uniform
constexpr int64_t kMaxGapUs = 20'000;  // longest gap of the truth that is interpolated; a window lasts as long at most
constexpr double kGatesAlone = 3.0;    // distance of the nearest other line, in gates
constexpr double kGridMarginPx = 2.0;  // by which lines may move within an interval

// State of the current passage of a model line.
struct OpenPassage {
  double direction = 0.0;
  double gate_px = 0.0;  // 0 before the passage has begun
  double swept_px = 0.0;
  double swept_px2 = 0.0;
  double speed_px2 = 0.0;  // sum of speed times swept area
  EdgeCounts counts;
  std::vector<double> residuals_px;
};

class Collector : public EdgePassageCollector {
 public:
  Collector(std::shared_ptr<const ObjectModel> model, const CameraModel& camera, UndistortionTable undistortion,
            Trajectory truth)
      : model_(std::move(model)),
        camera_(camera),
        undistortion_(std::move(undistortion)),
        truth_(std::move(truth)),
        edges_(*model_, {.grazing_cosine = 0.0}, {}),
        visible_edges_(camera_, edges_),
        history_({camera.width_px, camera.height_px}),
        grid_(camera_),
        open_(std::min<size_t>(model_->lines.size(), ModelEdges::kMaxCurves)),
        slot_begin_us_(truth_.front().t_us) {}

  void AddEvents(absl::Span<const Event> events) override {
    for (const Event& event : events) {
      const WindowEvent known = history_.Next(event);
      if (event.t_us < slot_begin_us_ || event.x >= camera_.width_px || event.y >= camera_.height_px) continue;
      if (event.t_us >= slot_begin_us_ + kSlotUs) {
        CloseSlot();
        slot_begin_us_ += (event.t_us - slot_begin_us_) / kSlotUs * kSlotUs;
      }
      slot_.push_back(known);
    }
  }
  std::vector<EdgePassage> Finish() override {
    CloseSlot();
    for (size_t k = 0; k < open_.size(); ++k) ClosePassage(static_cast<int>(k));
    return std::move(passages_);
  }
  uint64_t num_events_with_truth() const override { return num_events_with_truth_; }

 private:
  std::optional<MotionState> TruthOfSlot() const;
  void CloseSlot();
  void AddEvent(const WindowEvent& event, int64_t t_mid_us, absl::Span<const TrackedLine> tracked);
  void AddSweeps(absl::Span<const TrackedLine> tracked);
  double GateOf(size_t line) const;
  bool IsAlone(const Eigen::Vector2d& foot_px, const ImageLine& other, double clear_px) const;
  void ClosePassage(int model_line);

  // Distance within which other lines matter.
  double ReachPx() const { return kGatesAlone * options_.gate_px; }

  const EdgePassageOptions options_ = {};
  const std::shared_ptr<const ObjectModel> model_;
  const CameraModel camera_;
  const UndistortionTable undistortion_;
  const Trajectory truth_;
  const ModelEdges edges_;
  const ExpTable table_;
  VisibleEdges visible_edges_;
  PixelHistory history_;
  TileGrid grid_;
  std::vector<OpenPassage> open_;  // indexed by model line
  int64_t slot_begin_us_;
  std::vector<WindowEvent> slot_;
  std::vector<ImageLine> lines_;
  std::vector<double> direction_;  // of each image line; 0 if the line is not used in this interval
  std::vector<EdgePassage> passages_;
  uint64_t num_events_with_truth_ = 0;
};

std::optional<MotionState> Collector::TruthOfSlot() const {
  const int64_t begin_us = slot_begin_us_, end_us = slot_begin_us_ + kSlotUs;
  const auto after = std::lower_bound(truth_.begin(), truth_.end(), end_us,
                                      [](const StampedPose& pose, int64_t t_us) { return pose.t_us < t_us; });
  if (after == truth_.begin() || after == truth_.end() || after->t_us - (after - 1)->t_us > kMaxGapUs) {
    return std::nullopt;
  }
  const auto begin = Interpolate(truth_, begin_us), middle = Interpolate(truth_, begin_us + kSlotUs / 2),
             end = Interpolate(truth_, end_us);
  if (!begin.ok() || !middle.ok() || !end.ok()) return std::nullopt;
  MotionState state;
  state.t_us = begin_us + kSlotUs / 2;
  state.camera_from_object = *middle;
  state.twist = Difference(*end, *begin) / (kSlotUs * 1e-6);
  return state;
}

void Collector::CloseSlot() {
  const std::optional<MotionState> truth = slot_.empty() ? std::nullopt : TruthOfSlot();
  if (truth) {
    num_events_with_truth_ += slot_.size();
    const absl::Span<const TrackedLine> tracked = visible_edges_.At(truth->camera_from_object);
    ProjectLines(camera_, *truth, tracked, lines_);
    grid_.Build(lines_, ReachPx() + kGridMarginPx);
    AddSweeps(tracked);
    for (const WindowEvent& event : slot_) AddEvent(event, truth->t_us, tracked);
    for (size_t k = 0; k < open_.size(); ++k) {
      if (open_[k].swept_px < options_.swept_px || open_[k].swept_px2 < options_.swept_px2) continue;
      ClosePassage(static_cast<int>(k));
    }
  }
  slot_.clear();
}

void Collector::AddSweeps(absl::Span<const TrackedLine> tracked) {
  direction_.assign(lines_.size(), 0.0);
  for (size_t k = 0; k < lines_.size(); ++k) {
    const ImageLine& line = lines_[k];
    // Elements of curves are too short for a passage; they only determine which events do not belong to a straight
    // line. The straight lines have the first numbers; those of a model with many are elements, too.
    const bool is_straight =
        tracked[k].curve < static_cast<int>(open_.size()) && (edges_.has_many_lines() || !line.is_element);
    if (!is_straight || line.length_px < options_.min_length_px) continue;
    const double first = NormalSpeedPxPerS(camera_, line, 0.0), last = NormalSpeedPxPerS(camera_, line, 1.0);
    if (first * last < 0.0 || std::min(std::abs(first), std::abs(last)) < options_.min_speed_px_per_s) continue;
    direction_[k] = first > 0.0 ? 1.0 : -1.0;
    OpenPassage& open = open_[tracked[k].curve];
    if (open.direction != direction_[k]) ClosePassage(tracked[k].curve);
    open.direction = direction_[k];
    if (open.gate_px == 0.0) open.gate_px = GateOf(k);
    const double speed = 0.5 * std::abs(first + last);
    const double swept_px2 = line.length_px * speed * kSlotUs * 1e-6;
    open.swept_px += speed * kSlotUs * 1e-6;
    open.swept_px2 += swept_px2;
    open.speed_px2 += speed * swept_px2;
  }
}

void Collector::AddEvent(const WindowEvent& event, int64_t t_mid_us, absl::Span<const TrackedLine> tracked) {
  std::optional<Observation> observed = Observe(camera_, undistortion_, event, t_mid_us);
  if (!observed) return;
  Observation& seen = *observed;
  if (!grid_.GiveLines(seen)) return;
  const NearLines near = FindNearLines(seen, lines_.data(), ReachPx(), ReachPx());
  if (near.count == 0 || direction_[near.line[0]] == 0.0) return;
  const ImageLine& line = lines_[near.line[0]];
  OpenPassage& open = open_[tracked[near.line[0]].curve];
  const double along = line.AlongPx(seen.u_px, seen.v_px);
  const double distance = near.distance_px[0];
  if (std::abs(distance) < options_.own_px && along >= 0.0 && along <= line.length_px)
    open.counts.Add(seen, along < 0.5 * line.length_px ? 0 : 1, 1.0);
  const double end_px = options_.end_gates * open.gate_px;
  if (std::abs(distance) >= open.gate_px || along <= end_px || along >= line.length_px - end_px) return;
  // Decided at the foot point on the line, so that the choice does not depend on the distance, which is measured.
  const bool is_alone = near.count == 1 ||
                        IsAlone(line.PointAt(along / line.length_px), lines_[near.line[1]], kGatesAlone * open.gate_px);
  if (is_alone) open.residuals_px.push_back(distance * direction_[near.line[0]]);
}

// Whether a point is farther than clear_px from a line.
bool Collector::IsAlone(const Eigen::Vector2d& foot_px, const ImageLine& other, double clear_px) const {
  if (!other.in_view()) return true;
  const double along = std::clamp(other.AlongPx(foot_px.x(), foot_px.y()), 0.0, other.length_px);
  return (foot_px - other.PointAt(along / other.length_px)).squaredNorm() > clear_px * clear_px;
}

// The largest gate at which half of the line is alone; the smallest one if there is none.
double Collector::GateOf(size_t line) const {
  // Places along the line at which its distance from the other lines is measured: a line that crosses it is near to one
  // of them.
  constexpr int kParts = 8;
  for (double gate_px = options_.gate_px; kGatesAlone * gate_px > kAlonePx; gate_px -= 0.5) {
    int alone = 0;
    for (int part = 0; part < kParts; ++part) {
      const Eigen::Vector2d point = lines_[line].PointAt((part + 0.5) / kParts);
      bool is_alone = true;
      for (size_t k = 0; k < lines_.size() && is_alone; ++k) {
        is_alone = k == line || IsAlone(point, lines_[k], kGatesAlone * gate_px);
      }
      alone += is_alone;
    }
    if (2 * alone >= kParts) return gate_px;
  }
  return kAlonePx / kGatesAlone;
}

void Collector::ClosePassage(int model_line) {
  OpenPassage& open = open_[model_line];
  if (open.swept_px2 >= options_.swept_px2 && open.residuals_px.size() >= static_cast<size_t>(options_.min_events)) {
    const EventDisplacement fit = FitDisplacement(open.residuals_px, open.gate_px, 0.0, table_);
    const double events = open.counts.polarity[0] + open.counts.polarity[1];
    EdgePassage passage;
    passage.model_line = model_line;
    passage.direction = open.direction;
    passage.speed_px_per_s = open.speed_px2 / open.swept_px2;
    passage.rates.events_per_px2 = events / open.swept_px2;
    passage.rates.reversals_per_px2 = passage.rates.recent_reversals_per_px2 =
        (open.counts.reversals[0] + open.counts.reversals[1]) / open.swept_px2;
    passage.rates.kappa = open.direction * (open.counts.polarity[1] - open.counts.polarity[0]) / events;
    passage.residual_px = fit.mean_px;
    passage.spread_px = fit.spread_px;
    passage.num_events = fit.num_events;
    if (fit.num_events >= options_.min_events / 2.0) passages_.push_back(passage);
  }
  open = OpenPassage();
}

}  // namespace

absl::StatusOr<std::unique_ptr<EdgePassageCollector>> EdgePassageCollector::Create(
    std::shared_ptr<const ObjectModel> model, const CameraModel& camera, Trajectory truth) {
  if (model == nullptr || model->lines.empty()) {
    return absl::InvalidArgumentError("the model has no lines; a calibration needs the edges of the object");
  }
  if (truth.empty()) {
    return absl::InvalidArgumentError("the truth has no poses; a calibration needs the poses of the object");
  }
  EVPOSE_RETURN_IF_ERROR(camera.Validate());
  EVPOSE_ASSIGN_OR_RETURN(UndistortionTable undistortion, UndistortionTable::Create(camera));
  return std::make_unique<Collector>(std::move(model), camera, std::move(undistortion), std::move(truth));
}

}  // namespace evpose
