// SPDX-License-Identifier: Apache-2.0
#include "core/tracking/evidence/determination.h"

#include <algorithm>

#include "core/association/observability.h"
#include "core/base/yield_point.h"

namespace evpose {

void Determination::Sum(const RigidTransform& camera_from_object, absl::Span<const TrackedLine> tracked,
                        absl::Span<const ImageLine> lines, absl::Span<const CurveResult> results) {
  free_rotations_ = FreeRotations(model_, camera_from_object.rotation);
  for (Matrix6d* const sum : {&information_, &supported_, &expected_}) sum->setZero();
  of_curves_.clear();
  const Matrix6d motions = OutlineMotions(camera_, camera_from_object, sphere_.centre, sphere_.radius_m);
  ForEachCurve(tracked, [&](size_t first, size_t end) {
    YieldPoint();
    const CurveResult& result = results[tracked[first].curve];
    const bool is_decided =
        result.kind == CurveResult::Kind::kSupported || result.kind == CurveResult::Kind::kContradicted;
    const bool has_events = result.events >= 0.5 * result.expected;
    if (!is_decided && has_events && result.support_ratio == 0.0) return;
    double length_px = 0.0;
    Matrix6d by_length = Matrix6d::Zero();
    for (size_t k = first; k < end; ++k) {
      if (!lines[k].in_view()) continue;
      length_px += lines[k].length_px;
      AddInformation(camera_, lines[k], lines[k].length_px, motions, by_length);
    }
    if (!(length_px > 0.0)) return;
    // The pooled test does not tell on which of its curves the events are: each counts with the events of its own.
    const double share = result.support_ratio * result.expected;
    const double supported = is_decided ? share : std::min(share, result.events);
    supported_ += supported / length_px * by_length;
    expected_ += (!is_decided && has_events ? supported : result.expected) / length_px * by_length;
    if (!(result.support_ratio > 0.0)) return;
    of_curves_.push_back(result.support_ratio * result.events / length_px / options_.dispersion * by_length);
    information_ += of_curves_.back();
  });
}

bool Determination::IsKept() const { return IsDetermined(information_, free_rotations_, options_.max_uncertainty_px); }

bool Determination::IsConfirmed(double support_ratio) const {
  return IsDeterminedWithoutAny(IsAtLeast(supported_, support_ratio, expected_, free_rotations_)
                                    ? options_.max_uncertainty_px
                                    : options_.sure_uncertainty_px);
}

bool Determination::IsDeterminedWithoutAny(double max_uncertainty_px) const {
  return !of_curves_.empty() && std::all_of(of_curves_.begin(), of_curves_.end(), [&](const Matrix6d& of_curve) {
    YieldPoint();
    return IsDetermined(information_ - of_curve, free_rotations_, max_uncertainty_px);
  });
}

}  // namespace evpose
