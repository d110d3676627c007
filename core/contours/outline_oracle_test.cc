// SPDX-License-Identifier: Apache-2.0

// Compares the elements and the visible parts of the straight lines with the discontinuities of a depth image that is
// rendered with 8 x 8 samples per pixel.
#include <gtest/gtest.h>

#include <array>
#include <limits>
#include <utility>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/contours/edge_elements.h"
#include "core/models/visibility.h"

namespace evpose {
namespace {

constexpr int kSamples = 8;      // per pixel along each axis
constexpr double kJumpM = 0.01;  // a difference of depth between neighbouring samples that is an edge
// Cosine of the angle between the normals of neighbouring samples beyond which there is a crease: 23 degrees. The
// facets of the curved surfaces in this file turn by less than 6 degrees.
constexpr float kCreaseCosine = 0.92f;

class DepthImage {
 public:
  explicit DepthImage(const CameraModel& camera)
      : width_(camera.width_px * kSamples),
        height_(camera.height_px * kSamples),
        inverse_(static_cast<size_t>(width_) * height_, 0.0f),
        triangle_(inverse_.size(), 0) {}

  void Draw(const CameraModel& camera, const RigidTransform& pose, const ObjectModel& model) {
    for (const auto& corners : model.triangles) {
      const auto side = [&](int k) { return Eigen::Vector3d(model.vertices[corners[k]] - model.vertices[corners[0]]); };
      normals_.push_back(side(1).cross(side(2)).normalized().cast<float>());
      std::array<Eigen::Vector3d, 3> p;  // column, row, inverse depth
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector3d point = pose * model.vertices[corners[k]];
        const Eigen::Vector2d pixel = camera.Project(point);
        p[k] = {(pixel.x() + 0.5) * kSamples - 0.5, (pixel.y() + 0.5) * kSamples - 0.5, 1.0 / point.z()};
      }
      Fill(p);
    }
  }

  // Middles of the sides between samples where the depth jumps, or where the surface turns, pixels.
  std::vector<Eigen::Vector2d> Edges() const {
    std::vector<Eigen::Vector2d> edges;
    const auto jumps = [&](int first, int second) {
      const float a = inverse_[first], b = inverse_[second];
      if (a == 0.0f || b == 0.0f) return a != b;
      return std::abs(1.0f / a - 1.0f / b) > kJumpM ||
             normals_[triangle_[first]].dot(normals_[triangle_[second]]) < kCreaseCosine;
    };
    const auto pixel = [](double sample) { return (sample + 0.5) / kSamples - 0.5; };
    for (int y = 0; y + 1 < height_; ++y) {
      for (int x = 0; x + 1 < width_; ++x) {
        const int sample = y * width_ + x;
        if (jumps(sample, sample + 1)) edges.emplace_back(pixel(x + 0.5), pixel(y));
        if (jumps(sample, sample + width_)) edges.emplace_back(pixel(x), pixel(y + 0.5));
      }
    }
    return edges;
  }

 private:
  void Fill(const std::array<Eigen::Vector3d, 3>& p) {
    const auto cross = [](const Eigen::Vector3d& a, const Eigen::Vector3d& b, double x, double y) {
      return (b.x() - a.x()) * (y - a.y()) - (b.y() - a.y()) * (x - a.x());
    };
    const double area = cross(p[0], p[1], p[2].x(), p[2].y());
    if (area == 0.0) return;
    const auto [x1, x2] = std::minmax({p[0].x(), p[1].x(), p[2].x()});
    const auto [y1, y2] = std::minmax({p[0].y(), p[1].y(), p[2].y()});
    for (int y = std::max(0, static_cast<int>(std::ceil(y1))); y <= std::min<double>(y2, height_ - 1); ++y) {
      for (int x = std::max(0, static_cast<int>(std::ceil(x1))); x <= std::min<double>(x2, width_ - 1); ++x) {
        const double a = cross(p[1], p[2], x, y) / area, b = cross(p[2], p[0], x, y) / area, c = 1.0 - a - b;
        if (a < 0.0 || b < 0.0 || c < 0.0) continue;
        const auto inverse = static_cast<float>(a * p[0].z() + b * p[1].z() + c * p[2].z());
        if (inverse <= inverse_[y * width_ + x]) continue;
        inverse_[y * width_ + x] = inverse;
        triangle_[y * width_ + x] = static_cast<uint32_t>(normals_.size() - 1);
      }
    }
  }

  int width_, height_;
  std::vector<float> inverse_;      // of the depth; 0: background
  std::vector<uint32_t> triangle_;  // index into normals_, if there is no background
  std::vector<Eigen::Vector3f> normals_;
};

// Points by pixel, to find the nearest one within a pixel.
class PointGrid {
 public:
  PointGrid(const CameraModel& camera, const std::vector<Eigen::Vector2d>& points)
      : width_(camera.width_px + 4), cells_(static_cast<size_t>(width_) * (camera.height_px + 4)) {
    for (const Eigen::Vector2d& point : points) cells_[CellOf(point)].push_back(point);
  }

  double Distance(const Eigen::Vector2d& point) const {
    double least = std::numeric_limits<double>::infinity();
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        for (const Eigen::Vector2d& other : cells_[CellOf(point + Eigen::Vector2d(dx, dy))]) {
          least = std::min(least, (other - point).norm());
        }
      }
    }
    return least;
  }

 private:
  size_t CellOf(const Eigen::Vector2d& point) const {
    return static_cast<size_t>(std::floor(point.y()) + 2.0) * width_ + static_cast<size_t>(std::floor(point.x()) + 2.0);
  }

  int width_;
  std::vector<std::vector<Eigen::Vector2d>> cells_;
};

ObjectModel Joined(ObjectModel a, const ObjectModel& b, const Eigen::Vector3d& shift) {
  const auto first = static_cast<uint32_t>(a.vertices.size());
  const auto first_region = static_cast<uint32_t>(a.surface.regions.size());
  for (const Eigen::Vector3d& vertex : b.vertices) a.vertices.push_back(vertex + shift);
  for (auto corners : b.triangles) {
    for (uint32_t& corner : corners) corner += first;
    a.triangles.push_back(corners);
  }
  for (const uint32_t region : b.surface.region_of) a.surface.region_of.push_back(region + first_region);
  a.surface.normals.insert(a.surface.normals.end(), b.surface.normals.begin(), b.surface.normals.end());
  for (SurfaceRegion region : b.surface.regions) {
    region.point += shift;
    a.surface.regions.push_back(region);
  }
  a.diameter_m = std::max(a.diameter_m, shift.norm() + 0.5 * (a.diameter_m + b.diameter_m));
  return a;
}

// Outline of a bracket in the x-y plane, counter-clockwise: two legs with a width of 50 mm and a length of 120 mm. The
// outer corner is rounded with a radius of 20 mm, and the corner between the legs has a fillet of 30 mm.
std::vector<Eigen::Vector2d> BracketProfile() {
  constexpr int kArcFacets = 24;
  constexpr double kWidthM = 0.05, kLengthM = 0.12, kRoundM = 0.02, kFilletM = 0.03, kStepM = 0.01;
  std::vector<Eigen::Vector2d> points;
  // Each adds the points from the latest one on, which is the end of the part before.
  const auto add_straight = [&](const Eigen::Vector2d& end) {
    const Eigen::Vector2d begin = points.back();
    const int count = static_cast<int>(std::ceil((end - begin).norm() / kStepM));
    for (int i = 1; i <= count; ++i) points.emplace_back(begin + static_cast<double>(i) / count * (end - begin));
  };
  const auto add_arc = [&](const Eigen::Vector2d& centre, double radius_m, double begin_turn, double turn) {
    for (int i = 1; i <= kArcFacets; ++i) {
      points.emplace_back(centre + radius_m * OnCircle(begin_turn + turn * i / kArcFacets));
    }
  };
  points.emplace_back(kRoundM, 0.0);
  add_straight({kLengthM, 0.0});
  add_straight({kLengthM, kWidthM});
  add_straight({kWidthM + kFilletM, kWidthM});
  add_arc(Eigen::Vector2d::Constant(kWidthM + kFilletM), kFilletM, 0.75, -0.25);
  add_straight({kWidthM, kLengthM});
  add_straight({0.0, kLengthM});
  add_straight({0.0, kRoundM});
  add_arc(Eigen::Vector2d::Constant(kRoundM), kRoundM, 0.5, 0.25);
  points.pop_back();  // it equals the first one
  return points;
}

// The bracket with a thickness of 60 mm along z and a hole through its corner, as a CAD program exports it: triangles
// without normals, from which the model's lines, curves and surface follow.
ObjectModel Bracket() {
  constexpr size_t kHoleFacets = 96;
  constexpr double kBoreM = 0.015, kHalfThicknessM = 0.03;
  const Eigen::Vector2d hole_centre(0.025, 0.025), middle(0.05, 0.05);
  const std::vector<Eigen::Vector2d> profile = BracketProfile();
  const auto turn_of = [&](const Eigen::Vector2d& point) {
    return std::atan2(point.y() - hole_centre.y(), point.x() - hole_centre.x()) / (2.0 * std::numbers::pi);
  };
  const double first_turn = turn_of(profile[0]);
  std::array<std::vector<Eigen::Vector2d>, 2> rings = {profile, {}};
  // Turns of the points about the hole, from the first one on: they increase along both rings.
  std::array<std::vector<double>, 2> turns;
  for (const Eigen::Vector2d& point : profile) {
    const double turn = turn_of(point) - first_turn;
    turns[0].push_back(turn - std::floor(turn));
  }
  for (size_t i = 0; i < kHoleFacets; ++i) {
    turns[1].push_back(static_cast<double>(i) / kHoleFacets);
    rings[1].emplace_back(hole_centre + kBoreM * OnCircle(first_turn + turns[1].back()));
  }
  RawMesh mesh;
  for (const double z : {-kHalfThicknessM, kHalfThicknessM}) {
    for (const auto& ring : rings) {
      for (const Eigen::Vector2d& p : ring) mesh.points.emplace_back(p.x() - middle.x(), p.y() - middle.y(), z);
    }
  }
  const auto index = [&](int side, int ring, size_t i) {
    const size_t first = side * (profile.size() + kHoleFacets) + ring * profile.size();
    return static_cast<uint32_t>(first + i % rings[ring].size());
  };
  for (int ring = 0; ring < 2; ++ring) {
    for (size_t i = 0; i < rings[ring].size(); ++i) {
      const std::array below = {index(0, ring, i), index(0, ring, i + 1)};
      const std::array above = {index(1, ring, i), index(1, ring, i + 1)};
      mesh.triangles.push_back({below[ring], below[1 - ring], above[1 - ring]});
      mesh.triangles.push_back({below[ring], above[1 - ring], above[ring]});
    }
  }
  for (const int side : {0, 1}) {
    for (size_t i = 0, j = 0; i < profile.size() || j < kHoleFacets;) {
      const bool is_outer = j == kHoleFacets || (i + 1 < profile.size() && turns[0][i + 1] < (j + 1.0) / kHoleFacets);
      const std::array triangle = {index(side, 0, i), is_outer ? index(side, 0, i + 1) : index(side, 1, j + 1),
                                   index(side, 1, j)};
      mesh.triangles.push_back({triangle[0], triangle[side == 1 ? 1 : 2], triangle[side == 1 ? 2 : 1]});
      ++(is_outer ? i : j);
    }
  }
  return BuildObjectModel(mesh, {}).value();
}

void CompareWithDepth(const ObjectModel& model, const Eigen::Vector3d& eye, const char* name) {
  const CameraModel camera = ContourCamera();
  const RigidTransform pose = ViewFrom(eye);
  DepthImage image(camera);
  image.Draw(camera, pose, model);
  const std::vector<Eigen::Vector2d> edges = image.Edges();
  ASSERT_GT(edges.size(), 1000u);
  std::vector<Eigen::Vector2d> samples;
  const auto add_samples = [&](const Eigen::Vector3d& point1, const Eigen::Vector3d& point2) {
    const Eigen::Vector2d p1 = camera.Project(pose * point1), p2 = camera.Project(pose * point2);
    const int count = static_cast<int>(std::ceil((p2 - p1).norm() / 0.25));
    for (int i = 0; i < count; ++i) samples.emplace_back(p1 + (i + 0.5) / count * (p2 - p1));
  };
  for (const EdgeElement& element : ElementsOf(model, eye)) add_samples(element.p1, element.p2);
  for (const VisibleSegment& part : VisibilityTester(model, {}).VisibleSegments(camera, pose)) {
    const ModelLine& line = model.lines[part.line];
    const Eigen::Vector3d along = line.p2 - line.p1;
    add_samples(line.p1 + part.begin * along, line.p1 + part.end * along);
  }
  const PointGrid edge_grid(camera, edges), sample_grid(camera, samples);
  std::vector<double> distances_px;
  for (const Eigen::Vector2d& sample : samples) distances_px.push_back(edge_grid.Distance(sample));
  const auto is_false = [](double distance_px) { return distance_px > 1.0; };
  const auto num_false = std::count_if(distances_px.begin(), distances_px.end(), is_false);
  EXPECT_LT(static_cast<double>(num_false), 0.02 * static_cast<double>(samples.size())) << name;
  std::erase_if(distances_px, is_false);
  EXPECT_LT(Quantile(distances_px, 0.95), 0.15) << name;
  const auto num_found = std::count_if(edges.begin(), edges.end(),
                                       [&](const Eigen::Vector2d& edge) { return sample_grid.Distance(edge) <= 1.0; });
  EXPECT_GT(static_cast<double>(num_found), 0.95 * static_cast<double>(edges.size())) << name;
}

TEST(OutlineOracleTest, Torus) {
  const ObjectModel torus = TorusModel(0.1, 0.04, 320, 160);
  CompareWithDepth(torus, {0.0, 0.05, 0.6}, "from above");
  CompareWithDepth(torus, {0.45, 0.1, 0.35}, "oblique");
  CompareWithDepth(torus, {0.6, 0.1, 0.1}, "from the side");
}

TEST(OutlineOracleTest, Capsule) {
  const ObjectModel capsule = CapsuleModel(0.06, 0.05, 320, 199);
  CompareWithDepth(capsule, {0.4, 0.1, 0.1}, "from the side");
  CompareWithDepth(capsule, {0.2, 0.1, 0.4}, "oblique");
}

TEST(OutlineOracleTest, CylinderWithItsCreases) {
  CompareWithDepth(CylinderModel(0.08, 0.05, 720), {0.5, 0.1, 0.0}, "from the side");
}

TEST(OutlineOracleTest, SphereBehindATorus) {
  const ObjectModel scene = Joined(TorusModel(0.1, 0.04, 320, 160), SphereModel(0.08, 320, true), {0.03, 0.02, -0.2});
  CompareWithDepth(scene, {0.05, 0.1, 0.6}, "through the hole");
  CompareWithDepth(scene, {0.4, 0.1, 0.4}, "beside");
}

TEST(OutlineOracleTest, BracketWithAHoleAndFillets) {
  const ObjectModel bracket = Bracket();
  // The sharp edges alone: where a fillet begins, the surface continues.
  EXPECT_EQ(bracket.lines.size(), 16u) << "six around each face, and four corners";
  EXPECT_EQ(bracket.curves.size(), 6u) << "the rims of the hole and the arcs around each face";
  CompareWithDepth(bracket, {0.03, 0.05, 0.6}, "through the hole");
  CompareWithDepth(bracket, {-0.4, -0.3, 0.3}, "onto the round corner");
  CompareWithDepth(bracket, {0.4, 0.3, 0.3}, "onto the fillet");
  CompareWithDepth(bracket, {-0.5, 0.2, -0.1}, "from the side");
}

}  // namespace
}  // namespace evpose
