// SPDX-License-Identifier: Apache-2.0
#include "core/detection/moving_line.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/base/yield_point.h"
#include "core/events/correlated_events.h"
#include "core/numerics/robust.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

// Passes of reweighted least squares, while the extent grows and in the final fit. The start is within a pixel.
constexpr int kGrowthPasses = 3;
constexpr int kFinalPasses = 4;
// Distance beyond the ends, pixels, within which events are added in one step of growth, and number of steps: a line of
// up to 600 px.
constexpr double kGrowthPx = 24.0;
constexpr int kMaxGrowths = 12;
// Growth ends when a step lengthens the line by less than half of kGrowthPx and by less than this share of its length:
// both ends are then within the searched region, and most of the line has been fitted.
constexpr double kSmallGrowthRatio = 0.2;
// The outermost kEndPx pixels of an edge have at least this share of its mean density of events; fewer events are noise
// beyond its end. The required number is limited, because the contrast may decrease along an edge.
constexpr double kEndPx = 6.0;
constexpr double kEndDensityRatio = 0.35;
constexpr size_t kMaxEndEvents = 5;
constexpr std::ptrdiff_t kMinCoreEvents = 8;  // events within the old extent; fewer give no density
// Numbers of events used in a fit, while the extent grows and in the final fit. More do not improve it, because the
// remaining error is systematic.
constexpr size_t kGrowthEvents = 250;
constexpr size_t kFinalEvents = 800;
// An edge without events is at rest: outside the time range of its events an end moves by at most this distance.
constexpr double kRestMotionPx = 0.6;
// The gate of a fit and of its scale, as multiples of gate_px: wider, because the line is not yet accurate.
constexpr double kFitGate = 2.0;
constexpr double kScaleGate = 1.5;
constexpr double kEndMarginPx = 2.0;  // events beyond an end that still belong to the line
// Limit of the speed of an end along the line, as a multiple of the time scale of the stretch. An end that seems to be
// faster follows single events of noise.
constexpr double kMaxEndSpeedRatio = 1.5;
// Time, seconds, for which the priors of rotation and acceleration grow: a longer stretch is that of a slow object, and
// within it the changes of its motion are of the order of the motion, as they are within 50 ms.
constexpr double kMaxPriorS = 0.025;
constexpr size_t kEventsPerOutlier = 50;  // one of so many events at an end may be noise outside its time range

// Split(): the shortest line that is split, pixels, so that each piece is long enough to be a line; the number of parts
// along the line; and the share of the squared scatter that may remain about two straight lines. With a larger share
// lines with noisy parts would be split, which two straight lines do not describe better.
constexpr double kMinSplitPx = 32.0;
constexpr int kBins = 8;
constexpr double kSplitRemainder = 0.3;

using Matrix5d = Eigen::Matrix<double, 5, 5>;
using Vector5d = Eigen::Matrix<double, 5, 1>;

// The normal equations of y = x . (1, s, tau, s tau, tau^2). Their entries are weighted sums of s^i tau^j, most of
// which occur several times.
class LineMoments {
 public:
  void Add(double weight, double s, double tau, double y) {
    const double ws = weight * s, wt = weight * tau, wst = ws * tau, wtt = wt * tau;
    n_ += weight;
    s_ += ws;
    t_ += wt;
    st_ += wst;
    tt_ += wtt;
    ss_ += ws * s;
    sst_ += wst * s;
    stt_ += wst * tau;
    ttt_ += wtt * tau;
    sstt_ += wst * s * tau;
    sttt_ += wst * tau * tau;
    tttt_ += wtt * tau * tau;
    y_ += weight * y;
    sy_ += ws * y;
    ty_ += wt * y;
    sty_ += wst * y;
    tty_ += wtt * y;
  }

  // Solves them with a prior on the last two unknowns: inverse variances about zero.
  Vector5d Solve(double turn_information, double bend_information) const {
    Matrix5d information;
    information << n_, s_, t_, st_, tt_,  //
        s_, ss_, st_, sst_, stt_,         //
        t_, st_, tt_, stt_, ttt_,         //
        st_, sst_, stt_, sstt_, sttt_,    //
        tt_, stt_, ttt_, sttt_, tttt_;
    information.diagonal().array() += 1e-9;  // keeps the matrix regular if all events have the same s or tau
    information(3, 3) += turn_information;
    information(4, 4) += bend_information;
    return information.ldlt().solve((Vector5d() << y_, sy_, ty_, sty_, tty_).finished());
  }

 private:
  double n_ = 0.0, s_ = 0.0, t_ = 0.0, st_ = 0.0, tt_ = 0.0, ss_ = 0.0, sst_ = 0.0, stt_ = 0.0, ttt_ = 0.0;
  double sstt_ = 0.0, sttt_ = 0.0, tttt_ = 0.0;
  double y_ = 0.0, sy_ = 0.0, ty_ = 0.0, sty_ = 0.0, tty_ = 0.0;
};

struct Bin {
  double count = 0.0;
  double mean = 0.0;
};

// Returns the weighted sum of squared deviations of the means of the bins in [begin, end) from their best straight
// line.
double StraightSquares(const std::array<Bin, kBins>& bins, int begin, int end) {
  double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0, yy = 0.0;
  for (int k = begin; k < end; ++k) {
    const Bin& bin = bins[k];
    n += bin.count;
    x += bin.count * k;
    y += bin.count * bin.mean;
    xx += bin.count * k * k;
    xy += bin.count * k * bin.mean;
    yy += bin.count * bin.mean * bin.mean;
  }
  if (n <= 0.0) return 0.0;
  const double sxx = xx - x * x / n, sxy = xy - x * y / n, syy = yy - y * y / n;
  return std::max(0.0, sxx > 1e-9 ? syy - sxy * sxy / sxx : syy);
}

}  // namespace

absl::Status MovingLineOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("gate_px", gate_px, 0.5, 50.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("turn_rad_per_s", turn_rad_per_s, 0.0, 1000.0, OpenEnds::kLow));
  EVPOSE_RETURN_IF_ERROR(CheckRange("acceleration_px_per_s2", acceleration_px_per_s2, 0.0, 1e9, OpenEnds::kLow));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_sigma_px", min_sigma_px, 0.01, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_sigma_px", max_sigma_px, min_sigma_px, 50.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("gap_spacings", gap_spacings, 1.0, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("min_gap_px", min_gap_px, 0.1, 1000.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("max_gap_px", max_gap_px, min_gap_px, 1000.0));
  return CheckRange("bent_px", bent_px, 0.01, 100.0);
}

void MovingLine::Recentre() {
  const double middle = 0.5 * (ends[0].s_px + ends[1].s_px);
  const Eigen::Vector2d new_origin = PointAt(middle, 0.0);
  speed_px_per_s += slope_rate_per_s * middle;
  const double stretch = std::sqrt(1.0 + slope * slope);  // length along the slanted line per unit of s
  const Eigen::Vector2d new_direction = (direction + slope * normal()) / stretch;
  for (End& end : ends) {
    end.s_px = (end.s_px - middle) * stretch;
    end.speed_px_per_s *= stretch;
  }
  // Distances across the rotated line are shorter by the factor 1 / stretch.
  speed_px_per_s /= stretch;
  acceleration_px_per_s2 /= stretch;
  slope_rate_per_s /= stretch * stretch;
  origin_px = new_origin;
  direction = new_direction;
  offset_px = slope = 0.0;
}

Eigen::Vector2d MovingLine::EndAt(int end, double tau_s) const {
  const End& at = ends[end];
  const double slack_s = kRestMotionPx / std::max(std::abs(speed_px_per_s + slope_rate_per_s * at.s_px), 1e-3);
  const double tau = std::clamp(tau_s, std::min(at.first_tau_s - slack_s, 0.0), std::max(at.last_tau_s + slack_s, 0.0));
  return PointAt(at.s_px + at.speed_px_per_s * tau, tau);
}

DetectedLine ToDetectedLine(const MovingLine& line, double half_duration_s) {
  DetectedLine detected;
  detected.at_begin = {line.EndAt(0, -half_duration_s), line.EndAt(1, -half_duration_s)};
  detected.at_end = {line.EndAt(0, half_duration_s), line.EndAt(1, half_duration_s)};
  detected.normal_velocity_px_per_s =
      line.speed_px_per_s + 0.5 * line.slope_rate_per_s * (line.ends[0].s_px + line.ends[1].s_px);
  detected.num_events = line.num_events;
  detected.rms_px = line.rms_px;
  return detected;
}

LineFitter::LineFitter(const EventStretch& stretch, const MovingLineOptions& options)
    : stretch_(stretch),
      options_(options),
      grids_{EventGrid(stretch.events, {false, false}), EventGrid(stretch.events, {true, false}),
             EventGrid(stretch.events, {false, true}), EventGrid(stretch.events, {true, true})} {}

void LineFitter::Collect(const MovingLine& line, double margin_px, double reach_px) {
  const double half_s = stretch_.half_duration_s();
  const double begin = line.ends[0].s_px - margin_px, end = line.ends[1].s_px + margin_px;
  const double sweep = half_s * (std::abs(line.speed_px_per_s) + 0.5 * std::abs(line.acceleration_px_per_s2) * half_s +
                                 std::abs(line.slope_rate_per_s) * std::max(std::abs(begin), std::abs(end)));
  YieldPoint();
  indices_.clear();
  const EventGrid& grid = grids_[(line.is_polarity[0] ? 1 : 0) + (line.is_polarity[1] ? 2 : 0)];
  grid.Near(line.PointAt(begin, 0.0), line.PointAt(end, 0.0), reach_px + sweep, indices_);
  samples_.clear();
  size_t kept = 0;
  for (const int32_t index : indices_) {
    const StretchEvent& event = stretch_.events[index];
    if (owner_ != nullptr && (*owner_)[index] != own_) continue;
    const double s = line.S(event);
    if (!line.IsAlong(s, event.tau_s, margin_px)) continue;
    const double residual = line.Residual(event, s);
    if (std::abs(residual) > reach_px) continue;
    const double y = residual + line.Y(s, event.tau_s);
    samples_.push_back({static_cast<float>(s), static_cast<float>(y), event.tau_s, static_cast<float>(residual)});
    indices_[kept++] = index;
  }
  indices_.resize(kept);
}

void LineFitter::SolveRobustly(MovingLine& line, int passes, size_t max_events) {
  const double half_s = std::max(stretch_.half_duration_s(), 1e-6);
  const double prior_s = std::min(half_s, kMaxPriorS);
  const double middle = 0.5 * (line.ends[0].s_px + line.ends[1].s_px);
  const double scale = std::max(0.5 * line.length_px(), 1.0);
  const size_t stride = 1 + samples_.size() / max_events;
  double sigma = options_.max_sigma_px;
  for (int pass = 0; pass < passes; ++pass) {
    LineMoments moments;
    for (size_t i = 0; i < samples_.size(); i += stride) {
      const Sample& sample = samples_[i];
      const double u = sample.residual / (kTukeyEfficient * sigma);
      if (std::abs(u) >= 1.0) continue;
      const double weight = (1.0 - u * u) * (1.0 - u * u);
      moments.Add(weight, (sample.s - middle) / scale, sample.tau_s / half_s, sample.y);
    }
    const double turn = options_.turn_rad_per_s * prior_s * scale / sigma;
    const double bend = 0.5 * options_.acceleration_px_per_s2 * prior_s * prior_s / sigma;
    const Vector5d x = moments.Solve(kCorrelatedEvents / (turn * turn), kCorrelatedEvents / (bend * bend));
    line.slope = x[1] / scale;
    line.offset_px = x[0] - line.slope * middle;
    line.slope_rate_per_s = x[3] / (scale * half_s);
    line.speed_px_per_s = x[2] / half_s - line.slope_rate_per_s * middle;
    line.acceleration_px_per_s2 = 2.0 * x[4] / (half_s * half_s);
    along_.clear();
    for (size_t i = 0; i < samples_.size(); i += stride) {
      Sample& sample = samples_[i];
      sample.residual = static_cast<float>(sample.y - line.Y(sample.s, sample.tau_s));
      if (std::abs(sample.residual) < kScaleGate * options_.gate_px) along_.push_back(std::abs(sample.residual));
    }
    if (along_.empty()) return;
    sigma = std::clamp(UpperMedian(along_) / kNormalMad, options_.min_sigma_px, options_.max_sigma_px);
  }
}

bool LineFitter::FindExtent(MovingLine& line) {
  along_.clear();
  for (const Sample& sample : samples_) {
    if (std::abs(sample.residual) <= options_.gate_px) along_.push_back(sample.s);
  }
  std::sort(along_.begin(), along_.end());
  const auto core_begin = std::lower_bound(along_.begin(), along_.end(), line.ends[0].s_px);
  const auto core_end = std::upper_bound(core_begin, along_.end(), line.ends[1].s_px);
  if (core_end - core_begin < kMinCoreEvents) return false;
  const double density = static_cast<double>(core_end - core_begin) / std::max(line.length_px(), 1.0);
  const double max_gap = std::clamp(options_.gap_spacings / density, options_.min_gap_px, options_.max_gap_px);
  // The range without gaps that has most of the events of the old extent.
  size_t best_begin = 0, best_end = 0, best_in_core = 0;
  const size_t core_first = core_begin - along_.begin(), core_last = core_end - along_.begin();
  for (size_t begin = 0; begin < along_.size();) {
    size_t end = begin + 1;
    while (end < along_.size() && along_[end] - along_[end - 1] <= max_gap) ++end;
    const size_t first = std::max(begin, core_first), last = std::min(end, core_last);
    const size_t in_core = last > first ? last - first : 0;
    if (in_core > best_in_core) {
      best_in_core = in_core;
      best_begin = begin;
      best_end = end;
    }
    begin = end;
  }
  const auto enough =
      std::clamp(static_cast<size_t>(std::ceil(kEndDensityRatio * density * kEndPx)), size_t{2}, kMaxEndEvents);
  while (best_end - best_begin > enough && along_[best_begin + enough - 1] - along_[best_begin] > kEndPx) ++best_begin;
  while (best_end - best_begin > enough && along_[best_end - 1] - along_[best_end - enough] > kEndPx) --best_end;
  if (best_end - best_begin <= enough) return false;
  const double found[2] = {along_[best_begin], along_[best_end - 1]};
  if (line.ends[0].may_grow || found[0] > line.ends[0].s_px) line.ends[0].s_px = found[0];
  if (line.ends[1].may_grow || found[1] < line.ends[1].s_px) line.ends[1].s_px = found[1];
  return line.length_px() > 0.0;
}

void LineFitter::FindEndSpeeds(MovingLine& line) {
  // The position of each end in the first and in the second half of the stretch: that of the k-th event from outside,
  // moved outwards by k spacings.
  const double half_s = stretch_.half_duration_s();
  double end_of_half[2][2] = {};
  for (const int half : {0, 1}) {
    along_.clear();
    for (const Sample& sample : samples_) {
      if ((sample.tau_s >= 0.0f) == (half == 1) && std::abs(sample.residual) <= options_.gate_px &&
          line.IsAlong(sample.s, 0.0, 0.0)) {
        along_.push_back(sample.s);
      }
    }
    constexpr size_t k = 4;  // ignores up to three outliers at each end
    const size_t n = along_.size();
    if (n < 8 * k) return;
    std::sort(along_.begin(), along_.end());
    // The spacing is that of the events just inside the end: a rotating edge produces fewer events towards its slow
    // end.
    const double low_spacing = (along_[3 * k] - along_[k]) / (2.0 * k);
    const double high_spacing = (along_[n - 1 - k] - along_[n - 1 - 3 * k]) / (2.0 * k);
    end_of_half[half][0] = std::max(along_[k] - k * low_spacing, line.ends[0].s_px);
    end_of_half[half][1] = std::min(along_[n - 1 - k] + k * high_spacing, line.ends[1].s_px);
  }
  const double fastest = kMaxEndSpeedRatio * stretch_.time_scale_px_per_s;
  for (const int end : {0, 1}) {
    line.ends[end].speed_px_per_s = std::clamp((end_of_half[1][end] - end_of_half[0][end]) / half_s, -fastest, fastest);
    line.ends[end].s_px = 0.5 * (end_of_half[0][end] + end_of_half[1][end]);
  }
}

void LineFitter::FindEndTimes(MovingLine& line) {
  const double third = std::max(line.length_px() / 3.0, 10.0);  // pixels, enough for several events
  for (MovingLine::End& end : line.ends) {
    along_.clear();
    for (const Sample& sample : samples_) {
      if (std::abs(sample.s - end.s_px) <= third) along_.push_back(sample.tau_s);
    }
    if (along_.size() < 4) continue;
    const size_t k = along_.size() / kEventsPerOutlier;
    end.first_tau_s = SelectNth(along_, k);
    end.last_tau_s = SelectNth(along_, along_.size() - 1 - k);
  }
}

bool LineFitter::Fit(MovingLine& line) {
  for (int growth = 0; growth < kMaxGrowths; ++growth) {
    for (MovingLine::End& end : line.ends) end.speed_px_per_s = 0.0;
    const double length = line.length_px();
    Collect(line, 0.0, kFitGate * options_.gate_px);
    SolveRobustly(line, kGrowthPasses, kGrowthEvents);
    Collect(line, kGrowthPx, options_.gate_px);
    if (!FindExtent(line)) return false;
    line.Recentre();
    if (line.length_px() < length + std::min(0.5 * kGrowthPx, kSmallGrowthRatio * length)) break;
  }
  Collect(line, 0.0, kFitGate * options_.gate_px);
  SolveRobustly(line, kFinalPasses, kFinalEvents);
  line.Recentre();
  Collect(line, kEndMarginPx, options_.gate_px);
  if (samples_.empty()) return false;
  FindEndSpeeds(line);
  FindEndTimes(line);
  double sum = 0.0;
  for (const Sample& sample : samples_) sum += static_cast<double>(sample.residual) * sample.residual;
  line.num_events = static_cast<int>(samples_.size());
  line.rms_px = std::sqrt(sum / static_cast<double>(samples_.size()));
  return true;
}

bool LineFitter::FitOwned(MovingLine& line, const std::vector<int16_t>& owner, int16_t own) {
  owner_ = &owner;
  own_ = own;
  const bool fitted = Fit(line);
  owner_ = nullptr;
  return fitted;
}

std::optional<std::array<MovingLine, 2>> LineFitter::Split(const MovingLine& line) {
  if (line.length_px() < kMinSplitPx) return std::nullopt;
  Collect(line, 0.0, options_.gate_px);
  std::array<Bin, kBins> bins;
  for (const Sample& sample : samples_) {
    const double share = (sample.s - line.ends[0].s_px) / line.length_px();
    Bin& bin = bins[static_cast<size_t>(std::clamp(share * kBins, 0.0, kBins - 1.0))];
    bin.count += 1.0;
    bin.mean += sample.residual;
  }
  for (Bin& bin : bins) bin.mean /= std::max(bin.count, 1.0);
  const double whole = StraightSquares(bins, 0, kBins);
  double best = whole;
  int cut = 0;
  for (int k = 2; k <= kBins - 2; ++k) {
    const double pieces = StraightSquares(bins, 0, k) + StraightSquares(bins, k, kBins);
    if (pieces >= best) continue;
    best = pieces;
    cut = k;
  }
  const double count = static_cast<double>(samples_.size());
  if (cut == 0 || whole < options_.bent_px * options_.bent_px * count || best > kSplitRemainder * whole) {
    return std::nullopt;
  }
  std::array<MovingLine, 2> pieces = {line, line};
  const double s = line.ends[0].s_px + line.length_px() * cut / kBins;
  for (const int piece : {0, 1}) {
    MovingLine::End& end = pieces[piece].ends[1 - piece];
    end = {};
    end.s_px = s;
    end.may_grow = false;
  }
  return pieces;
}

const std::vector<int32_t>& LineFitter::EventsOf(const MovingLine& line) {
  Collect(line, kEndMarginPx, options_.gate_px);
  return indices_;
}

}  // namespace evpose
