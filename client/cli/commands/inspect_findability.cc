// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/inspect_findability.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

// Share of differing edges below which two poses count as similar: the differing edges have less than a tenth of the
// events.
constexpr double kSimilarShare = 0.1;

// The result for a half turn over all views.
struct TwinSummary {
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();
  double median_share = 0.0;
  double least_share = 0.0;
  double median_px = 0.0;
  double least_px = 0.0;
  size_t num_similar = 0;  // views below kSimilarShare
};

struct FindabilitySummary {
  size_t num_findable = 0;
  double median_px = 0.0;  // median of the smallest sizes, over the views from which the object can be found
  double worst_px = 0.0;
  size_t num_thin = 0;  // views with less than FindabilityOptions::min_edge_px of edges
  std::vector<TwinSummary> twins;
};

TwinSummary SummariseTwin(const std::vector<ViewFindability>& views, size_t twin) {
  TwinSummary summary;
  summary.axis = views.front().twins[twin].axis;
  std::vector<double> shares, lengths_px;
  for (const ViewFindability& view : views) {
    shares.push_back(view.twins[twin].differing_share);
    lengths_px.push_back(view.twins[twin].differing_px);
    summary.num_similar += shares.back() < kSimilarShare ? 1 : 0;
  }
  std::sort(shares.begin(), shares.end());
  std::sort(lengths_px.begin(), lengths_px.end());
  summary.median_share = shares[shares.size() / 2];
  summary.least_share = shares.front();
  summary.median_px = lengths_px[lengths_px.size() / 2];
  summary.least_px = lengths_px.front();
  return summary;
}

FindabilitySummary SummariseFindability(const std::vector<ViewFindability>& views) {
  FindabilitySummary summary;
  std::vector<double> smallest_px;
  for (const ViewFindability& view : views) {
    if (std::isfinite(view.smallest_px)) smallest_px.push_back(view.smallest_px);
    summary.num_thin += view.edge_px < FindabilityOptions().min_edge_px ? 1 : 0;
  }
  std::sort(smallest_px.begin(), smallest_px.end());
  summary.num_findable = smallest_px.size();
  if (!smallest_px.empty()) {
    summary.median_px = smallest_px[smallest_px.size() / 2];
    summary.worst_px = smallest_px.back();
  }
  for (size_t twin = 0; twin < views.front().twins.size(); ++twin) summary.twins.push_back(SummariseTwin(views, twin));
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
               {"smallest_px_median", is_found ? Json(summary.median_px) : Json(nullptr)},
               {"smallest_px_worst", is_found ? Json(summary.worst_px) : Json(nullptr)},
               {"min_edge_px", FindabilityOptions().min_edge_px},
               {"thin_views", summary.num_thin},
               {"twins", Json::array()},
               {"by_view", Json::array()}};
  for (const TwinSummary& twin : summary.twins) {
    json["twins"].push_back({{"axis", AxisJson(twin.axis)},
                             {"differing_share_median", twin.median_share},
                             {"differing_share_least", twin.least_share},
                             {"differing_px_median", twin.median_px},
                             {"differing_px_least", twin.least_px},
                             {"similar_views", twin.num_similar}});
  }
  for (const ViewFindability& view : views) {
    const bool is_finite = std::isfinite(view.smallest_px);
    Json item = {{"direction", AxisJson(view.direction)},
                 {"edge_px", view.edge_px},
                 {"smallest_px", is_finite ? Json(view.smallest_px) : Json(nullptr)},
                 {"max_distance_m", is_finite ? Json(DistanceM(view.smallest_px, model, camera)) : Json(nullptr)},
                 {"differing_share", Json::array()},
                 {"differing_px", Json::array()}};
    for (const HalfTurnTwin& twin : view.twins) {
      item["differing_share"].push_back(twin.differing_share);
      item["differing_px"].push_back(twin.differing_px);
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
  out << absl::StrFormat("\n             %.0f %% of the views show less than %.0f px of edges at a size of %.0f px\n",
                         100.0 * static_cast<double>(summary.num_thin) / static_cast<double>(views.size()),
                         options.min_edge_px, options.views.object_px);
  for (const TwinSummary& twin : summary.twins) {
    if (twin.num_similar == 0) continue;
    out << absl::StrFormat(
        "confusable   with its half turn about (%.2f, %.2f, %.2f): %.0f / %.0f %% of the edges differ, median / least "
        "view (%.0f / %.0f px); less than %.0f %% in %d of %d views\n",
        twin.axis.x(), twin.axis.y(), twin.axis.z(), 100.0 * twin.median_share, 100.0 * twin.least_share,
        twin.median_px, twin.least_px, 100.0 * kSimilarShare, twin.num_similar, views.size());
  }
}

}  // namespace evpose::client
