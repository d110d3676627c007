// SPDX-License-Identifier: Apache-2.0
#include "core/detection/plane_segmentation.h"

#include <pcl/console/print.h>
#include <pcl/features/normal_3d.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>
#include <pcl/sample_consensus/ransac.h>
#include <pcl/sample_consensus/sac_model_plane.h>
#include <pcl/search/search.h>
#include <pcl/segmentation/region_growing.h>

// The templates are compiled here, with -ffp-contract=off: PCL's libraries for arm64 have fused multiply-adds.
#include <algorithm>
#include <cmath>
#include <iterator>
#include <new>
#include <numbers>
#include <pcl/features/impl/feature.hpp>
#include <pcl/features/impl/normal_3d.hpp>
#include <pcl/sample_consensus/impl/ransac.hpp>
#include <pcl/sample_consensus/impl/sac_model_plane.hpp>
#include <pcl/segmentation/impl/region_growing.hpp>

#include "core/base/check_range.h"
#include "core/base/yield_point.h"
#include "core/detection/space_time_cloud.h"

namespace evpose {
namespace {

using Cloud = pcl::PointCloud<pcl::PointXYZ>;

// Maximum speed of an edge relative to the time scale of the stretch. A faster plane, nearly one of constant time, is a
// flash of light.
constexpr double kMaxSpeedRatio = 8.0;
// With half of the points in the plane, 40 samples of three points miss it with a probability of 0.5 %.
constexpr int kRansacIterations = 40;
constexpr int kMaxPlanesPerRegion = 8;  // bounds the work; edges that meet at a flat angle are few
// Share of the inliers ignored at each end of a plane, so that single events beyond the end of an edge do not lengthen
// it.
constexpr double kTrimmedRatio = 0.01;

// Gives PCL's algorithms the precomputed neighbours. They query each of the cloud's own points several times, and no
// other position.
class TableSearch : public pcl::search::Search<pcl::PointXYZ> {
 public:
  explicit TableSearch(const NeighbourTable& table) : Search("TableSearch", true), table_(table) {}

  int nearestKSearch(const pcl::PointXYZ&, int, pcl::Indices& indices, std::vector<float>& distances) const override {
    indices.clear();
    distances.clear();
    return 0;  // a query of a position that is no point of the cloud; does not occur
  }
  int nearestKSearch(const Cloud&, pcl::index_t index, int k, pcl::Indices& indices,
                     std::vector<float>& distances) const override {
    return nearestKSearch(index, k, indices, distances);
  }
  int nearestKSearch(pcl::index_t index, int k, pcl::Indices& indices, std::vector<float>& distances) const override {
    YieldPoint(static_cast<size_t>(index));  // once for each point of PCL's loops
    const absl::Span<const int32_t> neighbours = table_.Of(index).subspan(0, k);
    indices.assign(neighbours.begin(), neighbours.end());
    distances.clear();  // the algorithms used here do not read them
    return static_cast<int>(indices.size());
  }
  int radiusSearch(const pcl::PointXYZ&, double, pcl::Indices& indices, std::vector<float>& distances,
                   unsigned int) const override {
    indices.clear();
    distances.clear();
    return 0;
  }

 private:
  const NeighbourTable& table_;
};

std::vector<pcl::PointIndices> GrowRegions(const Cloud::Ptr& cloud, const NeighbourTable& table,
                                           const PlaneSegmentationOptions& options) {
  const pcl::search::Search<pcl::PointXYZ>::Ptr search(new TableSearch(table));
  pcl::NormalEstimation<pcl::PointXYZ, pcl::Normal> estimation;
  estimation.setInputCloud(cloud);
  estimation.setSearchMethod(search);
  estimation.setKSearch(options.max_neighbours);
  const pcl::PointCloud<pcl::Normal>::Ptr normals(new pcl::PointCloud<pcl::Normal>);
  estimation.compute(*normals);

  pcl::RegionGrowing<pcl::PointXYZ, pcl::Normal> growing;
  growing.setInputCloud(cloud);
  growing.setInputNormals(normals);
  growing.setSearchMethod(search);
  growing.setNumberOfNeighbours(options.max_neighbours);
  // Normals are compared with that of the region's first point, which has the smallest curvature. A comparison of
  // neighbours would let regions grow around bends.
  growing.setSmoothModeFlag(false);
  growing.setSmoothnessThreshold(static_cast<float>(options.smoothness_deg * std::numbers::pi / 180.0));
  growing.setCurvatureThreshold(static_cast<float>(options.max_curvature));
  growing.setMinClusterSize(options.min_plane_points);
  std::vector<pcl::PointIndices> regions;
  growing.extract(regions);
  return regions;
}

// Returns the length of the image components of a plane's normal. std::hypot is avoided, because its result depends on
// the C library.
double InImage(const Eigen::VectorXf& coefficients) { return coefficients.head<2>().cast<double>().norm(); }

// Returns the moving edge of a plane: normal . (u, v) = offset + speed * tau (README, equation (1)).
MovingLine LineOf(const Cloud& cloud, const Eigen::VectorXf& coefficients, const pcl::Indices& inliers,
                  uint8_t polarity, double px_per_s) {
  const double in_image = InImage(coefficients);
  const Eigen::Vector2d normal = Eigen::Vector2d(coefficients[0], coefficients[1]) / in_image;
  MovingLine line;
  line.direction = {normal.y(), -normal.x()};  // rotated by 90 degrees, (-y, x), it is the normal
  line.offset_px = -coefficients[3] / in_image;
  line.speed_px_per_s = -coefficients[2] / in_image * px_per_s;
  std::vector<double> along;  // against the direction of the line
  for (const pcl::index_t index : inliers) {
    along.push_back(-normal.y() * cloud[index].x + normal.x() * cloud[index].y);
  }
  std::sort(along.begin(), along.end());
  const auto trimmed = static_cast<size_t>(kTrimmedRatio * static_cast<double>(along.size()));
  line.ends[0].s_px = -along[along.size() - 1 - trimmed];
  line.ends[1].s_px = -along[trimmed];
  line.is_polarity[polarity] = true;
  line.num_events = static_cast<int>(inliers.size());
  line.Recentre();
  return line;
}

// Appends the planes of one region, the largest first. Edges that meet at a flat angle grow into one region.
void FitPlanes(const Cloud::Ptr& cloud, pcl::Indices region, uint8_t polarity, double px_per_s,
               const PlaneSegmentationOptions& options, std::vector<MovingLine>& lines) {
  for (int k = 0; k < kMaxPlanesPerRegion && region.size() >= static_cast<size_t>(options.min_plane_points); ++k) {
    const pcl::SampleConsensusModelPlane<pcl::PointXYZ>::Ptr model(
        new pcl::SampleConsensusModelPlane<pcl::PointXYZ>(cloud, region, false));  // false: a fixed seed
    pcl::RandomSampleConsensus<pcl::PointXYZ> ransac(model, options.inlier_px);
    ransac.setMaxIterations(kRansacIterations);
    YieldPoint();
    if (!ransac.computeModel(0)) return;
    pcl::Indices inliers;
    Eigen::VectorXf sampled, fitted;
    ransac.getInliers(inliers);
    ransac.getModelCoefficients(sampled);
    model->optimizeModelCoefficients(inliers, sampled, fitted);
    model->selectWithinDistance(fitted, options.inlier_px, inliers);
    if (inliers.size() < static_cast<size_t>(options.min_plane_points)) return;
    if (std::abs(fitted[2]) <= kMaxSpeedRatio * InImage(fitted)) {
      lines.push_back(LineOf(*cloud, fitted, inliers, polarity, px_per_s));
    }
    std::sort(inliers.begin(), inliers.end());
    pcl::Indices rest;
    std::set_difference(region.begin(), region.end(), inliers.begin(), inliers.end(), std::back_inserter(rest));
    region.swap(rest);
  }
}

void SegmentPolarity(const EventStretch& stretch, uint8_t polarity, const PlaneSegmentationOptions& options,
                     std::vector<MovingLine>& lines) {
  YieldPoint();
  const double px_per_s = stretch.time_scale_px_per_s;
  const std::vector<Eigen::Vector3f> points =
      SpaceTimePoints(stretch, polarity, px_per_s, options.cell_px, options.max_points);
  const NeighbourTable all(points, options.neighbour_radius_px, options.max_neighbours);
  // Points with few neighbours are noise. PCL's radius filter would compute the neighbours again.
  std::vector<bool> is_kept(points.size());
  const Cloud::Ptr cloud(new Cloud);
  for (size_t i = 0; i < points.size(); ++i) {
    is_kept[i] = all.Of(i).size() > static_cast<size_t>(options.min_neighbours);
    if (is_kept[i]) cloud->push_back({points[i].x(), points[i].y(), points[i].z()});
  }
  if (cloud->size() < static_cast<size_t>(options.min_plane_points)) return;
  const NeighbourTable table = all.Restricted(is_kept);
  for (const pcl::PointIndices& region : GrowRegions(cloud, table, options)) {
    FitPlanes(cloud, region.indices, polarity, px_per_s, options, lines);
  }
}

}  // namespace

absl::Status PlaneSegmentationOptions::Validate() const {
  absl::Status status = CheckRange("cell_px", cell_px, 0.5, 20.0);
  status.Update(CheckRange("max_points", max_points, 100, 1e6));
  status.Update(CheckRange("neighbour_radius_px", neighbour_radius_px, cell_px, 100.0));
  status.Update(CheckRange("max_neighbours", max_neighbours, 4, 1000));
  status.Update(CheckRange("min_neighbours", min_neighbours, 0, max_neighbours));
  status.Update(CheckRange("smoothness_deg", smoothness_deg, 0.1, 90.0));
  status.Update(CheckRange("max_curvature", max_curvature, 1e-6, 1.0 / 3.0));
  status.Update(CheckRange("min_plane_points", min_plane_points, 4, 1e6));
  status.Update(CheckRange("inlier_px", inlier_px, 0.01, 100.0));
  return status;
}

std::vector<MovingLine> SegmentPlanes(const EventStretch& stretch, const PlaneSegmentationOptions& options) {
  // PCL would write a message to standard error for each degenerate sample; its return values are checked instead.
  static const bool is_quiet = (pcl::console::setVerbosityLevel(pcl::console::L_ALWAYS), true);
  static_cast<void>(is_quiet);
  std::vector<MovingLine> lines;
  try {
    for (const uint8_t polarity : {0, 1}) SegmentPolarity(stretch, polarity, options, lines);
  } catch (const std::bad_alloc&) {
    throw;  // memory is exhausted: no fault of the events
  } catch (const std::exception&) {
    lines.clear();
  }
  std::stable_sort(lines.begin(), lines.end(),
                   [](const MovingLine& a, const MovingLine& b) { return a.num_events > b.num_events; });
  return lines;
}

}  // namespace evpose
