// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/crease_edges.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <optional>
#include <utility>

#include "absl/types/span.h"
#include "core/mesh/edge_chains.h"
#include "core/numerics/math.h"

namespace evpose {
namespace {

// The constants below were chosen on public CAD models and scans (core/mesh/README.md, section 8). Shares of the
// crease angle: least turn of the two triangles themselves, and least jump of an edge that continues a crease.
constexpr double kMinTurnShare = 0.6;
constexpr double kContinuedShare = 2.0 / 3.0;
// Scale test: length of the path, relative to the diameter: 6 px at 300 px.
constexpr double kPathShare = 0.02;
// Part of each of the two lengths, beside the edge, that is not used (core/mesh/README.md, section 8, test 3).
constexpr double kSkippedShare = 0.1;
// Tessellation test. The outermost facet of a fillet turns by half a step; 0.6 degrees allow for roundings.
constexpr double kStepRatio = 2.0, kStepTolerance = 0.6 * kRadiansPerDegree;
// Largest distance between the facets and the surface, relative to the diameter: 1.2 px at 300 px.
constexpr double kMaxSagitta = 0.004;
// CAD programs turn by less between facets. A path of the scale test ends at a sharper edge, beyond which there is the
// other side of a thin wall or of a chamfer.
constexpr double kMaxStep = 40.0 * kRadiansPerDegree;
// Edges that turn by less are diagonals of flat or nearly flat quadrilaterals.
constexpr double kLeastTurn = 0.3 * kRadiansPerDegree;
// Jump of exact normals and of normals in the file at a crease, and the largest difference of equal ones. A crease
// angle outside this range replaces the jump.
constexpr double kMinStatedJump = 10.0 * kRadiansPerDegree, kSameStated = 1.0 * kRadiansPerDegree;
constexpr double kMaxCreaseForStatedJump = 30.0 * kRadiansPerDegree;
// A crease shorter than this, relative to the diameter, of which an end meets no other edge is noise of the mesh.
constexpr double kMinDeadEnd = 0.02;
// Largest turn, as a cosine, between a crease and the edge that continues it: 60 degrees.
constexpr double kContinuedCosine = 0.5;
// More triangles at one edge are not listed: bounds the time.
constexpr size_t kMaxTriangles = 32;
// Triangles that all paths together may cross; bounds the time (core/mesh/README.md, section 16).
constexpr int64_t kMaxWork = 40'000'000;

enum class EdgeClass : uint8_t { kSmooth, kWeak, kCrease };

// Whether the facets continue across the edge. Wings serve for any winding and any number of faces, unlike normals.
bool HaveSmoothWings(const RawMesh& mesh, absl::Span<const EdgeUse> uses, double crease_cosine) {
  const Eigen::Vector3d first = WingOf(mesh, uses[0]);
  bool has_opposite = false;
  for (const EdgeUse& use : uses.subspan(1)) {
    const double cosine = first.dot(WingOf(mesh, use));
    if (std::abs(cosine) < crease_cosine) return false;
    has_opposite |= cosine < 0.0;
  }
  return has_opposite;
}

// The jump of stated normals from which an edge is a crease. Such normals have no tessellation, so that the default of
// the crease angle, which allows for one, would miss creases; another angle is what the user wants to see.
double StatedJump(double crease_rad) {
  const bool is_chosen = crease_rad < kMinStatedJump || crease_rad > kMaxCreaseForStatedJump;
  return is_chosen ? crease_rad : kMinStatedJump;
}

class CreaseFinder {
 public:
  CreaseFinder(const FacetGraph& graph, const CreaseOptions& options, double diameter_m)
      : graph_(graph),
        mesh_(graph.mesh()),
        crease_rad_(options.crease_angle_deg * kRadiansPerDegree),
        crease_cosine_(DeterministicSinCos(crease_rad_).cos),
        stated_jump_rad_(StatedJump(crease_rad_)),
        is_smooth_(options.is_smooth),
        diameter_m_(diameter_m),
        exact_segments_(ExactSegments(graph.mesh())) {}

  std::vector<MeshEdge> Find() {
    ForEachEdge(graph_.uses(), [this](absl::Span<const EdgeUse> uses) {
      std::vector<EdgeUse> neighbours;
      if (uses.size() > 2) {
        std::copy_if(uses.begin(), uses.end(), std::back_inserter(neighbours), [this](const EdgeUse& use) {
          return graph_.opposite(3 * use.triangle + use.side) != FacetGraph::kNone;
        });
        if (!neighbours.empty()) uses = neighbours;
      }
      const EdgeClass edge_class = Classify(uses);
      if (edge_class == EdgeClass::kSmooth) return;
      classes_.push_back(edge_class);
      edges_.push_back(Edge(uses));
    });
    if (is_smooth_) {
      ContinueCreases();
      DropDeadEnds();
    }
    size_t kept = 0;
    for (size_t e = 0; e < edges_.size(); ++e) {
      if (classes_[e] != EdgeClass::kCrease) continue;
      if (kept != e) edges_[kept] = std::move(edges_[e]);
      ++kept;
    }
    edges_.resize(kept);
    return std::move(edges_);
  }

 private:
  MeshEdge Edge(absl::Span<const EdgeUse> uses) const {
    MeshEdge edge;
    edge.ends = {uses[0].low, uses[0].high};
    for (const EdgeUse& use : uses.first(std::min(uses.size(), kMaxTriangles))) edge.triangles.push_back(use.triangle);
    if (uses.size() == 1) {
      edge.kind = EdgeKind::kBoundary;
    } else {
      edge.turn_rad = AngleBetween(graph_.normal(uses[0].triangle), graph_.normal(uses[1].triangle));
    }
    return edge;
  }

  EdgeClass Classify(absl::Span<const EdgeUse> uses) {
    if (uses.size() == 1) return EdgeClass::kCrease;
    const uint32_t side = 3 * uses[0].triangle + uses[0].side;
    if (!is_smooth_ || graph_.opposite(side) == FacetGraph::kNone) {
      return HaveSmoothWings(mesh_, uses, crease_cosine_) ? EdgeClass::kSmooth : EdgeClass::kCrease;
    }
    if (!mesh_.exact_surface.empty()) return ClassifyExact(uses);
    const double turn = std::abs(graph_.turn_rad(side));
    if (!mesh_.corner_normals.empty()) {
      if (const auto stated = StatedByNormals(uses, turn); stated.has_value()) return *stated;
    }
    if (turn <= kMinTurnShare * kContinuedShare * crease_rad_) return EdgeClass::kSmooth;
    const double jump = Jump(side);
    if (jump <= kContinuedShare * crease_rad_ || IsTessellation(side, turn)) return EdgeClass::kSmooth;
    return jump > crease_rad_ && turn > kMinTurnShare * crease_rad_ ? EdgeClass::kCrease : EdgeClass::kWeak;
  }

  // The normals at the lower and the higher vertex of the edge.
  static std::array<Eigen::Vector3d, 2> NormalsAt(const EdgeUse& use,
                                                  const std::vector<std::array<Eigen::Vector3f, 3>>& normals) {
    const auto& corners = normals[use.triangle];
    const Eigen::Vector3d from = corners[use.side].cast<double>(), to = corners[(use.side + 1) % 3].cast<double>();
    return use.is_forward ? std::array{from, to} : std::array{to, from};
  }

  static bool AreWithin(const std::array<Eigen::Vector3d, 2>& a, const std::array<Eigen::Vector3d, 2>& b,
                        double angle) {
    return AngleBetween(a[0], b[0]) < angle && AngleBetween(a[1], b[1]) < angle;
  }

  // Whether the normals differ by more than the angle at both ends of the edge.
  static bool Differ(const std::array<Eigen::Vector3d, 2>& a, const std::array<Eigen::Vector3d, 2>& b, double angle) {
    return AngleBetween(a[0], b[0]) > angle && AngleBetween(a[1], b[1]) > angle;
  }

  EdgeClass ClassifyExact(absl::Span<const EdgeUse> uses) const {
    const SmoothSurface& exact = mesh_.exact_surface;
    const auto a = NormalsAt(uses[0], exact.normals), b = NormalsAt(uses[1], exact.normals);
    if (const ExactSegment* segment = FindExactSegment(exact_segments_, uses[0].low, uses[0].high)) {
      if (stated_jump_rad_ == kMinStatedJump) {
        if (mesh_.exact_edges[segment->edge].is_smooth) return EdgeClass::kSmooth;
        // The file may not join the face that continues the surface: it is that of another part, or the edge is stated
        // as the end of a surface.
        return AreWithin(a, b, kMinStatedJump) ? EdgeClass::kSmooth : EdgeClass::kCrease;
      }
    } else if (exact.region_of[uses[0].triangle] == exact.region_of[uses[1].triangle]) {
      return EdgeClass::kSmooth;
    }
    return Differ(a, b, stated_jump_rad_) ? EdgeClass::kCrease : EdgeClass::kSmooth;
  }

  // nullopt if the normals of the file do not decide: they are missing, those of the facets, or equal at an edge that
  // is too sharp for a smooth surface, as in files with one normal for each vertex.
  std::optional<EdgeClass> StatedByNormals(absl::Span<const EdgeUse> uses, double turn) const {
    const auto a = NormalsAt(uses[0], mesh_.corner_normals), b = NormalsAt(uses[1], mesh_.corner_normals);
    for (const auto& normals : {a, b}) {
      if (normals[0].isZero(0.0) || normals[1].isZero(0.0)) return std::nullopt;
    }
    if (AreWithin(a, b, kSameStated)) {
      if (turn < kMaxStep) return EdgeClass::kSmooth;
      return std::nullopt;
    }
    const auto are_of_facet = [this](const EdgeUse& use, const std::array<Eigen::Vector3d, 2>& normals) {
      const Eigen::Vector3d& facet = graph_.normal(use.triangle);
      return AreWithin(normals, {facet, facet}, kSameStated);
    };
    if (are_of_facet(uses[0], a) && are_of_facet(uses[1], b)) return std::nullopt;
    if (Differ(a, b, stated_jump_rad_)) return EdgeClass::kCrease;
    return std::nullopt;
  }

  // The normals of the surface beside an edge, by the path across the facets: means over the parts [0.1 h, h] and
  // [0.2 h, 2 h] of its length, where 2 h is at most the length of the path.
  std::array<Eigen::Vector3d, 2> NormalsBeside(uint32_t side) {
    const double longest_m = 2.0 * kPathShare * diameter_m_;
    path_.clear();
    WalkAcross(graph_, side, longest_m, work_, [this](const PathStep& step) {
      path_.push_back(step);
      return std::abs(graph_.turn_rad(step.exit)) < kMaxStep;
    });
    const double h_m = path_.empty() ? 0.0 : 0.5 * std::min(longest_m, path_.back().to_m);
    std::array<Eigen::Vector3d, 2> means = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
    for (const PathStep& step : path_) {
      for (int scale = 0; scale < 2; ++scale) {
        const double from_m = std::max(step.from_m, kSkippedShare * (scale + 1) * h_m);
        const double to_m = std::min(step.to_m, (scale + 1) * h_m);
        means[scale] += std::max(0.0, to_m - from_m) * graph_.normal(step.triangle);
      }
    }
    for (Eigen::Vector3d& mean : means) {
      if (mean.isZero(0.0)) mean = graph_.normal(side / 3);
    }
    return means;
  }

  // The scale test: the turn at the edge itself, extrapolated from the turns over two lengths.
  double Jump(uint32_t side) {
    const auto one = NormalsBeside(side), other = NormalsBeside(graph_.opposite(side));
    const double near = AngleBetween(one[0], other[0]), far = AngleBetween(one[1], other[1]);
    return std::min(near, 2.0 * near - far);
  }

  // The tessellation test: whether the surface continues to turn in the same direction beside the edge, in steps as
  // large.
  bool IsTessellation(uint32_t side, double turn) {
    if (turn >= kMaxStep) return false;
    const double sign = graph_.turn_rad(side) < 0.0f ? -1.0 : 1.0;
    const double longest_m = 8.0 * kMaxSagitta * diameter_m_ / turn;
    for (const uint32_t start : {side, graph_.opposite(side)}) {
      bool is_step = false;
      WalkAcross(graph_, start, longest_m, work_, [&](const PathStep& step) {
        const double next = sign * graph_.turn_rad(step.exit);
        if (next < kLeastTurn) return true;
        is_step = turn <= kStepRatio * next + kStepTolerance && step.to_m * std::max(next, turn) <= longest_m * turn;
        return false;
      });
      if (is_step) return true;
    }
    return false;
  }

  std::vector<EdgeEnds> Ends() const {
    std::vector<EdgeEnds> ends;
    ends.reserve(edges_.size());
    for (const MeshEdge& edge : edges_) ends.push_back(edge.ends);
    return ends;
  }

  // Where exactly one crease ends at a vertex, the weak edge that continues it best becomes a crease, too.
  void ContinueCreases() {
    const VertexEdges at(Ends(), mesh_.points.size());
    std::vector<uint32_t> open;
    for (auto v = static_cast<uint32_t>(mesh_.points.size()); v-- > 0;) {
      if (!at.At(v).empty()) open.push_back(v);
    }
    while (!open.empty()) {
      const uint32_t vertex = open.back();
      open.pop_back();
      const std::optional<uint32_t> edge = Continuation(at.At(vertex), vertex);
      if (!edge.has_value()) continue;
      classes_[*edge] = EdgeClass::kCrease;
      open.push_back(edges_[*edge].ends[0] == vertex ? edges_[*edge].ends[1] : edges_[*edge].ends[0]);
    }
  }

  Eigen::Vector3d AwayFrom(uint32_t vertex, const MeshEdge& edge) const {
    const uint32_t other = edge.ends[0] == vertex ? edge.ends[1] : edge.ends[0];
    return (mesh_.points[other] - mesh_.points[vertex]).normalized();
  }

  std::optional<uint32_t> Continuation(absl::Span<const uint32_t> edges, uint32_t vertex) const {
    // More edges are a fan, which no crease continues; each of its edges may lead here.
    constexpr size_t kMaxEdges = 64;
    if (edges.size() > kMaxEdges) return std::nullopt;
    const auto is_crease = [this](uint32_t e) { return classes_[e] == EdgeClass::kCrease; };
    if (std::count_if(edges.begin(), edges.end(), is_crease) != 1) return std::nullopt;
    const Eigen::Vector3d end = AwayFrom(vertex, edges_[*std::find_if(edges.begin(), edges.end(), is_crease)]);
    std::optional<uint32_t> best;
    double best_cosine = kContinuedCosine;
    for (const uint32_t e : edges) {
      if (is_crease(e)) continue;
      const double cosine = -end.dot(AwayFrom(vertex, edges_[e]));
      if (cosine <= best_cosine) continue;
      best_cosine = cosine;
      best = e;
    }
    return best;
  }

  // Removes short chains of creases of which one end meets no other crease.
  void DropDeadEnds() {
    std::vector<EdgeEnds> ends;
    std::vector<uint32_t> index;
    for (uint32_t e = 0; e < edges_.size(); ++e) {
      if (classes_[e] != EdgeClass::kCrease) continue;
      ends.push_back(edges_[e].ends);
      index.push_back(e);
    }
    const VertexEdges at(ends, mesh_.points.size());
    for (const EdgeChain& chain : FindChains(ends, mesh_.points.size(), [](uint32_t, uint32_t) { return true; })) {
      if (at.At(chain.vertices.front()).size() > 1 && at.At(chain.vertices.back()).size() > 1) continue;
      double length_m = 0.0;
      bool is_boundary = false;
      for (size_t k = 0; k < chain.edges.size(); ++k) {
        length_m += (mesh_.points[chain.vertices[k + 1]] - mesh_.points[chain.vertices[k]]).norm();
        is_boundary |= edges_[index[chain.edges[k]]].kind == EdgeKind::kBoundary;
      }
      if (is_boundary || length_m >= kMinDeadEnd * diameter_m_) continue;
      for (const uint32_t e : chain.edges) classes_[index[e]] = EdgeClass::kSmooth;
    }
  }

  const FacetGraph& graph_;
  const RawMesh& mesh_;
  const double crease_rad_;
  const double crease_cosine_;
  const double stated_jump_rad_;
  const bool is_smooth_;
  const double diameter_m_;
  const std::vector<ExactSegment> exact_segments_;
  std::vector<MeshEdge> edges_;
  std::vector<EdgeClass> classes_;  // class of each of `edges_`
  std::vector<PathStep> path_;
  int64_t work_ = kMaxWork;
};

}  // namespace

std::vector<MeshEdge> FindCreases(const FacetGraph& graph, const CreaseOptions& options, double diameter_m) {
  return CreaseFinder(graph, options, diameter_m).Find();
}

}  // namespace evpose
