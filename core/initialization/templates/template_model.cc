// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/template_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/base/yield_point.h"
#include "core/models/slippage.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Triangles, and points of curves, up to which 642 views take less than about a second.
constexpr size_t kManyTriangles = 150'000;

// Limits of what is stored with a model: beyond those of a model, and finite.
constexpr double kLargestDiameterM = 1e6;
constexpr float kLargestContrast = 2.0f;

// The object is as wide in the camera of the templates as in the distance maps of a search.
constexpr double kTemplateFocalPx = 360.0;
CameraModel TemplateCamera() { return {240, 240, kTemplateFocalPx, kTemplateFocalPx, 120.0, 120.0, {}}; }

// Rows are the axes of a camera that looks along -direction.
Matrix3d RotationOfView(const Vector3d& direction) {
  const Vector3d forward = -direction;
  Matrix3d rotation;
  rotation.row(0) = forward.unitOrthogonal();
  rotation.row(2) = forward;
  rotation.row(1) = forward.cross(Vector3d(rotation.row(0)));
  return rotation;
}

// `angle_rad` as a number of steps, 0 to count - 1.
int StepOf(double angle_rad, double step_rad, int count) {
  const int step = static_cast<int>(std::floor(angle_rad / step_rad));
  return (step % count + count) % count;
}

std::array<TemplateTurn, kTemplateTurns> MakeTurns() {
  std::array<TemplateTurn, kTemplateTurns> turns;
  for (int i = 0; i < kTemplateTurns; ++i) {
    const auto [sin, cos] = DeterministicSinCos(2.0 * std::numbers::pi / kTemplateTurns * i);
    turns[i] = {static_cast<float>(sin), static_cast<float>(cos)};
  }
  return turns;
}

TemplateExtent ExtentOf(const std::vector<TemplatePoint>& points, const TemplateTurn& turn) {
  TemplateExtent extent;
  extent.low = extent.high = turn * points[0].at;
  for (const TemplatePoint& point : points) {
    const Eigen::Vector2f at = turn * point.at;
    extent.low = extent.low.cwiseMin(at);
    extent.high = extent.high.cwiseMax(at);
  }
  return extent;
}

}  // namespace

const TemplateTurn& TemplateTurn::At(int turn) {
  static const std::array<TemplateTurn, kTemplateTurns> turns = MakeTurns();
  return turns[turn];
}

VisibilityOptions TemplateVisibilityOptions() {
  VisibilityOptions options;
  options.samples_per_line = 6;  // as for the views of SearchModel
  options.min_length_px = 3.0;
  return options;
}

EdgeElementOptions TemplateElementOptions() {
  EdgeElementOptions options;
  options.sagitta_px = 0.5;   // half a cell of the distance maps
  options.max_elements = 96;  // fewer than in tracking: a template has only kPoints samples of them
  return options;
}

TemplateModel::TemplateModel(std::shared_ptr<const ObjectModel> model, std::shared_ptr<const SurfaceTables> surface)
    : model_(std::move(model)),
      edges_(*model_, TemplateVisibilityOptions(), TemplateElementOptions(), std::move(surface)),
      radius_m_(0.5 * model_->diameter_m) {
  const int subdivisions = model_->triangles.size() > kManyTriangles ? 2 : 3;
  const ViewSphere sphere = MakeViewSphere(*model_, subdivisions);
  if (sphere.is_turn_free) num_turns_ = 1;
  if (model_->views != nullptr && AreOfThisModel(model_->views->templates, sphere)) {
    samples_ = {model_->views, &model_->views->templates};
  } else {
    samples_ = std::make_shared<const SearchViews::Templates>(SampleViews(sphere));
  }
  for (size_t i = 0; i < sphere.directions.size(); ++i) {
    YieldPoint();
    if (!(*samples_)[i].empty()) {
      AddView(sphere.directions[i], (*samples_)[i], static_cast<int>(i) < sphere.num_coarse);
    }
  }
  FindNearAxis();
}

RigidTransform TemplateModel::PoseOfView(const Vector3d& direction) const {
  const Matrix3d rotation = RotationOfView(direction);
  return {rotation, Vector3d(0.0, 0.0, kDistanceOfRadius * radius_m_) - rotation * centre()};
}

SearchViews::Templates TemplateModel::SampleViews(const ViewSphere& sphere) const {
  SearchViews::Templates samples(sphere.directions.size());
  const CameraModel camera = TemplateCamera();
  for (size_t i = 0; i < samples.size(); ++i) {
    YieldPoint();
    SampleVisibleEdges(edges_, camera, PoseOfView(sphere.directions[i]), kPoints, samples[i]);
  }
  return samples;
}

bool TemplateModel::AreOfThisModel(const SearchViews::Templates& samples, const ViewSphere& sphere) const {
  // The points are then in front of the cameras, which are three diameters away from the centre.
  const double reach_m = model_->diameter_m;
  if (!(reach_m > 0.0 && reach_m < kLargestDiameterM)) return false;
  const auto is_of_model = [&](const EdgeSample& sample) {
    return (sample.point - centre()).norm() <= reach_m && sample.along.norm() <= reach_m &&
           sample.prior_contrast > 0.0f && sample.prior_contrast <= kLargestContrast;
  };
  const auto has_points = [&](const std::vector<EdgeSample>& view) {
    return view.size() <= static_cast<size_t>(kPoints) + 1 && std::all_of(view.begin(), view.end(), is_of_model);
  };
  return samples.size() == sphere.directions.size() && std::all_of(samples.begin(), samples.end(), has_points);
}

void TemplateModel::FindNearAxis() {
  // Slippage ratio of an object that is nearly round. That of flat plates and links is 0.17 and more.
  constexpr double kNearlyRound = 0.15;
  if (model_->continuous_symmetry || model_->triangles.empty()) return;
  const SurfaceMoments moments = MomentsOf(*model_);
  if (!(moments.radius_m > 0.0)) return;
  const SlippageAxis axis = FindSlippageAxis(moments, Matrix3d::Zero());
  if (!(axis.ratios[0] < kNearlyRound)) return;
  near_axis_ = ContinuousSymmetry{ContinuousSymmetry::Kind::kAxis, moments.centroid + moments.radius_m * axis.point,
                                  axis.direction, false};
  // Symmetries either keep the axis or turn it by far more than these 2.6 degrees, which allow for the error of the
  // axis.
  const auto keeps_axis = [&](const RigidTransform& symmetry) {
    return axis.direction.dot(symmetry.rotation * axis.direction) > 0.999;
  };
  const auto count = std::count_if(model_->symmetries.begin(), model_->symmetries.end(), keeps_axis);
  num_spins_ = std::max(1, kTemplateTurns / std::max(1, static_cast<int>(count)));
}

int TemplateModel::NearestView(RigidTransform& camera_from_object) const {
  const RigidTransform pose = camera_from_object;
  int nearest = 0;
  double largest = -2.0;
  const auto consider = [&](const RigidTransform& equivalent) {
    const Vector3d sight = (equivalent * centre()).normalized();
    const Vector3d axis = equivalent.rotation.transpose() * sight;  // from the camera to the centre, object frame
    for (size_t i = 0; i < views_.size(); ++i) {
      const double cosine = views_[i].rotation.row(2).dot(axis);
      if (!(cosine > largest)) continue;
      largest = cosine;
      nearest = static_cast<int>(i);
      camera_from_object = equivalent;
    }
  };
  consider(pose);
  for (const RigidTransform& symmetry : model_->symmetries) consider(pose * symmetry);
  return nearest;
}

void TemplateModel::AddView(const Vector3d& direction, absl::Span<const EdgeSample> samples, bool is_coarse) {
  ViewTemplate view;
  const RigidTransform pose = PoseOfView(direction);
  view.rotation = pose.rotation;
  view.samples = samples;
  view.points.reserve(samples.size());
  view.extents.reserve(static_cast<size_t>(num_turns_));
  for (const EdgeSample& sample : samples) {
    const Vector3d point = pose * sample.point, along = view.rotation * sample.along;
    const Eigen::Vector2d at = kDistanceOfRadius * point.head<2>() / point.z();
    // Derivative of the image position along the edge.
    const Eigen::Vector2d flow = along.head<2>() - along.z() / point.z() * point.head<2>();
    const double angle_rad = DeterministicAtan2(flow.y(), flow.x());
    view.points.push_back(
        {at.cast<float>(), static_cast<uint8_t>(StepOf(angle_rad, std::numbers::pi / kTemplateTurns, kTemplateTurns))});
  }
  for (int turn = 0; turn < num_turns_; ++turn) view.extents.push_back(ExtentOf(view.points, TemplateTurn::At(turn)));
  view.parent = static_cast<int>(views_.size());
  if (!is_coarse) FindParent(view);
  if (is_coarse) ++num_coarse_;
  views_.push_back(std::move(view));
}

void TemplateModel::FindParent(ViewTemplate& view) const {
  double nearest = -2.0;
  const auto consider = [&](const Matrix3d& rotation) {
    for (int i = 0; i < num_coarse_; ++i) {
      const Matrix3d relative = views_[i].rotation * rotation.transpose();
      if (!(relative(2, 2) > nearest)) continue;
      nearest = relative(2, 2);
      view.parent = i;
      const double turn_rad = DeterministicAtan2(relative(1, 0) - relative(0, 1), relative(0, 0) + relative(1, 1));
      constexpr double kStepRad = 2.0 * std::numbers::pi / kTemplateTurns;
      view.parent_turn = StepOf(turn_rad + 0.5 * kStepRad, kStepRad, kTemplateTurns);
    }
  };
  consider(view.rotation);
  for (const RigidTransform& symmetry : model_->symmetries) consider(view.rotation * symmetry.rotation);
}

absl::StatusOr<std::shared_ptr<const TemplateModel>> MakeTemplateModel(std::shared_ptr<const ObjectModel> model,
                                                                       std::shared_ptr<const SurfaceTables> surface) {
  return std::make_shared<const TemplateModel>(std::move(model), std::move(surface));
}

}  // namespace evpose
