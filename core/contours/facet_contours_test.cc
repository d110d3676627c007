// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/contours/edge_elements.h"
#include "core/contours/facet_outline_testing.h"

namespace evpose {
namespace {

using Points = std::vector<Eigen::Vector2d>;

// Rounding of the vertices to single precision, in pixels.
constexpr double kRoundingPx = 0.01;

std::vector<EdgeElement> ContoursOf(const ObjectModel& model, const Eigen::Vector3d& eye) {
  std::vector<EdgeElement> elements = ElementsOf(model, eye);
  std::erase_if(elements, [](const EdgeElement& element) { return element.kind != EdgeKind::kContour; });
  return elements;
}

TEST(FacetContoursTest, LimbsOfAFacetedCylinderAreTwoOfItsEdges) {
  const ObjectModel model = WithFacets(CylinderModel(0.08, 0.05, 32));
  EXPECT_EQ(model.facet_edges.size(), 32u) << "no diagonal of a flat side, and no edge of the rims, which are lines";
  EXPECT_EQ(model.lines.size(), 64u);
  for (const Eigen::Vector3d& eye : {Eigen::Vector3d(0.5, 0.1, 0.1), Eigen::Vector3d(0.3, 0.3, 0.35)}) {
    const std::vector<EdgeElement> contours = ContoursOf(model, eye);
    const Points outline = OutlineOfVertices(model, ViewFrom(eye), ContourCamera());
    double length_m = 0.0;
    for (const EdgeElement& element : contours) {
      EXPECT_EQ(element.prior_contrast, 1.0f);
      length_m += (element.p2 - element.p1).norm();
      EXPECT_NEAR((element.p2 - element.p1).normalized().cross(Eigen::Vector3d::UnitZ()).norm(), 0.0, 1e-6);
      for (const Eigen::Vector3d& point : SamplesOf(element)) {
        EXPECT_LT(DistanceFrom(outline, ContourCamera().Project(ViewFrom(eye) * point)), kRoundingPx);
      }
    }
    EXPECT_NEAR(length_m, 2 * 0.16, 1e-3);
  }
}

TEST(FacetContoursTest, OutlineOfAConvexPolyhedronIsCovered) {
  for (const int count : {16, 40, 120}) {
    ModelOptions options;
    options.crease_angle_deg = 40.0;
    const ObjectModel model = WithFacets(SphereModel(0.1, count, false), options);
    EXPECT_TRUE(model.lines.empty());
    const Eigen::Vector3d eye(0.2, 0.3, 0.4);
    const std::vector<EdgeElement> contours = ContoursOf(model, eye);
    const Points outline = OutlineOfVertices(model, ViewFrom(eye), ContourCamera());
    double perimeter_px = 0.0;
    for (size_t i = 0; i < outline.size(); ++i) {
      perimeter_px += (outline[(i + 1) % outline.size()] - outline[i]).norm();
    }
    EXPECT_NEAR(LengthPx(contours, EdgeKind::kContour, eye) / perimeter_px, 1.0, 0.01) << count;
    for (const EdgeElement& element : contours) {
      for (const Eigen::Vector3d& point : SamplesOf(element)) {
        EXPECT_LT(DistanceFrom(outline, ContourCamera().Project(ViewFrom(eye) * point)),
                  EdgeElementOptions().sagitta_px)
            << count;
      }
    }
  }
}

TEST(FacetContoursTest, AnEdgeIsAContourUntilBothFacetsFaceTheCamera) {
  const ObjectModel model = WithFacets(CylinderModel(0.08, 0.05, 32));
  const TriangleBvh faces(model.vertices, model.triangles);
  const EdgeElementExtractor extractor(model, faces, {});
  const auto eye_at = [](double angle_rad) {
    return Eigen::Vector3d(0.5 * std::cos(angle_rad), 0.5 * std::sin(angle_rad), 0.0);
  };
  const Eigen::Vector3d eye = eye_at(0.0);
  const std::vector<EdgeElement> contours = ContoursOf(model, eye);
  ASSERT_FALSE(contours.empty());
  for (const EdgeElement& element : contours) {
    ASSERT_NE(element.facet_edge, EdgeElement::kNoFacetEdge);
    EXPECT_EQ(extractor.FacetShiftPx(element, eye, 700.0), 0.0);
    EdgeElement slid = element;
    SlideContour(eye_at(0.02), slid);
    EXPECT_EQ(slid.p1, element.p1) << "the edge is fixed to the object";
    EXPECT_EQ(slid.p2, element.p2);
    // A facet is as wide as 0.0098 m, 14 px at 0.5 m; after a turn by its angle it is seen at that angle.
    const double shift_px = std::max(extractor.FacetShiftPx(element, eye_at(0.196), 700.0),
                                     extractor.FacetShiftPx(element, eye_at(-0.196), 700.0));
    EXPECT_GT(shift_px, 0.5);
    EXPECT_LT(shift_px, 14.0 * 0.196);
  }
}

TEST(FacetContoursTest, ModelsWithoutFacetsHaveNone) {
  EXPECT_TRUE(SphereModel(0.1, 24, true).facet_edges.empty());
  EXPECT_TRUE(WithFacets(CylinderModel(0.08, 0.05, 8)).facet_edges.empty()) << "the sides are creases";
}

}  // namespace
}  // namespace evpose
