// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/mixture_pass.h"

#include <algorithm>
#include <limits>

#include "core/base/paced_yields.h"
#include "core/numerics/reusable_vector.h"
#include "core/numerics/target_clones.h"

namespace evpose {
namespace {

// Smaller weights count as zero: they do not affect the sums and only cost numerical range.
constexpr float kLeastWeight = 1e-4f;

// Numbers of vectors of events and of places of shared events between two yield points, each about 0.1 ms of work.
// The factors that are computed once for a group take as long as kLanesOfGroup vectors.
constexpr size_t kLanesBetweenYields = 4096, kPlacesBetweenYields = 4096, kLanesOfGroup = 8;

}  // namespace

// The member functions of the two classes below are always inlined: a call from a clone of Accumulate() would use the
// instructions of the oldest processor, and would leave and fetch the sums in memory for every vector of events.

// Likelihoods of one line; the factors that all events of one polarity share are computed once.
class MixturePass::GroupTerms {
 public:
  [[gnu::always_inline]] GroupTerms(const LineGroup& group, const ImageLine& line, const MixtureDensity& density,
                                    const LineDensities& densities)
      : line_(group, line),
        gate_px_(AllLanes(density.gate_px)),
        half_inverse_variance_(AllLanes(0.5 / (density.sigma_px * density.sigma_px))),
        peak_(AllLanes(densities.own[group.polarity] * density.Peak())),
        beside_{AllLanes(densities.beside[0][group.polarity]), AllLanes(densities.beside[1][group.polarity])} {}

  [[gnu::always_inline]] Terms Of(const EventLanes& event) const {
    Terms terms;
    terms.distance_px = line_.DistancePx(event);
    terms.along_px = line_.AlongPx(event);
    // Events beyond the end of a line are not attributed to it: the blur rounds off the corners, and their events would
    // displace the line inwards.
    terms.is_gated = line_.IsGated(event, terms.distance_px, terms.along_px, gate_px_);
    terms.likelihood = peak_ * NegativeExp(terms.distance_px * terms.distance_px * half_inverse_variance_);
    terms.outlier = Select(terms.distance_px > 0.0f, beside_[1], beside_[0]);
    return terms;
  }
  [[gnu::always_inline]] LaneMask IsSecondHalf(const Terms& terms) const {
    return terms.along_px + terms.along_px >= line_.length_px();
  }
  [[gnu::always_inline]] LaneMask IsBeside(const Terms& terms) const {
    return Abs(terms.distance_px) > static_cast<float>(LineCounts::kLateralRatio) * gate_px_;
  }

 private:
  const GroupLine line_;
  const Lanes gate_px_;
  const Lanes half_inverse_variance_;
  const Lanes peak_;
  const std::array<Lanes, 2> beside_;
};

// Sums over the events of one group.
struct MixturePass::GroupSums {
  LineSums::LaneProducts products = {};
  Lanes num_gated = {};
  std::array<Lanes, 2> beside = {};       // clutter, by side
  std::array<Lanes, 2> half_weight = {};  // weight of the whole line, and of its second half
  std::array<Lanes, 2> reversals = {};    // likewise
  Lanes ambiguous_px2 = {};
  Lanes squares_px2 = {};

  // Adds one vector of events. Clutter is counted where `is_nearest` is true, so that each event counts once.
  [[gnu::always_inline]] void Add(const EventLanes& event, const GroupTerms& group, const Terms& terms, Lanes inverse,
                                  Lanes inlier_ratio, LaneMask is_nearest) {
    const LaneMask is_counted = terms.is_gated & is_nearest;
    num_gated += Only(is_counted, 1.0f - inlier_ratio * event.others_per_px * inverse);
    const Lanes clutter = Only(is_counted & group.IsBeside(terms), terms.outlier * inverse);
    const Lanes above = Only(terms.distance_px > 0.0f, clutter);
    beside[0] += clutter - above;
    beside[1] += above;
    const Lanes responsibility = terms.likelihood * inverse;
    const Lanes weight = Only(terms.is_gated & (responsibility >= kLeastWeight), responsibility);
    const LaneMask is_second = group.IsSecondHalf(terms);
    const Lanes reversed = weight * event.reversal_probability;
    half_weight[0] += weight;
    half_weight[1] += Only(is_second, weight);
    reversals[0] += reversed;
    reversals[1] += Only(is_second, reversed);
    const Lanes squares = weight * (terms.distance_px * terms.distance_px);
    ambiguous_px2 += (1.0f - weight) * squares;
    squares_px2 += squares;
    AddProducts(event, weight);
  }

  [[gnu::always_inline]] void AddTo(const LineGroup& group, MixtureLine& line, MixtureTotals& totals) const {
    line.sums.Add(products, group.origin);
    const auto [weight, second_weight, reversed, second_reversed, below, above, ambiguous, gated, squares] =
        SumsOf(std::array<Lanes, 9>{half_weight[0], half_weight[1], reversals[0], reversals[1], beside[0], beside[1],
                                    ambiguous_px2, num_gated, squares_px2});
    line.half_weight[0][group.polarity] += weight - second_weight;
    line.half_weight[1][group.polarity] += second_weight;
    line.half_reversals[0][group.polarity] += reversed - second_reversed;
    line.half_reversals[1][group.polarity] += second_reversed;
    line.beside[0][group.polarity] += below;
    line.beside[1][group.polarity] += above;
    line.ambiguous_px2 += ambiguous;
    totals.num_gated += gated;
    totals.weight += weight;
    totals.weighted_squares_px2 += squares;
  }

 private:
  [[gnu::always_inline]] void AddProducts(const EventLanes& event, Lanes weight) {
    const Lanes wx = weight * event.bx;
    const Lanes wy = weight * event.by;
    std::array<Lanes, 6> power = {wx * event.bx, wx * event.by, wy * event.by, wx, wy, weight};
    for (int n = 0; n < 3; ++n) {
      for (int i = 0; i < 6; ++i) {
        products[6 * n + i] += power[i];
        power[i] *= event.tau_s;
      }
    }
  }
};

EVPOSE_CLONES MixtureTotals MixturePass::Accumulate(const LineEvents& events, absl::Span<const ImageLine> lines,
                                                    const MixtureDensity& density,
                                                    absl::Span<const LineDensities> densities,
                                                    std::vector<MixtureLine>& sums) {
  const Lanes inlier_ratio = AllLanes(1.0 - density.outlier_ratio);
  AssignDefaults(lines.size(), sums);
  ResizeUnset(events.num_shared_lanes(), events.max_lanes(), terms_);
  PacedYields yields(kLanesBetweenYields);
  for (const LineGroup& group : events.groups()) {
    yields.Add(kLanesOfGroup + group.events.size());
    if (!group.is_shared) continue;
    if (!lines[group.line].in_view()) {
      for (size_t i = 0; i < group.events.size(); ++i) terms_[group.first + i] = Terms();
      continue;
    }
    const GroupTerms of_group(group, lines[group.line], density, densities[group.line]);
    for (size_t i = 0; i < group.events.size(); ++i) terms_[group.first + i] = of_group.Of(group.events[i]);
  }
  ShareEvents(events, density);
  MixtureTotals totals;
  for (const LineGroup& group : events.groups()) {
    yields.Add(kLanesOfGroup + group.events.size());
    if (!lines[group.line].in_view()) continue;
    const GroupTerms of_group(group, lines[group.line], density, densities[group.line]);
    GroupSums of_events;
    for (size_t i = 0; i < group.events.size(); ++i) {
      const EventLanes& event = group.events[i];
      if (group.is_shared) {
        const size_t k = group.first + i;
        of_events.Add(event, of_group, terms_[k], inverse_[k], inlier_ratio, is_nearest_[k]);
      } else {
        const Terms terms = of_group.Of(event);
        const Lanes inverse = 1.0f / (terms.likelihood + terms.outlier + inlier_ratio * event.others_per_px);
        of_events.Add(event, of_group, terms, inverse, inlier_ratio, kAllLanes);
      }
    }
    of_events.AddTo(group, sums[group.line], totals);
  }
  return totals;
}

void MixturePass::ShareEvents(const LineEvents& events, const MixtureDensity& density) {
  const auto inlier_ratio = static_cast<float>(1.0 - density.outlier_ratio);
  AssignDefaults(terms_.size(), events.max_lanes(), inverse_);
  AssignDefaults(terms_.size(), events.max_lanes(), is_nearest_);
  PacedYields yields(kPlacesBetweenYields);
  for (const LineEvents::Shared& event : events.shared()) {
    yields.Add(event.Places().size());
    // The nearest two lines whose gates contain the event.
    constexpr uint32_t kNone = std::numeric_limits<uint32_t>::max();
    constexpr float kFar = std::numeric_limits<float>::infinity();
    uint32_t near[2] = {kNone, kNone};
    float off_px[2] = {kFar, kFar};
    for (const uint32_t place : event.Places()) {
      const Terms& terms = terms_[place / kNumLanes];
      const uint32_t lane = place % kNumLanes;
      // Selections instead of branches: the order of the lines is random, so that a branch would be mispredicted often.
      const float distance_px = terms.is_gated[lane] != 0 ? std::abs(terms.distance_px[lane]) : kFar;
      const bool is_first = distance_px < off_px[0];
      const bool is_second = distance_px < off_px[1];
      near[1] = is_first ? near[0] : is_second ? place : near[1];
      off_px[1] = is_first ? off_px[0] : is_second ? distance_px : off_px[1];
      near[0] = is_first ? place : near[0];
      off_px[0] = is_first ? distance_px : off_px[0];
    }
    if (near[0] == kNone) continue;
    float sum = inlier_ratio * event.others_per_px + terms_[near[0] / kNumLanes].outlier[near[0] % kNumLanes];
    for (const uint32_t place : near) {
      if (place != kNone) sum += terms_[place / kNumLanes].likelihood[place % kNumLanes];
    }
    for (const uint32_t place : near) {
      if (place != kNone) inverse_[place / kNumLanes][place % kNumLanes] = 1.0f / sum;
    }
    is_nearest_[near[0] / kNumLanes][near[0] % kNumLanes] = -1;
  }
}

EdgeCounts MixtureLine::Counts(const ByPolarity& events_per_observation) const {
  EdgeCounts counts;
  for (int polarity = 0; polarity < 2; ++polarity) {
    counts.polarity[polarity] = weight()[polarity] * events_per_observation[polarity];
    for (int half = 0; half < 2; ++half) {
      counts.reversals[half] += half_reversals[half][polarity] * events_per_observation[polarity];
    }
  }
  return counts;
}

double MixtureLine::ObservedRatio(double ambiguous_px2, double weight, double sigma_px) {
  // Lower bound: with few events of the line among many others the estimated spread is too uncertain for a smaller
  // ratio.
  constexpr double kLeast = 0.1;
  if (weight <= 0.0) return kLeast;
  return std::clamp(1.0 - ambiguous_px2 / (sigma_px * sigma_px * weight), kLeast, 1.0);
}

}  // namespace evpose
