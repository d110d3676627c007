// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/inspect_findability.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "absl/algorithm/container.h"
#include "absl/strings/str_format.h"
#include "core/numerics/statistics.h"

namespace evpose::client {
namespace {

// Share of differing edges below which two poses count as similar: the differing edges have less than a tenth of the
// events.
constexpr double kSimilarShare = 0.1;

// The result for a half turn over all views.
struct RivalSummary {
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();
  double median_share = 0.0;
  double least_share = 0.0;
  double median_px = 0.0;
  double least_px = 0.0;
  size_t num_similar = 0;  // views below kSimilarShare
};

struct FindabilitySummary {
  size_t num_findable = 0;
  size_t num_ambiguous = 0;  // of the findable views, those in which a half turn is similar
  double median_px = 0.0;    // median of the smallest sizes, over the views from which the object can be found
  double worst_px = 0.0;
  size_t num_thin = 0;  // views with less than FindabilityOptions::min_edge_px of edges
  std::vector<RivalSummary> rivals;
};

bool IsSimilar(const HalfTurnRival& rival) { return rival.differing_share < kSimilarShare; }

RivalSummary SummariseRival(const std::vector<ViewFindability>& views, size_t rival) {
  RivalSummary summary;
  summary.axis = views.front().rivals[rival].axis;
  std::vector<double> shares, lengths_px;
  for (const ViewFindability& view : views) {
    shares.push_back(view.rivals[rival].differing_share);
    lengths_px.push_back(view.rivals[rival].differing_px);
    summary.num_similar += IsSimilar(view.rivals[rival]) ? 1 : 0;
  }
  summary.least_share = *std::min_element(shares.begin(), shares.end());
  summary.median_share = UpperMedian(shares);
  summary.least_px = *std::min_element(lengths_px.begin(), lengths_px.end());
  summary.median_px = UpperMedian(lengths_px);
  return summary;
}

FindabilitySummary SummariseFindability(const std::vector<ViewFindability>& views) {
  FindabilitySummary summary;
  std::vector<double> smallest_px;
  for (const ViewFindability& view : views) {
    if (std::isfinite(view.smallest_px)) {
      smallest_px.push_back(view.smallest_px);
      summary.num_ambiguous += absl::c_any_of(view.rivals, IsSimilar) ? 1 : 0;
    }
    summary.num_thin += view.edge_px < FindabilityOptions().min_edge_px ? 1 : 0;
  }
  summary.num_findable = smallest_px.size();
  if (!smallest_px.empty()) {
    summary.worst_px = *std::max_element(smallest_px.begin(), smallest_px.end());
    summary.median_px = UpperMedian(smallest_px);
  }
  for (size_t rival = 0; rival < views.front().rivals.size(); ++rival)
    summary.rivals.push_back(SummariseRival(views, rival));
  return summary;
}

double DistanceM(double object_px, const ObjectModel& model, const CameraModel& camera) {
  return camera.MaxFocalPx() * model.diameter_m / object_px;
}

Json AxisJson(const Eigen::Vector3d& vector) { return Json::array({vector.x(), vector.y(), vector.z()}); }

}  // namespace

Json FindabilityJson(const std::vector<ViewFindability>& views, const ObjectModel& model, const CameraModel& camera) {
  const FindabilitySummary summary = SummariseFindability(views);
  const bool is_found = summary.num_findable > 0;
  Json json = {{"views", views.size()},
               {"findable_views", summary.num_findable},
               {"ambiguous_views", summary.num_ambiguous},
               {"smallest_px_median", is_found ? Json(summary.median_px) : Json(nullptr)},
               {"smallest_px_worst", is_found ? Json(summary.worst_px) : Json(nullptr)},
               {"min_edge_px", FindabilityOptions().min_edge_px},
               {"thin_views", summary.num_thin},
               {"rivals", Json::array()},
               {"by_view", Json::array()}};
  for (const RivalSummary& rival : summary.rivals) {
    json["rivals"].push_back({{"axis", AxisJson(rival.axis)},
                              {"differing_share_median", rival.median_share},
                              {"differing_share_least", rival.least_share},
                              {"differing_px_median", rival.median_px},
                              {"differing_px_least", rival.least_px},
                              {"similar_views", rival.num_similar}});
  }
  for (const ViewFindability& view : views) {
    const bool is_finite = std::isfinite(view.smallest_px);
    Json item = {{"direction", AxisJson(view.direction)},
                 {"edge_px", view.edge_px},
                 {"smallest_px", is_finite ? Json(view.smallest_px) : Json(nullptr)},
                 {"max_distance_m", is_finite ? Json(DistanceM(view.smallest_px, model, camera)) : Json(nullptr)},
                 {"differing_share", Json::array()},
                 {"differing_px", Json::array()}};
    for (const HalfTurnRival& rival : view.rivals) {
      item["differing_share"].push_back(rival.differing_share);
      item["differing_px"].push_back(rival.differing_px);
    }
    json["by_view"].push_back(std::move(item));
  }
  return json;
}

void PrintFindability(const std::vector<ViewFindability>& views, const ObjectModel& model, const CameraModel& camera,
                      std::ostream& out) {
  const FindabilitySummary summary = SummariseFindability(views);
  const FindabilityOptions options;
  out << absl::StrFormat("findable     from %d of %d views, once the image has moved by %g px", summary.num_findable,
                         views.size(), options.motion_px);
  if (summary.num_findable > 0) {
    out << absl::StrFormat("; least diameter in the image, median / worst view: %.0f / %.0f px, up to %s / %s away",
                           summary.median_px, summary.worst_px,
                           FormatLength(DistanceM(summary.median_px, model, camera)),
                           FormatLength(DistanceM(summary.worst_px, model, camera)));
  }
  if (summary.num_ambiguous > 0) {
    out << absl::StrFormat(
        "\n             in %d of these views AMBIGUOUS is expected: less than %.0f %% of the edges differ from those "
        "of a half turn",
        summary.num_ambiguous, 100.0 * kSimilarShare);
  }
  out << absl::StrFormat("\n             %.0f %% of the views show less than %.0f px of edges at a size of %.0f px\n",
                         100.0 * static_cast<double>(summary.num_thin) / static_cast<double>(views.size()),
                         options.min_edge_px, options.views.object_px);
  for (const RivalSummary& rival : summary.rivals) {
    if (rival.num_similar == 0) continue;
    out << absl::StrFormat(
        "confusable   with its half turn about (%.2f, %.2f, %.2f): %.0f / %.0f %% of the edges differ, median / least "
        "view (%.0f / %.0f px); less than %.0f %% in %d of %d views\n",
        rival.axis.x(), rival.axis.y(), rival.axis.z(), 100.0 * rival.median_share, 100.0 * rival.least_share,
        rival.median_px, rival.least_px, 100.0 * kSimilarShare, rival.num_similar, views.size());
  }
}

}  // namespace evpose::client
