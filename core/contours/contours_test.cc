// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "core/contours/contour_shapes_testing.h"
#include "core/contours/edge_elements.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

constexpr double kThirdOfSagittaPx = 0.25 / 3.0;  // of the mean position of an arc

DistanceField Torus() {
  return [](const Eigen::Vector3d& p) { return TorusField(p, 0.1, 0.04); };
}
DistanceField Capsule() {
  return [](const Eigen::Vector3d& p) { return CapsuleField(p, 0.06, 0.05); };
}

std::vector<double> ErrorsPx(const DistanceField& field, const std::vector<EdgeElement>& elements,
                             const Eigen::Vector3d& eye) {
  std::vector<double> errors;
  for (const EdgeElement& element : elements) {
    for (const Eigen::Vector3d& point : SamplesOf(element)) errors.push_back(OutsidePx(field, eye, point, 0.03));
  }
  return errors;
}

std::vector<double> Magnitudes(std::vector<double> values) {
  for (double& value : values) value = std::abs(value);
  return values;
}

TEST(ContoursTest, SphereShowsTheCircleOfItsTangentCone) {
  const Eigen::Vector3d eye(0.2, 0.3, 0.4);
  const DistanceField field = [](const Eigen::Vector3d& p) { return p.norm() - 0.1; };
  for (const bool is_fitted : {true, false}) {
    for (const int count : {24, 64, 160}) {
      const auto elements = ElementsOf(SphereModel(0.1, count, is_fitted), eye);
      const std::vector<double> errors = ErrorsPx(field, elements, eye);
      const double extra_px = is_fitted || count > 24 ? 0.02 : 0.1;
      EXPECT_LT(Quantile(Magnitudes(errors), 0.95), kThirdOfSagittaPx + 2 * extra_px) << count;
      EXPECT_NEAR(Mean(errors), 0.0, extra_px) << count;
      // The image of a sphere is an ellipse; at its centre it is a circle.
      const double radius_px = 700.0 * 0.1 / std::sqrt(eye.squaredNorm() - 0.01);
      EXPECT_NEAR(LengthPx(elements, EdgeKind::kContour, eye) / (2.0 * std::numbers::pi * radius_px), 1.0, 0.01);
      for (const EdgeElement& element : elements) {
        EXPECT_EQ(element.kind, EdgeKind::kContour);
        EXPECT_EQ(element.prior_contrast, 1.0f);
        EXPECT_NEAR(element.radius_m[0], 0.1, is_fitted ? 1e-12 : 0.02);
        EXPECT_NEAR(element.normals[0].dot((element.p1 - eye).normalized()), 0.0, is_fitted ? 4e-4 : 5e-3);
      }
    }
  }
}

TEST(ContoursTest, LimbsOfACylinderAreExactForAnyTessellation) {
  for (const Eigen::Vector3d& eye : {Eigen::Vector3d(0.5, 0.1, 0.1), Eigen::Vector3d(0.3, 0.3, 0.35)}) {
    for (const int count : {24, 37, 64, 256}) {
      const auto elements = ElementsOf(CylinderModel(0.08, 0.05, count), eye);
      double limb_m = 0.0;
      for (const EdgeElement& element : elements) {
        if (element.kind != EdgeKind::kContour) continue;
        limb_m += (element.p2 - element.p1).norm();
        for (const Eigen::Vector3d& point : SamplesOf(element)) {
          const Eigen::Vector3d ray = (point - eye).normalized();
          const Eigen::Vector3d across = ray.cross(Eigen::Vector3d(0, 0, 1));
          const double distance_m = std::abs(eye.dot(across)) / across.norm();
          EXPECT_NEAR((distance_m - 0.05) * 700.0 / (point - eye).norm(), 0.0, 0.05);
        }
        const Eigen::Vector3d ray = (element.p1 - eye).normalized();
        EXPECT_NEAR(element.radius_m[0] * (1.0 - ray.z() * ray.z()), 0.05, 2e-3);
      }
      EXPECT_NEAR(limb_m, 2 * 0.16, 0.01) << count;
    }
  }
}

TEST(ContoursTest, CapsuleIsSeenWhereItsRaysTouchIt) {
  for (const Eigen::Vector3d& eye : {Eigen::Vector3d(0.5, 0, 0), Eigen::Vector3d(0.3, 0.2, 0.3)}) {
    const auto elements = ElementsOf(CapsuleModel(0.06, 0.05, 96, 49), eye);
    const std::vector<double> errors = ErrorsPx(Capsule(), elements, eye);
    EXPECT_LT(Quantile(Magnitudes(errors), 0.95), 0.15);
    EXPECT_NEAR(Mean(errors), 0.0, 0.03);
  }
}

TEST(ContoursTest, TorusEndsAtCuspsAndShowsNoHiddenPart) {
  for (const double elevation_deg : {90.0, 60.0, 40.0, 25.0, 5.0}) {
    const double elevation = elevation_deg / 180.0 * std::numbers::pi;
    const Eigen::Vector3d eye = 0.6 * Eigen::Vector3d(std::cos(elevation), 0.0, std::sin(elevation));
    const auto elements = ElementsOf(TorusModel(0.1, 0.04, 160, 80), eye);
    ASSERT_GT(elements.size(), 30u);
    const std::vector<double> errors = ErrorsPx(Torus(), elements, eye);
    EXPECT_LT(Quantile(Magnitudes(errors), 0.95), 0.15) << elevation_deg;
    EXPECT_NEAR(Mean(errors), 0.0, 0.03) << elevation_deg;
    int num_hidden = 0;
    for (const EdgeElement& element : elements) {
      EXPECT_GT(element.radius_m[0], 0.0);
      EXPECT_GT(element.radius_m[1], 0.0);
      num_hidden += IsHidden(Torus(), eye, 0.5 * (element.p1 + element.p2), 2e-3);
    }
    EXPECT_LE(num_hidden, static_cast<int>(elements.size() / 50)) << elevation_deg;
  }
}

TEST(ContoursTest, ConcaveWallHasNoContour) {
  ObjectModel model = CylinderModel(0.08, 0.05, 64);
  model.surface.regions[0].is_convex = false;
  EXPECT_EQ(LengthPx(ElementsOf(model, {0.5, 0.1, 0.1}), EdgeKind::kContour, {0.5, 0.1, 0.1}), 0.0);
}

TEST(ContoursTest, RepeatedExtractionGivesTheSameBits) {
  const ObjectModel model = TorusModel(0.1, 0.04, 80, 40);
  const Eigen::Vector3d eye(0.3, 0.2, 0.4);
  const auto first = ElementsOf(model, eye), second = ElementsOf(model, eye);
  ASSERT_EQ(first.size(), second.size());
  for (size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].p1, second[i].p1);
    EXPECT_EQ(first[i].p2, second[i].p2);
    EXPECT_EQ(first[i].normals, second[i].normals);
    EXPECT_EQ(first[i].radius_m, second[i].radius_m);
    EXPECT_EQ(first[i].curve, second[i].curve);
    EXPECT_EQ(first[i].prior_contrast, second[i].prior_contrast);
  }
}

TEST(ContoursTest, ArcsAreNumberedAfterLinesAndCurves) {
  ObjectModel model = CylinderModel(0.08, 0.05, 64);
  model.lines.resize(3);
  const TriangleBvh faces(model.vertices, model.triangles);
  const EdgeElementExtractor extractor(model, faces, {});
  EXPECT_TRUE(extractor.has_curves());
  EXPECT_EQ(extractor.num_curves(), 3u + 2u + 8u);  // one curved region
  for (const EdgeElement& element : ElementsOf(model, {0.3, 0.1, 0.3})) {
    EXPECT_GE(element.curve, element.kind == EdgeKind::kContour ? 5u : 3u);
    EXPECT_LT(element.curve, element.kind == EdgeKind::kContour ? 13u : 5u);
  }
  model.curves.clear();
  model.surface = {};
  EXPECT_FALSE(EdgeElementExtractor(model, faces, {}).has_curves());
}

// The contour moves, but most of its elements keep the number of their arc.
TEST(ContoursTest, ArcsKeepTheirNumberWhenTheViewChanges) {
  const ObjectModel model = SphereModel(0.1, 96, false);
  const auto before = ElementsOf(model, {0.3, 0.2, 0.4}), after = ElementsOf(model, {0.32, 0.2, 0.4});
  std::array<int, 8> counts_before = {}, counts_after = {};
  for (const EdgeElement& element : before) ++counts_before.at(element.curve);
  for (const EdgeElement& element : after) ++counts_after.at(element.curve);
  for (int octant = 0; octant < 8; ++octant) {
    EXPECT_GT(counts_before[octant], 3);
    EXPECT_NEAR(counts_before[octant], counts_after[octant], 3);
  }
}

struct SlideErrors {
  std::vector<double> frozen_px, slid_px;
};

// Returns by how much the distance of the ends from the contour changes when the eye turns about the object.
SlideErrors ErrorsOfSlide(const ObjectModel& model, const DistanceField& field, double turn_deg) {
  const Eigen::Vector3d eye(0.35, 0.2, 0.4);
  const Eigen::AngleAxisd turn(turn_deg / 180.0 * std::numbers::pi, Eigen::Vector3d(0.5, 0.7, -0.3).normalized());
  const Eigen::Vector3d turned = turn * eye;
  SlideErrors errors;
  for (const EdgeElement& element : ElementsOf(model, eye)) {
    EdgeElement slid = element;
    SlideContour(turned, slid);
    const double before_px = OutsidePx(field, eye, element.p1, 0.03);
    errors.frozen_px.push_back(std::abs(OutsidePx(field, turned, element.p1, 0.03) - before_px));
    errors.slid_px.push_back(std::abs(OutsidePx(field, turned, slid.p1, 0.03) - before_px));
  }
  return errors;
}

TEST(ContoursTest, SlidContourFollowsTheViewTo8Degrees) {
  struct Case {
    double turn_deg, slid_median_px, slid_p90_px;
  };
  for (const Case& c : {Case{2.0, 0.01, 0.05}, Case{4.0, 0.02, 0.1}, Case{8.0, 0.04, 0.2}}) {
    const SlideErrors capsule = ErrorsOfSlide(CapsuleModel(0.06, 0.05, 160, 99), Capsule(), c.turn_deg);
    const SlideErrors torus = ErrorsOfSlide(TorusModel(0.1, 0.04, 240, 120), Torus(), c.turn_deg);
    for (const SlideErrors& errors : {capsule, torus}) {
      EXPECT_LT(Quantile(errors.slid_px, 0.5), c.slid_median_px) << c.turn_deg;
      EXPECT_LT(Quantile(errors.slid_px, 0.9), c.slid_p90_px) << c.turn_deg;
    }
    if (c.turn_deg < 8.0) continue;
    EXPECT_GT(Quantile(capsule.frozen_px, 0.9), 3.0 * Quantile(capsule.slid_px, 0.9));
    EXPECT_GT(Quantile(torus.frozen_px, 0.9), 3.0 * Quantile(torus.slid_px, 0.9));
  }
}

TEST(ContoursTest, SlidingASphereIsExact) {
  const Eigen::Vector3d eye(0.2, 0.3, 0.4), turned(0.4, 0.3, 0.25);
  for (EdgeElement element : ElementsOf(SphereModel(0.1, 64, true), eye)) {
    element.p1 = 0.1 * element.normals[0];  // without the offset of its chord
    SlideContour(turned, element);
    EXPECT_NEAR(element.p1.norm(), 0.1, 1e-12);
    EXPECT_NEAR((element.normals[0] - element.p1 / 0.1).norm(), 0.0, 1e-9);
    EXPECT_NEAR(element.normals[0].dot(element.p1 - turned), 0.0, 1e-12);
  }
  EdgeElement fixed;
  fixed.p1 = {0.1, 0, 0};
  fixed.p2 = {0.1, 0.1, 0};
  SlideContour(turned, fixed);
  EXPECT_EQ(fixed.p1, Eigen::Vector3d(0.1, 0, 0));
}

TEST(ContoursTest, EyeWithinTheShapeOrBehindTheCameraSeesNothing) {
  const ObjectModel model = SphereModel(0.1, 64, true);
  EXPECT_TRUE(ElementsOf(model, {0.01, 0.02, 0.03}).empty());
  RigidTransform pose = ViewFrom({0.2, 0.3, 0.4});
  pose.translation_m.z() = -0.5;
  const TriangleBvh faces(model.vertices, model.triangles);
  const EdgeElementExtractor extractor(model, faces, {});
  std::vector<EdgeElement> elements(3);
  extractor.Extract(ContourCamera(), pose, 0, elements);
  EXPECT_TRUE(elements.empty());
}

TEST(ContoursTest, ElementsEndAtTheImage) {
  const ObjectModel model = SphereModel(0.1, 64, true);
  RigidTransform pose = ViewFrom({0.2, 0.3, 0.4});
  pose.translation_m.x() += 0.5 * 320.0 / 700.0;
  const TriangleBvh faces(model.vertices, model.triangles);
  const EdgeElementExtractor extractor(model, faces, {});
  std::vector<EdgeElement> elements;
  CameraModel camera = ContourCamera();
  for (const bool is_distorted : {false, true}) {
    if (is_distorted) camera.distortion[0] = -0.2;
    extractor.Extract(camera, pose, 0, elements);
    EXPECT_GT(elements.size(), 8u);
    for (const EdgeElement& element : elements) {
      const Eigen::Vector2d pixel = camera.Project(pose * Eigen::Vector3d(0.5 * (element.p1 + element.p2)));
      EXPECT_TRUE(camera.IsInImage(pixel)) << pixel.transpose();
    }
  }
}

TEST(ContoursTest, LevelOfDetailHasHysteresis) {
  const ObjectModel model = SphereModel(0.1, 24, false);
  const CameraModel camera = ContourCamera();
  const auto level = [&](double distance_m, int previous) {
    return DetailLevel(model, camera, ViewFrom({0, 0, distance_m}), previous);
  };
  double change_m = 0.3;  // the first distance at which the level grows
  const int first = level(change_m, -1);
  while (level(change_m, -1) == first) change_m += 0.001;
  EXPECT_EQ(level(change_m, -1), first + 1);
  EXPECT_EQ(level(1.08 * change_m, first), first);
  EXPECT_EQ(level(1.15 * change_m, first), first + 1);
  EXPECT_EQ(level(change_m / 1.08, first + 1), first + 1);
  EXPECT_EQ(level(change_m / 1.15, first + 1), first);
  EXPECT_EQ(level(1e-3, -1), 0);
  EXPECT_EQ(level(1e6, -1), kNumDetailLevels - 1);
}

TEST(ContoursTest, OptionsOutOfRangeAreNamed) {
  EXPECT_TRUE(EdgeElementOptions().Validate().ok());
  EdgeElementOptions options;
  options.sagitta_px = 0.0;
  EXPECT_NE(options.Validate().message().find("sagitta_px"), std::string::npos);
  options = {};
  options.min_chain_px = -1.0;
  EXPECT_NE(options.Validate().message().find("min_chain_px"), std::string::npos);
  options = {};
  options.max_elements = 0;
  EXPECT_NE(options.Validate().message().find("max_elements"), std::string::npos);
}

}  // namespace
}  // namespace evpose
