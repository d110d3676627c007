// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/template_search.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <utility>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/models/continuous_symmetry.h"
#include "core/models/symmetry.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakePose;
using testing::Motion;

const CameraModel kSearchCamera = testing::MakeCamera(640, 480, 600.0);
const RigidTransform kTruth = MakePose({0.03, -0.02, 0.6}, {0.9, -0.4, 0.3});

enum class SearchShape { kCylinder, kTorus, kCapsule, kSphere, kPlate };

std::shared_ptr<const ObjectModel> WithSymmetries(ObjectModel model) {
  model.continuous_symmetry = FindContinuousSymmetry(model, nullptr);
  if (!model.continuous_symmetry) model.symmetries = FindSymmetries(model);
  return std::make_shared<const ObjectModel>(std::move(model));
}

std::shared_ptr<const ObjectModel> ModelOfShape(SearchShape shape) {
  switch (shape) {
    case SearchShape::kCylinder:
      return WithSymmetries(CylinderModel(0.07, 0.04, 64));
    case SearchShape::kTorus:
      return WithSymmetries(TorusModel(0.06, 0.025, 96, 48));
    case SearchShape::kCapsule:
      return WithSymmetries(CapsuleModel(0.05, 0.04, 96, 48));
    case SearchShape::kSphere:
      return WithSymmetries(SphereModel(0.05, 96, true));
    case SearchShape::kPlate:
      break;
  }
  // The hole beside the middle leaves no symmetry but the half turn about the long axis.
  ObjectModel plate = PlateWithHoles(0.04, 0.02, 0.005, 64, {-0.09, 0.03, 0.09});
  plate.diameter_m = 0.27;
  return WithSymmetries(std::move(plate));
}

Vector6d SearchTwist() {
  Vector6d twist;
  twist << 0.25, 0.12, 0.05, 0.8, -0.6, 0.5;
  return twist;
}

std::vector<PixelEvent> ToPixelEvents(const std::vector<Event>& events) {
  std::vector<PixelEvent> pixels;
  for (const Event& event : events) {
    pixels.push_back({event.t_us, static_cast<float>(event.x), static_cast<float>(event.y), event.polarity});
  }
  return pixels;
}

std::vector<PixelEvent> IdealPixelEvents(const ObjectModel& model, const Motion& motion,
                                         const IdealEventOptions& options) {
  return ToPixelEvents(testing::MakeIdealEvents(model, kSearchCamera, motion, options));
}

// Index of the first match from which a tracker finds the true pose; -1: none.
int RankOf(const TemplateMatches& found, const ObjectModel& model, const RigidTransform& truth) {
  for (size_t i = 0; i < found.matches.size(); ++i) {
    const RigidTransform pose = NearestEquivalent(found.matches[i].camera_from_object, model, truth);
    const double shift = (pose.translation_m - truth.translation_m).norm() / truth.translation_m.norm();
    if (RotationAngle(pose.rotation, truth.rotation) < 0.1 && shift < 0.03) return static_cast<int>(i);
  }
  return -1;
}

// Pixels per second.
Eigen::Vector2d ImageVelocity(const RigidTransform& pose, const Vector6d& twist, const Eigen::Vector3d& vertex) {
  constexpr double kStepS = 1e-5;
  return (kSearchCamera.Project(Perturb(pose, kStepS * twist) * vertex) - kSearchCamera.Project(pose * vertex)) /
         kStepS;
}

class FindsByContours : public ::testing::TestWithParam<SearchShape> {};

TEST_P(FindsByContours, ThePoseAndTheTwist) {
  const auto model = ModelOfShape(GetParam());
  const auto views = std::make_shared<const TemplateModel>(model);
  TemplateSearch search(views, kSearchCamera);
  const Motion motion = ConstantTwist(kTruth, SearchTwist());
  IdealEventOptions options;
  options.duration_us = 30'000;
  const TemplateMatches found = search.Find(IdealPixelEvents(*model, motion, options));
  ASSERT_TRUE(found.has_moved);
  EXPECT_GT(found.t_us, 0);
  const RigidTransform truth = motion(1e-6 * static_cast<double>(found.t_us));
  const int rank = RankOf(found, *model, truth);
  ASSERT_GE(rank, 0) << found.matches.size();
  EXPECT_LE(rank, 3);
  // A small rotation and a shift move the image alike: the velocities of the image are compared. The velocity along a
  // contour, as by the spin of a round object about its axis, is not observable; of a sphere, that of its centre is.
  const TemplateMatch& match = found.matches[rank];
  const bool is_sphere = GetParam() == SearchShape::kSphere;
  double error2 = 0.0, expected2 = 0.0;
  for (const Eigen::Vector3d& vertex : is_sphere ? std::vector{Eigen::Vector3d(0.0, 0.0, 0.0)} : model->vertices) {
    const Eigen::Vector2d expected = ImageVelocity(truth, SearchTwist(), vertex);
    error2 += (ImageVelocity(truth, match.motion.twist, vertex) - expected).squaredNorm();
    expected2 += expected.squaredNorm();
  }
  EXPECT_LT(std::sqrt(error2), 0.5 * std::sqrt(expected2)) << match.motion.twist.transpose();
}

INSTANTIATE_TEST_SUITE_P(Shapes, FindsByContours,
                         ::testing::Values(SearchShape::kCylinder, SearchShape::kTorus, SearchShape::kCapsule,
                                           SearchShape::kSphere, SearchShape::kPlate));

TEST(TemplateSearchTest, FindsAnObjectOfWhichAThirdIsHidden) {
  const auto model = ModelOfShape(SearchShape::kTorus);
  TemplateSearch search(std::make_shared<const TemplateModel>(model), kSearchCamera);
  const RigidTransform start = MakePose({0.0, 0.0, 0.5}, {0.3, 0.4, 0.2});
  const Motion motion = ConstantTwist(start, SearchTwist());
  IdealEventOptions options;
  options.duration_us = 30'000;
  options.is_hidden = [&](const Eigen::Vector2d& pixel, double t_s) {
    return pixel.x() > kSearchCamera.Project(motion(t_s).translation_m).x() + 40.0;
  };
  const TemplateMatches found = search.Find(IdealPixelEvents(*model, motion, options));
  EXPECT_GE(RankOf(found, *model, motion(1e-6 * static_cast<double>(found.t_us))), 0) << found.matches.size();
}

TEST(TemplateSearchTest, FindsAnObjectBehindABar) {
  // A bar that is higher than the image and moves with the object: its sides are connected with the object's edges.
  constexpr double kHalfWidthPx = 30.0;
  const auto model = ModelOfShape(SearchShape::kPlate);
  TemplateSearch search(std::make_shared<const TemplateModel>(model), kSearchCamera);
  const Motion motion = ConstantTwist(kTruth, SearchTwist());
  const auto bar_px = [&](double t_s) { return kSearchCamera.Project(motion(t_s).translation_m).x() + 20.0; };
  IdealEventOptions options;
  options.duration_us = 30'000;
  options.is_hidden = [&](const Eigen::Vector2d& pixel, double t_s) {
    return std::abs(pixel.x() - bar_px(t_s)) < kHalfWidthPx;
  };
  std::vector<PixelEvent> events = IdealPixelEvents(*model, motion, options);
  for (int64_t t_us = 0; t_us < options.duration_us; t_us += 2500) {
    for (const double side : {-kHalfWidthPx, kHalfWidthPx}) {
      const auto u = static_cast<float>(std::round(bar_px(1e-6 * static_cast<double>(t_us)) + side));
      for (int v = 0; v < kSearchCamera.height_px; ++v) events.push_back({t_us, u, static_cast<float>(v), 1});
    }
  }
  std::stable_sort(events.begin(), events.end(), [](const auto& a, const auto& b) { return a.t_us < b.t_us; });
  const TemplateMatches found = search.Find(events);
  EXPECT_GE(RankOf(found, *model, motion(1e-6 * static_cast<double>(found.t_us))), 0) << found.matches.size();
}

TEST(TemplateSearchTest, FindsTheTurnOfANearlyRoundObject) {
  // One painted line along the side of a cylinder tells the turn about its axis.
  ObjectModel model = CylinderModel(0.07, 0.04, 64);
  ModelLine line;
  line.p1 = {0.04, 0.0, -0.06};
  line.p2 = {0.04, 0.0, 0.06};
  line.face_normals.push_back(Eigen::Vector3d::UnitX());
  line.kind = EdgeKind::kPainted;
  model.lines.push_back(line);
  const auto shared = std::make_shared<const ObjectModel>(model);
  const auto views = std::make_shared<const TemplateModel>(shared);
  ASSERT_TRUE(views->near_axis().has_value());
  EXPECT_NEAR(std::abs(views->near_axis()->axis.z()), 1.0, 1e-3);
  TemplateSearch search(views, kSearchCamera);
  for (const double turn : {0.0, 0.4, -0.5}) {
    // The camera sees the line in front.
    const RigidTransform start{
        MakePose({0, 0, 0}, {0.3, 0.2, 0.4}).rotation * ExpSo3({1.3, 0.0, 0.0}) * ExpSo3({0.0, 0.0, -1.5707963 + turn}),
        {0.02, -0.01, 0.6}};
    const Motion motion = ConstantTwist(start, SearchTwist());
    IdealEventOptions options;
    options.duration_us = 30'000;
    const TemplateMatches found = search.Find(IdealPixelEvents(*shared, motion, options));
    EXPECT_GE(RankOf(found, *shared, motion(1e-6 * static_cast<double>(found.t_us))), 0) << turn;
  }
}

TEST(TemplateSearchTest, NoiseHasNoPose) {
  const auto model = ModelOfShape(SearchShape::kTorus);
  TemplateSearch search(std::make_shared<const TemplateModel>(model), kSearchCamera);
  EXPECT_FALSE(search.Find({}).has_moved);
  IdealEventOptions options;
  options.duration_us = 50'000;
  options.clutter_per_s = 1'000'000.0;
  options.is_hidden = [](const Eigen::Vector2d&, double) { return true; };
  const Motion motion = ConstantTwist(kTruth, SearchTwist());
  EXPECT_TRUE(search.Find(IdealPixelEvents(*model, motion, options)).matches.empty());
}

TEST(TemplateSearchTest, GivesTheSameBitsForTheSameEvents) {
  const auto model = ModelOfShape(SearchShape::kCylinder);
  IdealEventOptions options;
  options.duration_us = 30'000;
  const auto events = IdealPixelEvents(*model, ConstantTwist(kTruth, SearchTwist()), options);
  TemplateSearch a(std::make_shared<const TemplateModel>(model), kSearchCamera);
  TemplateSearch b(std::make_shared<const TemplateModel>(model), kSearchCamera);
  b.Find(absl::MakeConstSpan(events).first(events.size() / 2));
  const TemplateMatches first = a.Find(events), second = b.Find(events);
  ASSERT_EQ(first.matches.size(), second.matches.size());
  ASSERT_FALSE(first.matches.empty());
  for (size_t i = 0; i < first.matches.size(); ++i) {
    EXPECT_EQ(first.matches[i].camera_from_object, second.matches[i].camera_from_object);
    EXPECT_EQ(first.matches[i].motion.twist, second.matches[i].motion.twist);
  }
}

TEST(TemplateSearchTest, ScoresProposalsTogetherWithTheTemplates) {
  const auto model = ModelOfShape(SearchShape::kPlate);
  TemplateSearchOptions few;
  few.max_placements = 1;
  few.max_coarse = 1;
  few.max_fine = 1;
  TemplateSearch search(std::make_shared<const TemplateModel>(model), kSearchCamera, few);
  const Motion motion = ConstantTwist(kTruth, SearchTwist());
  IdealEventOptions options;
  options.duration_us = 30'000;
  const auto events = IdealPixelEvents(*model, motion, options);
  const RigidTransform wrong = MakePose({-0.1, 0.1, 0.9}, {-1.0, 0.2, 2.0});
  const TemplateMatches found = search.Find(events, {{0, kTruth, SearchTwist()}, {0, wrong, Vector6d::Zero()}});
  ASSERT_EQ(found.matches.size(), 1u);
  EXPECT_EQ(RankOf(found, *model, motion(1e-6 * static_cast<double>(found.t_us))), 0);
}

TEST(TemplateSearchTest, OptionsAreChecked) {
  TemplateSearchOptions options;
  EXPECT_TRUE(options.Validate().ok());
  options.max_matches = 0;
  EXPECT_NE(options.Validate().message().find("max_matches"), std::string::npos);
}

// The largest angle between a direction and the nearest view, modulo the symmetries, over many directions.
double LargestGap(const ObjectModel& model, const ViewSphere& sphere) {
  double largest = 0.0;
  for (int i = 0; i < 500; ++i) {
    const double z = (i + 0.5) / 250.0 - 1.0, radius = std::sqrt(1.0 - z * z), turn = 2.399963 * i;
    const Eigen::Vector3d direction(radius * std::cos(turn), radius * std::sin(turn), z);
    double nearest = -1.0;
    for (const Eigen::Vector3d& view : sphere.directions) {
      nearest = std::max(nearest, view.dot(direction));
      for (const RigidTransform& symmetry : model.symmetries) {
        nearest = std::max(nearest, view.dot(symmetry.rotation * direction));
      }
    }
    largest = std::max(largest, std::acos(std::min(1.0, nearest)));
  }
  return largest;
}

TEST(ViewSphereTest, CoversAllDirectionsModuloTheSymmetries) {
  const ObjectModel plain;
  const ViewSphere all = MakeViewSphere(plain, 3);
  EXPECT_EQ(all.directions.size(), 642u);
  EXPECT_EQ(all.num_coarse, 162);
  EXPECT_LT(LargestGap(plain, all), 0.094);  // half of the side of its triangles, divided by cos 30 degrees
  ObjectModel cube = *testing::MakeCube(0.1);
  cube.symmetries = FindSymmetries(cube);
  const ViewSphere few = MakeViewSphere(cube, 3);
  EXPECT_LT(few.directions.size(), 80u);
  EXPECT_LT(LargestGap(cube, few), 0.14);
}

TEST(ViewSphereTest, OfARoundObjectIsAMeridian) {
  ObjectModel model;
  model.continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitY(),
                               false};
  EXPECT_EQ(MakeViewSphere(model, 3).directions.size(), 31u);
  model.continuous_symmetry->is_flippable = true;
  EXPECT_EQ(MakeViewSphere(model, 3).directions.size(), 16u);
  model.continuous_symmetry->kind = ContinuousSymmetry::Kind::kSphere;
  const ViewSphere sphere = MakeViewSphere(model, 3);
  EXPECT_EQ(sphere.directions.size(), 1u);
  EXPECT_TRUE(sphere.is_turn_free);
}

TEST(TemplateModelTest, AViewLooksLikeItsCoarseViewAfterTheTurn) {
  const auto model = ModelOfShape(SearchShape::kPlate);
  const TemplateModel views(model);
  ASSERT_GT(views.views().size(), static_cast<size_t>(views.num_coarse()));
  for (const ViewTemplate& view : views.views()) {
    ASSERT_FALSE(view.points.empty());
    ASSERT_LE(view.points.size(), static_cast<size_t>(TemplateModel::kPoints) + 1);
    ASSERT_EQ(view.points.size(), view.samples.size());
    ASSERT_LT(view.parent, views.num_coarse());
    const double turn = 2.0 * std::numbers::pi / kTemplateTurns * view.parent_turn;
    const Eigen::Matrix3d turned = ExpSo3({0.0, 0.0, turn}) * view.rotation;
    const RigidTransform parent{views.views()[view.parent].rotation, Eigen::Vector3d::Zero()};
    const RigidTransform nearest = NearestEquivalent({turned, Eigen::Vector3d::Zero()}, *model, parent);
    EXPECT_LT(RotationAngle(nearest.rotation, parent.rotation), 0.35);
  }
}

}  // namespace
}  // namespace evpose
