// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_topology.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/types/span.h"
#include "core/mesh/mesh_edges.h"
#include "core/numerics/disjoint_sets.h"

namespace evpose {
namespace {

// --- Merging points

struct CellHash {
  size_t operator()(const std::array<int64_t, 3>& cell) const {
    uint64_t hash = 0;
    for (const int64_t value : cell) hash = (hash ^ static_cast<uint64_t>(value)) * 0x9E3779B97F4A7C15u + (hash >> 29);
    return hash ^ (hash >> 32);
  }
};

// The kept points in the cells of a grid. The hash map is never iterated, so that its order has no effect.
class PointGrid {
 public:
  // A cell is four tolerances wide, so that a search visits at most two cells per axis.
  explicit PointGrid(double tolerance_m) : tolerance_m_(tolerance_m), inverse_cell_m_(0.25 / tolerance_m) {}

  // The first point of `kept` within the tolerance, or `kept.size()` after appending the new one.
  uint32_t FindOrAdd(const Eigen::Vector3d& point, std::vector<Eigen::Vector3d>& kept) {
    uint32_t found = static_cast<uint32_t>(kept.size());
    const std::array<int64_t, 3> low = Cell(point - Eigen::Vector3d::Constant(tolerance_m_));
    const std::array<int64_t, 3> high = Cell(point + Eigen::Vector3d::Constant(tolerance_m_));
    for (int64_t x = low[0]; x <= high[0]; ++x) {
      for (int64_t y = low[1]; y <= high[1]; ++y) {
        for (int64_t z = low[2]; z <= high[2]; ++z) found = std::min(found, FindInCell({x, y, z}, point, kept));
      }
    }
    if (found < kept.size()) return found;
    kept.push_back(point);
    next_in_cell_.push_back(kNone);
    const auto [entry, is_new] = first_in_cell_.try_emplace(Cell(point), found);
    if (!is_new) {
      next_in_cell_.back() = entry->second;
      entry->second = found;
    }
    return found;
  }

 private:
  static constexpr uint32_t kNone = ~0u;

  std::array<int64_t, 3> Cell(const Eigen::Vector3d& point) const {
    const Eigen::Vector3d cell = (point * inverse_cell_m_).array().floor();
    return {static_cast<int64_t>(cell.x()), static_cast<int64_t>(cell.y()), static_cast<int64_t>(cell.z())};
  }

  uint32_t FindInCell(const std::array<int64_t, 3>& cell, const Eigen::Vector3d& point,
                      const std::vector<Eigen::Vector3d>& kept) const {
    uint32_t found = kNone;
    const auto entry = first_in_cell_.find(cell);
    if (entry == first_in_cell_.end()) return found;
    for (uint32_t i = entry->second; i != kNone; i = next_in_cell_[i]) {
      if ((kept[i] - point).squaredNorm() <= tolerance_m_ * tolerance_m_) found = std::min(found, i);
    }
    return found;
  }

  const double tolerance_m_;
  const double inverse_cell_m_;
  absl::flat_hash_map<std::array<int64_t, 3>, uint32_t, CellHash> first_in_cell_;
  std::vector<uint32_t> next_in_cell_;
};

// Marks the elements whose key an earlier element has.
template <typename Element, typename KeyOf>
std::vector<bool> MarkRepeated(const std::vector<Element>& elements, const KeyOf& key_of) {
  absl::flat_hash_set<Element> seen;
  seen.reserve(elements.size());
  std::vector<bool> repeated(elements.size());
  for (size_t i = 0; i < elements.size(); ++i) repeated[i] = !seen.insert(key_of(elements[i])).second;
  return repeated;
}

// Returns the number of removed elements. An empty vector, of an attribute that the mesh lacks, stays empty.
template <typename T>
size_t RemoveMarked(const std::vector<bool>& remove, std::vector<T>& items) {
  if (items.empty()) return 0;
  size_t kept = 0;
  for (size_t i = 0; i < items.size(); ++i) {
    if (!remove[i]) items[kept++] = items[i];
  }
  const size_t removed = items.size() - kept;
  items.resize(kept);
  return removed;
}

// --- Orientation

// The neighbour across a side of a triangle: one other triangle, or an edge of another number of triangles.
struct Neighbour {
  enum class Link : uint8_t { kSameWinding, kOtherWinding, kEdge };
  uint32_t index = 0;  // index of the triangle or of the edge
  Link link = Link::kEdge;
  bool is_forward = false;  // true if the triangle goes from the lower to the higher vertex of the edge
};

class Orienter {
 public:
  explicit Orienter(RawMesh& model) : model_(model), neighbours_(model.triangles.size()) {
    for (uint32_t t = 0; t < model.triangles.size(); ++t) area_m2_ += TriangleArea(model, t);
    uint32_t edges = 0;
    ForEachEdge(SortedEdgeUses(model.triangles), [&](absl::Span<const EdgeUse> uses) {
      if (uses.size() == 2) {
        using Link = Neighbour::Link;
        const Link link = uses[0].is_forward != uses[1].is_forward ? Link::kSameWinding : Link::kOtherWinding;
        neighbours_[uses[0].triangle][uses[0].side] = {uses[1].triangle, link};
        neighbours_[uses[1].triangle][uses[1].side] = {uses[0].triangle, link};
        return;
      }
      for (const EdgeUse& use : uses) {
        neighbours_[use.triangle][use.side] = {edges, Neighbour::Link::kEdge, use.is_forward};
      }
      ++edges;
    });
  }

  Orientation Orient() {
    state_.assign(model_.triangles.size(), State::kUnseen);
    result_.shell_of.resize(model_.triangles.size());
    for (uint32_t seed = 0; seed < model_.triangles.size(); ++seed) {
      if (state_[seed] == State::kUnseen) OrientSurface(seed);
    }
    return std::move(result_);
  }

 private:
  enum class State : uint8_t { kUnseen, kAsIs, kTurn };

  void OrientSurface(uint32_t seed) {
    surface_.assign(1, seed);
    edge_uses_.clear();
    state_[seed] = State::kAsIs;
    bool is_orientable = true;
    for (size_t i = 0; i < surface_.size(); ++i) {
      const State state = state_[surface_[i]];
      result_.shell_of[surface_[i]] = static_cast<uint32_t>(result_.shells);
      for (const Neighbour& neighbour : neighbours_[surface_[i]]) {
        if (neighbour.link == Neighbour::Link::kEdge) {
          edge_uses_.push_back({neighbour.index, neighbour.is_forward == (state == State::kAsIs) ? 1 : -1});
          continue;
        }
        const bool turn = (state == State::kTurn) == (neighbour.link == Neighbour::Link::kSameWinding);
        const State wanted = turn ? State::kTurn : State::kAsIs;
        if (state_[neighbour.index] == State::kUnseen) {
          state_[neighbour.index] = wanted;
          surface_.push_back(neighbour.index);
        }
        is_orientable &= state_[neighbour.index] == wanted;
      }
    }
    ++result_.shells;
    const bool is_closed = is_orientable && HasNoBoundary();
    result_.is_closed &= is_closed;
    result_.is_oriented &= is_orientable;
    if (is_orientable) Turn(is_closed);
  }

  // Whether the surface passes each of its edges as often in one direction as in the other. Surfaces that touch in an
  // edge, such as those of two boxes, are closed each.
  bool HasNoBoundary() {
    std::sort(edge_uses_.begin(), edge_uses_.end());
    for (size_t i = 0; i < edge_uses_.size();) {
      const uint32_t edge = edge_uses_[i].first;
      int sum = 0;
      for (; i < edge_uses_.size() && edge_uses_[i].first == edge; ++i) sum += edge_uses_[i].second;
      if (sum != 0) return false;
    }
    return true;
  }

  void Turn(bool is_closed) {
    const size_t marked =
        std::count_if(surface_.begin(), surface_.end(), [this](uint32_t t) { return state_[t] == State::kTurn; });
    State to_turn = 2 * marked > surface_.size() ? State::kAsIs : State::kTurn;
    // Volume of the surface with the triangles marked kTurn reversed.
    const double volume = is_closed ? VolumeOfClosed() : VolumeOfOpen();
    if (volume > 0.0) to_turn = State::kTurn;
    if (volume < 0.0) to_turn = State::kAsIs;
    for (const uint32_t t : surface_) {
      if (state_[t] != to_turn) continue;
      TurnTriangle(t);
      ++result_.turned;
    }
  }

  void TurnTriangle(uint32_t t) {
    std::swap(model_.triangles[t][1], model_.triangles[t][2]);
    for (auto* normals : {&model_.corner_normals, &model_.exact_surface.normals}) {
      if (!normals->empty()) std::swap((*normals)[t][1], (*normals)[t][2]);
    }
  }

  // Returns 0 if the volume is within rounding errors, as that of a sheet with two sides.
  double VolumeOfClosed() const {
    constexpr double kRounding = 1e-9;  // rounding error of some million additions in double precision
    const auto [volume, magnitude] = VolumeAbout(model_.points[model_.triangles[surface_[0]][0]]);
    return std::abs(volume) > kRounding * magnitude ? volume : 0.0;
  }

  // Returns the volume about the middle of the boundary. Returns 0 if the surface has less than half of the area of the
  // mesh, as the wall of a hole that is not joined with the rest. Returns 0 also if it is nearly flat, as a dish with a
  // depth below 7 % of its radius.
  double VolumeOfOpen() const {
    constexpr double kLeastShare = 0.5, kLeastBulge = 0.02;
    double area = 0.0, length = 0.0;
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (const uint32_t t : surface_) {
      area += TriangleArea(model_, t);
      for (size_t side = 0; side < 3; ++side) {
        if (neighbours_[t][side].link != Neighbour::Link::kEdge) continue;
        const Eigen::Vector3d& a = model_.points[model_.triangles[t][side]];
        const Eigen::Vector3d& b = model_.points[model_.triangles[t][(side + 1) % 3]];
        middle += 0.5 * (b - a).norm() * (a + b);
        length += (b - a).norm();
      }
    }
    if (area < kLeastShare * area_m2_ || !(length > 0.0)) return 0.0;
    const double volume = VolumeAbout(middle / length).first;
    return std::abs(volume) > kLeastBulge * area * std::sqrt(area) ? volume : 0.0;
  }

  // The volume, and the sum of the absolute values of its terms.
  std::pair<double, double> VolumeAbout(const Eigen::Vector3d& origin) const {
    double volume = 0.0, magnitude = 0.0;
    for (const uint32_t t : surface_) {
      const auto& [i, j, k] = model_.triangles[t];
      const double part =
          (model_.points[i] - origin).dot((model_.points[j] - origin).cross(model_.points[k] - origin)) / 6.0;
      volume += state_[t] == State::kTurn ? -part : part;
      magnitude += std::abs(part);
    }
    return {volume, magnitude};
  }

  RawMesh& model_;
  double area_m2_ = 0.0;
  std::vector<std::array<Neighbour, 3>> neighbours_;
  std::vector<State> state_;
  std::vector<uint32_t> surface_;                    // the triangles of the present surface
  std::vector<std::pair<uint32_t, int>> edge_uses_;  // its edges without a single neighbour, with the direction
  Orientation result_;
};

std::array<uint32_t, 3> Sorted(std::array<uint32_t, 3> triangle) {
  std::sort(triangle.begin(), triangle.end());
  return triangle;
}

class SecondSideRemover {
 public:
  explicit SecondSideRemover(RawMesh& mesh)
      : mesh_(mesh),
        is_second_(MarkRepeated(mesh.triangles, Sorted)),
        patches_(mesh.triangles.size()),
        openings_(mesh.points.size()),
        excess_m2_(mesh.triangles.size(), 0.0) {}

  size_t Remove() {
    FindPatches();
    for (uint32_t t = 0; t < is_second_.size(); ++t) {
      if (is_second_[t]) excess_m2_[patches_.Find(t)] += kMaxOpenShare * TriangleArea(mesh_, t);
    }
    SubtractOpenings();
    for (const uint32_t t : must_stay_) excess_m2_[patches_.Find(t)] = -1.0;
    std::vector<bool> remove(is_second_.size());
    for (uint32_t t = 0; t < remove.size(); ++t) remove[t] = is_second_[t] && excess_m2_[patches_.Find(t)] > 0.0;
    return RemoveTriangles(remove, mesh_);
  }

 private:
  // Largest share of openings of a body; a sheet has 1. Through openings of a smaller share, little of the inner side
  // is visible, and it is then no surface.
  static constexpr double kMaxOpenShare = 0.05;

  struct OpenEdge {
    uint32_t triangle, low, high;
  };

  // Joins second sides at their edges. An edge that only one other triangle has is open; an odd number of more is that
  // of a wall, or of the foot of a sheet on a body.
  void FindPatches() {
    const std::vector<bool> none_removed(is_second_.size());
    ForEachEdge(SortedEdgeUses(mesh_.triangles), [&](absl::Span<const EdgeUse> uses) {
      const auto [first, rest] = JoinMarked(uses, is_second_, none_removed, patches_);
      if (first == nullptr || rest % 2 == 0) return;
      if (rest > 1) return must_stay_.push_back(first->triangle);
      openings_.Join(first->low, first->high);
      open_edges_.push_back({first->triangle, first->low, first->high});
    });
  }

  // Of all closed curves of the same length, the circle has the largest area.
  void SubtractOpenings() {
    std::map<std::pair<uint32_t, uint32_t>, double> perimeters_m;  // of a patch and an opening
    for (const OpenEdge& edge : open_edges_) {
      perimeters_m[{patches_.Find(edge.triangle), openings_.Find(edge.low)}] +=
          (mesh_.points[edge.high] - mesh_.points[edge.low]).norm();
    }
    for (const auto& [opening, perimeter_m] : perimeters_m) {
      excess_m2_[opening.first] -= perimeter_m * perimeter_m / (4.0 * std::numbers::pi);
    }
  }

  RawMesh& mesh_;
  const std::vector<bool> is_second_;  // triangles with the corners of an earlier one
  DisjointSets patches_;
  DisjointSets openings_;
  std::vector<double> excess_m2_;  // for the first triangle of each patch: the admissible open area less the actual one
  std::vector<OpenEdge> open_edges_;
  std::vector<uint32_t> must_stay_;  // each with its patch
};

}  // namespace

double BoundingBoxDiagonal(const RawMesh& model) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : model.points) box.extend(point);
  return box.isEmpty() ? 0.0 : box.diagonal().norm();
}

size_t MergePoints(double tolerance_m, RawMesh& model) {
  PointGrid grid(tolerance_m);
  std::vector<Eigen::Vector3d> kept;
  std::vector<uint32_t> index(model.points.size());
  size_t moved = 0;
  for (size_t i = 0; i < model.points.size(); ++i) {
    index[i] = grid.FindOrAdd(model.points[i], kept);
    moved += kept[index[i]] != model.points[i];
  }
  model.points = std::move(kept);
  for (auto& triangle : model.triangles) {
    for (uint32_t& vertex : triangle) vertex = index[vertex];
  }
  for (auto& line : model.lines) {
    for (uint32_t& vertex : line) vertex = index[vertex];
  }
  for (ExactEdge& edge : model.exact_edges) {
    for (uint32_t& vertex : edge.points) vertex = index[vertex];
  }
  return moved;
}

double TriangleArea(const RawMesh& model, uint32_t t) {
  const auto& [i, j, k] = model.triangles[t];
  return 0.5 * (model.points[j] - model.points[i]).cross(model.points[k] - model.points[i]).norm();
}

bool HasArea(const RawMesh& model, const std::array<uint32_t, 3>& triangle, double min_height_m) {
  const auto& [i, j, k] = triangle;
  if (i == j || j == k || k == i) return false;
  const Eigen::Vector3d ab = model.points[j] - model.points[i], ac = model.points[k] - model.points[i];
  const double longest2 = std::max({ab.squaredNorm(), ac.squaredNorm(), (ac - ab).squaredNorm()});
  return ab.cross(ac).squaredNorm() > min_height_m * min_height_m * longest2;
}

size_t RemoveTriangles(const std::vector<bool>& remove, RawMesh& model) {
  RemoveMarked(remove, model.corner_normals);
  RemoveMarked(remove, model.exact_surface.region_of);
  RemoveMarked(remove, model.exact_surface.normals);
  return RemoveMarked(remove, model.triangles);
}

size_t RemoveCollapsedTriangles(RawMesh& model) {
  std::vector<bool> is_collapsed;
  for (const auto& [i, j, k] : model.triangles) is_collapsed.push_back(i == j || j == k || k == i);
  return RemoveTriangles(is_collapsed, model);
}

size_t RemoveFlatTriangles(double min_height_m, RawMesh& model) {
  std::vector<bool> is_flat(model.triangles.size());
  for (size_t t = 0; t < is_flat.size(); ++t) is_flat[t] = !HasArea(model, model.triangles[t], min_height_m);
  return RemoveTriangles(is_flat, model);
}

size_t RemoveDuplicateTriangles(RawMesh& model) {
  const auto lowest_first = [](std::array<uint32_t, 3> triangle) {
    std::rotate(triangle.begin(), std::min_element(triangle.begin(), triangle.end()), triangle.end());
    return triangle;
  };
  return RemoveTriangles(MarkRepeated(model.triangles, lowest_first), model);
}

size_t RemoveSecondSides(RawMesh& model) { return SecondSideRemover(model).Remove(); }

size_t RemoveEmptyLines(RawMesh& model) {
  return std::erase_if(model.lines, [](const auto& line) { return line[0] == line[1]; });
}

size_t RemoveDuplicateLines(RawMesh& model) {
  const auto lowest_first = [](std::array<uint32_t, 2> line) {
    std::sort(line.begin(), line.end());
    return line;
  };
  return RemoveMarked(MarkRepeated(model.lines, lowest_first), model.lines);
}

Orientation OrientTriangles(RawMesh& model) { return Orienter(model).Orient(); }

}  // namespace evpose
