// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "core/contours/contour_shapes_testing.h"
#include "core/contours/edge_elements.h"
#include "core/contours/element_view.h"

namespace evpose {
namespace {

constexpr double kHoleM = 0.02, kThicknessM = 0.04;
constexpr int kPlateFacets = 32;

ObjectModel Plate() { return PlateWithHoles(0.06, kHoleM, kThicknessM, kPlateFacets, {-0.06, 0.06}); }

std::vector<EdgeElement> OfCurve(const std::vector<EdgeElement>& elements, uint32_t curve) {
  std::vector<EdgeElement> found;
  for (const EdgeElement& element : elements) {
    if (element.curve == curve) found.push_back(element);
  }
  return found;
}

double LengthM(const std::vector<EdgeElement>& elements) {
  double length_m = 0.0;
  for (const EdgeElement& element : elements) length_m += (element.p2 - element.p1).norm();
  return length_m;
}

// Distance, pixels, of the image of a point from that of the circle of radius `radius_m` about (x, 0, z).
double FromCirclePx(const Eigen::Vector3d& point, double x, double radius_m, const Eigen::Vector3d& eye) {
  const Eigen::Vector2d offset(point.x() - x, point.y());
  return (offset.norm() - radius_m) * 700.0 / (point - eye).norm();
}

TEST(CreasesTest, FrontRimsOfHolesAreTheirCircles) {
  const ObjectModel plate = Plate();
  for (const Eigen::Vector3d& eye : {Eigen::Vector3d(0, 0, 0.4), Eigen::Vector3d(0.2, 0.1, 0.3)}) {
    const auto elements = ElementsOf(plate, eye);
    for (const auto& [curve, x] : {std::pair(0u, -0.06), std::pair(2u, 0.06)}) {
      const auto rim = OfCurve(elements, curve);
      // Where the rim behind crosses it in the image, one of the two is dropped.
      EXPECT_GT(LengthM(rim) / (2.0 * std::numbers::pi * kHoleM), 0.85);
      EXPECT_LT(LengthM(rim) / (2.0 * std::numbers::pi * kHoleM), 1.01);
      double sum_px = 0.0;
      for (const EdgeElement& element : rim) {
        EXPECT_EQ(element.kind, EdgeKind::kCrease);
        EXPECT_EQ(element.radius_m[0], 0.0);
        for (const Eigen::Vector3d& point : SamplesOf(element)) {
          EXPECT_NEAR(FromCirclePx(point, x, kHoleM, eye), 0.0, 0.25);
          EXPECT_NEAR(point.z(), 0.0, 1e-9);
          sum_px += FromCirclePx(point, x, kHoleM, eye);
        }
      }
      // The polygon of 32 sides is 0.1 px smaller in the mean, the chords are not.
      EXPECT_NEAR(sum_px / (5.0 * static_cast<double>(rim.size())), 0.0, 0.03);
    }
  }
}

TEST(CreasesTest, RimsBehindAreSeenThroughTheHoleOnly) {
  const ObjectModel plate = Plate();
  for (const Eigen::Vector3d& eye : {Eigen::Vector3d(0, 0, 0.4), Eigen::Vector3d(0.25, 0.1, 0.2)}) {
    const auto elements = ElementsOf(plate, eye);
    for (const auto& [curve, hole_x] : {std::pair(1u, -0.06), std::pair(3u, 0.06)}) {
      const double x = hole_x;
      const auto is_open = [&](const Eigen::Vector3d& point, double tolerance_m) {
        const double fraction = -point.z() / (eye.z() - point.z());
        const Eigen::Vector3d in_front = point + fraction * (eye - point);
        return std::hypot(in_front.x() - x, in_front.y()) < kHoleM + tolerance_m;
      };
      double open_m = 0.0;
      for (int i = 0; i < 1000; ++i) {
        const Eigen::Vector2d p = kHoleM * OnCircle(i / 1000.0);
        if (is_open({p.x() + x, p.y(), -kThicknessM}, 0.0)) open_m += 2.0 * std::numbers::pi * kHoleM / 1000.0;
      }
      const auto rim = OfCurve(elements, curve);
      EXPECT_NEAR(LengthM(rim), open_m, 0.1 * 2.0 * std::numbers::pi * kHoleM);
      // In a grazing view of the wall, up to 1.2 degrees, the origin of the rays is moved away from it: by 2.2 mm in
      // the plane of the rim in front; and the points are moved by 0.5 mm.
      for (const EdgeElement& element : rim) EXPECT_TRUE(is_open(0.5 * (element.p1 + element.p2), 3.5e-3));
    }
  }
}

TEST(CreasesTest, FacesTurnedAwayHideTheirCurves) {
  const ObjectModel cylinder = CylinderModel(0.08, 0.05, 64);
  const Eigen::Vector3d eye(0.3, 0.1, 0.3);
  const auto elements = ElementsOf(cylinder, eye);
  // The whole rim of the cap in front, and half of that behind, which is an outline.
  EXPECT_NEAR(LengthM(OfCurve(elements, 1)) / (2.0 * std::numbers::pi * 0.05), 0.97, 0.04);
  EXPECT_NEAR(LengthM(OfCurve(elements, 0)) / (2.0 * std::numbers::pi * 0.05), 0.47, 0.06);
  for (const EdgeElement& element : OfCurve(elements, 0)) EXPECT_EQ(element.prior_contrast, 1.0f);
  size_t num_inner = 0;
  for (const EdgeElement& element : OfCurve(elements, 1)) num_inner += element.prior_contrast < 1.0f;
  EXPECT_GT(num_inner, OfCurve(elements, 1).size() / 4);
  EXPECT_LT(num_inner, OfCurve(elements, 1).size() * 3 / 4);
}

TEST(CreasesTest, BluntCreasesHaveASmallPriorContrast) {
  ObjectModel plate = Plate();
  const auto contrast = [&] {
    float least = 2.0f;
    for (const EdgeElement& element : OfCurve(ElementsOf(plate, {0, 0, 0.4}), 0)) {
      least = std::min(least, element.prior_contrast);
    }
    return least;
  };
  const float sharp = contrast();
  plate.curves[0].turn_rad = 0.5;
  EXPECT_LT(contrast(), sharp);
}

// A hole with a floor: seen from the front, floor and plate have the same brightness; from the side the wall shows.
TEST(CreasesTest, TheRimOfABlindHoleIsAStepFromTheFront) {
  ObjectModel plate = Plate();
  const auto first = static_cast<uint32_t>(plate.vertices.size());
  constexpr double kFloorM = -0.004;
  for (const auto& [x, y] :
       {std::pair(-0.1, -0.04), std::pair(0.1, -0.04), std::pair(0.1, 0.04), std::pair(-0.1, 0.04)}) {
    plate.vertices.emplace_back(x, y, kFloorM);
  }
  plate.triangles.push_back({first, first + 1, first + 2});
  plate.triangles.push_back({first, first + 2, first + 3});
  const auto num_steps = [&](const Eigen::Vector3d& eye) {
    const auto rim = OfCurve(ElementsOf(plate, eye), 0);
    EXPECT_GT(rim.size(), 8u);
    return std::count_if(rim.begin(), rim.end(),
                         [](const EdgeElement& e) { return e.prior_contrast == kStepContrast; });
  };
  EXPECT_EQ(num_steps({-0.06, 0, 0.4}),
            static_cast<std::ptrdiff_t>(OfCurve(ElementsOf(plate, {-0.06, 0, 0.4}), 0).size()));
  EXPECT_LT(num_steps({0.3, 0.1, 0.3}),
            static_cast<std::ptrdiff_t>(OfCurve(ElementsOf(plate, {0.3, 0.1, 0.3}), 0).size()));
}

TEST(CreasesTest, BoundaryIsSeenFromItsFront) {
  ObjectModel disc;
  disc.curves.push_back(RingCurve({0, 0, 0}, 0.05, 64, {0, 0, 1}, 1.0));
  disc.curves[0].kind = EdgeKind::kBoundary;
  for (auto& normals : disc.curves[0].face_normals) normals[1].setZero();
  disc.diameter_m = 0.1;
  disc.vertices = {{0, 0, 0}};
  EXPECT_GT(ElementsOf(disc, {0.1, 0.1, 0.4}).size(), 8u);
  EXPECT_TRUE(ElementsOf(disc, {0.1, 0.1, -0.4}).empty());
}

TEST(CreasesTest, SmallCurvesAndParallelOnesAreDropped) {
  ObjectModel disc;
  disc.curves.push_back(RingCurve({0, 0, 0}, 0.05, 64, {0, 0, 1}, 1.0));
  disc.diameter_m = 0.1;
  disc.vertices = {{0, 0, 0}};
  const Eigen::Vector3d eye(0, 0, 0.5);
  const double length_px = LengthPx(ElementsOf(disc, eye), EdgeKind::kCrease, eye);
  EXPECT_NEAR(length_px, 2.0 * std::numbers::pi * 70.0, 3.0);
  disc.curves.push_back(RingCurve({0, 0, 0}, 0.0003, 16, {0, 0, 1}, 1.0));  // perimeter 2.6 px
  EXPECT_TRUE(OfCurve(ElementsOf(disc, eye), 1).empty());
  disc.curves[1] = RingCurve({0, 0, 0}, 0.049, 64, {0, 0, 1}, 1.0);  // 1.4 px beside the other
  EXPECT_NEAR(LengthPx(ElementsOf(disc, eye), EdgeKind::kCrease, eye), length_px, 0.1 * length_px);
  disc.curves[1] = RingCurve({0, 0, 0}, 0.046, 64, {0, 0, 1}, 1.0);  // 5.6 px
  EXPECT_NEAR(LengthPx(ElementsOf(disc, eye), EdgeKind::kCrease, eye), 1.92 * length_px, 0.02 * length_px);
}

TEST(CreasesTest, FewerElementsCoverTheImageAndKeepTheOutline) {
  EdgeElementOptions options;
  options.max_elements = 24;
  const Eigen::Vector3d eye(0.2, 0.1, 0.3);
  const ObjectModel model = CylinderModel(0.08, 0.05, 64);
  const auto all = ElementsOf(model, eye), few = ElementsOf(model, eye, options);
  ASSERT_GT(all.size(), 32u);
  EXPECT_EQ(few.size(), 24u);
  const TriangleBvh faces(model.vertices, model.triangles);
  std::vector<EdgeElement> elements;
  for (const bool is_limited : {false, true}) {
    const EdgeElementExtractor extractor(model, faces, is_limited ? options : EdgeElementOptions());
    EXPECT_EQ(extractor.Extract(ContourCamera(), ViewFrom(eye), 0, elements), is_limited);
  }
  std::array<int, 4> quadrants = {};
  const RigidTransform pose = ViewFrom(eye);
  for (const EdgeElement& element : few) {
    EXPECT_EQ(element.prior_contrast, 1.0f);
    const Eigen::Vector3d middle = pose * Eigen::Vector3d(0.5 * (element.p1 + element.p2));
    ++quadrants[(middle.x() > 0.0) + 2 * (middle.y() > 0.0)];
  }
  for (const int count : quadrants) EXPECT_GE(count, 2);
}

// The plate is 300 px wide.
TEST(CreasesTest, RimsOfTessellatedHolesAreTheirCircles) {
  for (const int facets : {16, 24, 48, 120}) {
    const ObjectModel shape = PlateWithHoles(0.06, kHoleM, kThicknessM, facets, {0.0});
    RawMesh mesh;
    mesh.points = shape.vertices;
    mesh.triangles = shape.triangles;
    const absl::StatusOr<ObjectModel> plate = BuildObjectModel(mesh, {});
    ASSERT_TRUE(plate.ok()) << plate.status();
    for (const Eigen::Vector3d& eye : {Eigen::Vector3d(0, 0, 0.4), Eigen::Vector3d(0.2, 0.1, 0.33)}) {
      for (const double sagitta_px : {0.06, 0.25}) {
        EdgeElementOptions options;
        options.sagitta_px = sagitta_px;
        double sum_px = 0.0, length_m = 0.0;
        int count = 0;
        for (const EdgeElement& element : ElementsOf(*plate, eye, options)) {
          const Eigen::Vector3d middle = 0.5 * (element.p1 + element.p2);
          if (std::abs(middle.z()) > 1e-6 || middle.norm() > 1.1 * kHoleM) continue;
          length_m += (element.p2 - element.p1).norm();
          for (const Eigen::Vector3d& point : SamplesOf(element)) {
            const double distance_px = FromCirclePx(point, 0.0, kHoleM, eye);
            EXPECT_NEAR(distance_px, 0.0, 0.8 * sagitta_px) << facets;
            sum_px += distance_px;
            ++count;
          }
        }
        EXPECT_NEAR(sum_px / count, 0.0, 0.02) << facets;
        EXPECT_NEAR(length_m / (2.0 * std::numbers::pi * kHoleM), 1.0, 0.15) << facets;
      }
    }
  }
}

TEST(CreasesTest, CoarserLevelsHaveFewerElements) {
  ObjectModel disc;
  disc.curves.push_back(RingCurve({0, 0, 0}, 0.05, 64, {0, 0, 1}, 1.0));
  disc.diameter_m = 0.1;
  const TriangleBvh faces(disc.vertices, disc.triangles);
  const EdgeElementExtractor extractor(disc, faces, {});
  std::vector<EdgeElement> elements;
  for (const auto& [level, count] : {std::pair(0, 64u), std::pair(10, 32u), std::pair(13, 16u)}) {
    extractor.Extract(ContourCamera(), ViewFrom({0, 0, 0.8}), level, elements);
    EXPECT_EQ(elements.size(), count) << level;
  }
}

TEST(CreasesTest, OctantsAreCentredOnTheAxes) {
  for (int i = 0; i < 64; ++i) {
    const double turn = (i + 0.5) / 64.0;
    EXPECT_EQ(ImageOctant(OnCircle(turn)), static_cast<int>(std::floor(8.0 * turn + 0.5)) % 8) << i;
  }
}

}  // namespace
}  // namespace evpose
