// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/region_parts.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "core/base/yield_point.h"
#include "core/mesh/mesh_edges.h"
#include "core/mesh/region_shapes.h"
#include "core/mesh/shape_fit.h"

namespace evpose {
namespace {

// Distance of vertices from the plane, relative to the diameter: above the rounding of files, and so small that a part
// of kMinPlaneWidth which is not flat has a radius of 10 diameters, by w^2 / (8 r) < kPlaneFlatness.
constexpr double kPlaneFlatness = 5e-6;
// Relative to the diameter: 6 px at an object size of 300 px. Narrower parts do not matter.
constexpr double kMinPlaneWidth = 0.02;
// Area of a part relative to that of the triangles beside it across smooth edges. A facet of an evenly tessellated
// cylinder is a plane and a ring of a vase is a cone; both have 1, or 2 at the end of the surface.
constexpr double kMinAreaRatio = 4.0;
// The plane of one small triangle is inaccurate far from it; each further round uses the plane of the part found.
constexpr int kPlaneRounds = 3, kCurvedRounds = 3;
// Bounds the time when many seeds reach the same triangles; regular meshes need 3 for each of 3 rounds.
constexpr size_t kMaxVisitsPerTriangle = 32;

// Curved parts of a region of several shapes: distance of vertices, relative to the diameter. Those of CAD models lie
// on their surface; a larger tolerance would add the first strip of the next fillet.
constexpr double kOnCurvedPart = 2e-5;
// Their least width relative to the diameter, and area relative to its square. A bent tube is a cylinder within the
// tolerance over a width of less than that, unless the radius of the bend is 10 diameters.
constexpr double kMinCurvedWidth = 0.04, kMinCurvedArea = 5e-3;
// Largest length of the mean normal of a curved part: that of an arc of 45 degrees.
constexpr double kMaxMeanNormal = 0.974;
// Normals of a facet and of the shape at its centroid: those of a cylinder of 8 sides differ by less (30 degrees).
constexpr double kMinCurvedCosine = 0.866;
// A first fit needs some strips; large parts that are found from few of them are fitted again.
constexpr size_t kCoreTriangles = 24;
// A core consists of facets of similar size, without the narrow strips of a fillet at their ends.
constexpr double kMinCoreArea = 0.25, kMinCoreEdge = 0.5;
// Bounds the time; the largest facets are tried first, because the largest errors are those of their normals.
constexpr size_t kMaxCurvedSeeds = 65;
// Difference of the normals of two shapes at a common border (3 degrees). Where they jump by more, a contour could not
// cross the border; one of the two then stays without a shape, and its mean normals are continuous.
constexpr double kMaxJump = 0.05;

constexpr uint32_t kNoTriangle = ~0u;

class PartFinder {
 public:
  PartFinder(const RawMesh& mesh, absl::Span<const uint32_t> triangles, double diameter_m)
      : mesh_(mesh), diameter_m_(diameter_m), triangles_(triangles.begin(), triangles.end()) {
    std::vector<std::array<uint32_t, 3>> corners;
    for (const uint32_t t : triangles_) {
      corners.push_back(mesh.triangles[t]);
      facets_.push_back(FacetOf(mesh, t));
    }
    neighbours_.assign(triangles_.size(), {kNoTriangle, kNoTriangle, kNoTriangle});
    ForEachEdge(SortedEdgeUses(corners), [this](absl::Span<const EdgeUse> uses) {
      if (uses.size() != 2 || uses[0].is_forward == uses[1].is_forward) return;
      neighbours_[uses[0].triangle][uses[0].side] = uses[1].triangle;
      neighbours_[uses[1].triangle][uses[1].side] = uses[0].triangle;
    });
    stamp_.assign(triangles_.size(), 0);
    state_.assign(triangles_.size(), State::kUnseen);
    part_of_.assign(triangles_.size(), 0);
  }

  std::vector<RegionPart> Find() {
    const std::vector<uint32_t> seeds = Seeds();
    FindPlanes(seeds);
    ResetSeeds();
    // A fillet between two faces.
    for (uint32_t t = 0; t < triangles_.size(); ++t) {
      if (state_[t] == State::kUnseen) TakeRest(t, /*only_shapes=*/true);
    }
    ResetSeeds();
    FindCurved(seeds);
    for (uint32_t t = 0; t < triangles_.size(); ++t) {
      if (state_[t] != State::kTaken) TakeRest(t, /*only_shapes=*/false);
    }
    return std::move(parts_);
  }

 private:
  // kSeen: in a part that was not accepted; another part may still take it, but it is not a seed.
  enum class State : uint8_t { kUnseen, kSeen, kTaken };
  struct Plane {
    Eigen::Vector3d point;
    Eigen::Vector3d normal;
  };

  // All triangles, the largest first.
  std::vector<uint32_t> Seeds() const {
    std::vector<uint32_t> seeds(triangles_.size());
    std::iota(seeds.begin(), seeds.end(), 0u);
    std::sort(seeds.begin(), seeds.end(), [this](uint32_t a, uint32_t b) {
      return facets_[a].area_m2 != facets_[b].area_m2 ? facets_[a].area_m2 > facets_[b].area_m2 : a < b;
    });
    return seeds;
  }
  bool IsSeed(uint32_t t) const { return state_[t] == State::kUnseen && facets_[t].area_m2 > 0.0; }
  bool IsBudgetSpent() const { return visits_ > kMaxVisitsPerTriangle * triangles_.size(); }

  void TakePart(std::vector<uint32_t> part, const SurfaceRegion& region) {
    std::sort(part.begin(), part.end());
    for (uint32_t& t : part) {
      state_[t] = State::kTaken;
      part_of_[t] = static_cast<uint32_t>(parts_.size());
      t = triangles_[t];
    }
    parts_.push_back({std::move(part), region});
  }
  void ResetSeeds() {
    visits_ = 0;
    for (State& state : state_) {
      if (state != State::kTaken) state = State::kUnseen;
    }
  }
  void MarkSeen(const std::vector<uint32_t>& part) {
    for (const uint32_t t : part) state_[t] = State::kSeen;
  }

  // The triangles that are connected with the seed through triangles for which `belongs` is true, at most `limit`.
  template <typename Belongs>  // bool(uint32_t from, int side, uint32_t to)
  std::vector<uint32_t> Grow(uint32_t seed, size_t limit, const Belongs& belongs) {
    ++current_stamp_;
    std::vector<uint32_t> part = {seed};
    stamp_[seed] = current_stamp_;
    for (size_t i = 0; i < part.size() && part.size() < limit; ++i) {
      for (int side = 0; side < 3; ++side) {
        const uint32_t next = neighbours_[part[i]][side];
        if (next == kNoTriangle || stamp_[next] == current_stamp_ || state_[next] == State::kTaken) continue;
        YieldPoint(++visits_);
        if (!belongs(part[i], side, next)) continue;
        stamp_[next] = current_stamp_;
        part.push_back(next);
      }
    }
    return part;
  }
  // Takes all triangles that are connected with this one, as one shape or, unless `only_shapes`, without a shape.
  void TakeRest(uint32_t seed, bool only_shapes) {
    std::vector<uint32_t> part = Grow(seed, triangles_.size(), [](uint32_t, int, uint32_t) { return true; });
    std::optional<SurfaceRegion> region;
    if (!parts_.empty()) region = Fit(part);  // else it is the whole region, which has no shape
    const bool is_shape = region.has_value() && JoinsSmoothly(part, *region);
    if (is_shape || !only_shapes) {
      TakePart(std::move(part), is_shape ? *region : SurfaceRegion());
    } else {
      MarkSeen(part);
    }
  }

  // Whether the normals at the borders with parts that have a shape are those of the other part.
  bool JoinsSmoothly(const std::vector<uint32_t>& part, const SurfaceRegion& region) const {
    for (const uint32_t t : part) {
      for (int side = 0; side < 3; ++side) {
        const uint32_t beside = neighbours_[t][side];
        if (beside == kNoTriangle || state_[beside] != State::kTaken) continue;
        const SurfaceRegion& other = parts_[part_of_[beside]].region;
        const Eigen::Vector3d& point = mesh_.points[mesh_.triangles[triangles_[t]][side]];
        if ((NormalOfShape(region, point) - NormalOfShape(other, point)).norm() > kMaxJump) return false;
      }
    }
    return true;
  }

  // --- Planes

  void FindPlanes(const std::vector<uint32_t>& seeds) {
    for (const uint32_t seed : seeds) {
      if (IsBudgetSpent()) break;
      if (!IsSeed(seed)) continue;
      const std::vector<uint32_t> part = GrowPlane(seed);
      const Plane plane = MeanPlane(part);
      if (IsWide(part, kMinPlaneWidth)) {
        TakePart(part, {.shape = RegionShape::kPlane, .point = plane.point, .axis = plane.normal});
      } else {
        MarkSeen(part);
      }
    }
  }

  std::vector<uint32_t> GrowPlane(uint32_t seed) {
    Plane plane = {facets_[seed].centroid, facets_[seed].normal};
    const auto lies_in = [&](uint32_t, int, uint32_t to) { return LiesIn(plane, to); };
    std::vector<uint32_t> part = Grow(seed, triangles_.size(), lies_in);
    for (int round = 1; round < kPlaneRounds && part.size() > 1; ++round) {
      plane = MeanPlane(part);
      std::vector<uint32_t> larger = Grow(seed, triangles_.size(), lies_in);
      if (larger.size() <= part.size()) break;
      part = std::move(larger);
    }
    return part;
  }

  bool LiesIn(const Plane& plane, uint32_t t) const {
    if (facets_[t].normal.dot(plane.normal) < 0.0) return false;  // 0: a triangle without area
    for (const uint32_t vertex : mesh_.triangles[triangles_[t]]) {
      const double distance = (mesh_.points[vertex] - plane.point).dot(plane.normal);
      if (std::abs(distance) > kPlaneFlatness * diameter_m_) return false;
    }
    return true;
  }

  Plane MeanPlane(const std::vector<uint32_t>& part) const {
    Plane plane = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    double area = 0.0;
    for (const uint32_t t : part) {
      plane.point += facets_[t].area_m2 * facets_[t].centroid;
      plane.normal += facets_[t].area_m2 * facets_[t].normal;
      area += facets_[t].area_m2;
    }
    return {plane.point / area, plane.normal.normalized()};
  }

  // Whether a part is wide in itself, and against the facets beside it.
  bool IsWide(const std::vector<uint32_t>& part, double min_width) {
    ++current_stamp_;
    for (const uint32_t t : part) stamp_[t] = current_stamp_;
    double area = 0.0, area_beside = 0.0, border_m = 0.0;
    for (const uint32_t t : part) {
      area += facets_[t].area_m2;
      for (int side = 0; side < 3; ++side) {
        const uint32_t beside = neighbours_[t][side];
        if (beside == kNoTriangle || stamp_[beside] == current_stamp_) continue;
        const std::array<uint32_t, 3>& corners = mesh_.triangles[triangles_[t]];
        border_m += (mesh_.points[corners[side]] - mesh_.points[corners[(side + 1) % 3]]).norm();
        area_beside += facets_[beside].area_m2;
      }
    }
    const double min_width_m = min_width * diameter_m_;
    return area >= min_width_m * min_width_m && 2.0 * area >= min_width_m * border_m &&
           area >= kMinAreaRatio * area_beside;
  }

  // --- Curved shapes

  void FindCurved(const std::vector<uint32_t>& seeds) {
    size_t tried = 0;
    for (const uint32_t seed : seeds) {
      if (IsBudgetSpent() || tried == kMaxCurvedSeeds || tried * kCoreTriangles > triangles_.size()) break;
      if (!IsSeed(seed)) continue;
      ++tried;
      std::vector<uint32_t> part = Grow(seed, kCoreTriangles, [&](uint32_t from, int side, uint32_t to) {
        return facets_[to].area_m2 >= kMinCoreArea * facets_[seed].area_m2 && IsLongSide(from, side);
      });
      MarkSeen(part);
      const auto region = GrowCurved(seed, part);
      if (region.has_value() && IsCurvedPart(part, *region)) TakePart(std::move(part), *region);
    }
  }

  // Fits a shape to the part and grows the part on it, until it stays.
  std::optional<SurfaceRegion> GrowCurved(uint32_t seed, std::vector<uint32_t>& part) {
    std::optional<SurfaceRegion> region = Fit(part);
    for (int round = 0; round < kCurvedRounds && region.has_value(); ++round) {
      std::vector<uint32_t> larger =
          Grow(seed, triangles_.size(), [&](uint32_t, int, uint32_t to) { return LiesOn(*region, to); });
      if (larger.size() <= part.size()) break;
      part = std::move(larger);
      region = Fit(part);
    }
    return region;
  }

  std::optional<SurfaceRegion> Fit(const std::vector<uint32_t>& part) const {
    std::vector<uint32_t> in_mesh;
    for (const uint32_t t : part) in_mesh.push_back(triangles_[t]);
    return FitShape(mesh_, in_mesh, ShapeChoice::kCurved, diameter_m_);
  }

  bool LiesOn(const SurfaceRegion& region, uint32_t t) const {
    const FacetGeometry& facet = facets_[t];
    if (facet.area_m2 > 0.0 && facet.normal.dot(NormalOfShape(region, facet.centroid)) < kMinCurvedCosine) return false;
    for (const uint32_t vertex : mesh_.triangles[triangles_[t]]) {
      const Eigen::Vector3d& point = mesh_.points[vertex];
      if (!((ProjectToShape(region, point) - point).norm() <= kOnCurvedPart * diameter_m_)) return false;
    }
    return true;
  }

  bool IsLongSide(uint32_t t, int side) const {
    const std::array<uint32_t, 3>& corners = mesh_.triangles[triangles_[t]];
    std::array<double, 3> lengths;
    for (int i = 0; i < 3; ++i) lengths[i] = (mesh_.points[corners[(i + 1) % 3]] - mesh_.points[corners[i]]).norm();
    return lengths[side] >= kMinCoreEdge * std::max({lengths[0], lengths[1], lengths[2]});
  }

  // Whether a part is large and bends.
  bool IsCurvedPart(const std::vector<uint32_t>& part, const SurfaceRegion& region) {
    double area = 0.0;
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    for (const uint32_t t : part) {
      if (!LiesOn(region, t)) return false;
      area += facets_[t].area_m2;
      normal += facets_[t].area_m2 * facets_[t].normal;
    }
    return area >= kMinCurvedArea * diameter_m_ * diameter_m_ && normal.norm() <= kMaxMeanNormal * area &&
           IsWide(part, kMinCurvedWidth) && JoinsSmoothly(part, region);
  }

  const RawMesh& mesh_;
  const double diameter_m_;
  const std::vector<uint32_t> triangles_;
  std::vector<FacetGeometry> facets_;
  std::vector<std::array<uint32_t, 3>> neighbours_;
  std::vector<uint32_t> stamp_;
  std::vector<State> state_;
  std::vector<uint32_t> part_of_;  // index into `parts_` of a triangle that is taken
  uint32_t current_stamp_ = 0;
  size_t visits_ = 0;
  std::vector<RegionPart> parts_;
};

}  // namespace

std::vector<RegionPart> FindRegionParts(const RawMesh& mesh, absl::Span<const uint32_t> triangles, double diameter_m) {
  return PartFinder(mesh, triangles, diameter_m).Find();
}

}  // namespace evpose
