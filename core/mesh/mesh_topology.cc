// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/mesh_topology.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <unordered_map>

#include "absl/strings/str_cat.h"
#include "absl/types/span.h"
#include "core/mesh/mesh_edges.h"

namespace evpose {
namespace {

// --- Welding

struct CellHash {
  size_t operator()(const std::array<int64_t, 3>& cell) const {
    uint64_t hash = 0;
    for (const int64_t value : cell) hash = (hash ^ static_cast<uint64_t>(value)) * 0x9E3779B97F4A7C15u + (hash >> 29);
    return hash;
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
  std::unordered_map<std::array<int64_t, 3>, uint32_t, CellHash> first_in_cell_;
  std::vector<uint32_t> next_in_cell_;
};

bool HasArea(const RawMesh& model, const std::array<uint32_t, 3>& triangle, double min_height_m) {
  const auto& [i, j, k] = triangle;
  if (i == j || j == k || k == i) return false;
  const Eigen::Vector3d ab = model.points[j] - model.points[i], ac = model.points[k] - model.points[i];
  const double longest2 = std::max({ab.squaredNorm(), ac.squaredNorm(), (ac - ab).squaredNorm()});
  return ab.cross(ac).squaredNorm() > min_height_m * min_height_m * longest2;
}

// Removes all but the first of the items with equal keys and keeps the order. Returns the number of removed items.
template <typename Item, typename Key>
size_t RemoveDuplicates(std::vector<Item>& items, const Key& key) {
  std::vector<uint32_t> order(items.size());
  std::iota(order.begin(), order.end(), 0u);
  std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) {
    const Item key_a = key(items[a]), key_b = key(items[b]);
    return key_a != key_b ? key_a < key_b : a < b;
  });
  std::vector<bool> remove(items.size());
  for (size_t i = 1; i < order.size(); ++i) remove[order[i]] = key(items[order[i]]) == key(items[order[i - 1]]);
  size_t kept = 0;
  for (size_t i = 0; i < items.size(); ++i) {
    if (!remove[i]) items[kept++] = items[i];
  }
  const size_t removed = items.size() - kept;
  items.resize(kept);
  return removed;
}

void AddNotice(size_t count, const char* what, std::vector<std::string>& notices) {
  if (count > 0) notices.push_back(absl::StrCat(count, " ", what));
}

// --- Orientation

constexpr uint32_t kNoNeighbour = ~0u;

struct Neighbour {
  uint32_t triangle = kNoNeighbour;
  bool has_same_winding = true;
};

class Orienter {
 public:
  explicit Orienter(RawMesh& model) : model_(model), neighbours_(model.triangles.size()) {
    ForEachEdge(SortedEdgeUses(model.triangles), [this](absl::Span<const EdgeUse> uses) {
      if (uses.size() != 2) return;
      const bool same = uses[0].is_forward != uses[1].is_forward;
      neighbours_[uses[0].triangle][uses[0].side] = {uses[1].triangle, same};
      neighbours_[uses[1].triangle][uses[1].side] = {uses[0].triangle, same};
    });
  }

  // Returns the number of triangles whose winding was reversed.
  size_t Orient() {
    state_.assign(model_.triangles.size(), State::kUnseen);
    size_t turned = 0;
    for (uint32_t seed = 0; seed < model_.triangles.size(); ++seed) {
      if (state_[seed] == State::kUnseen) turned += OrientSurface(seed);
    }
    return turned;
  }

 private:
  enum class State : uint8_t { kUnseen, kAsIs, kTurn };

  size_t OrientSurface(uint32_t seed) {
    std::vector<uint32_t> surface = {seed};
    state_[seed] = State::kAsIs;
    bool is_closed = true, is_orientable = true;
    for (size_t i = 0; i < surface.size(); ++i) {
      const State state = state_[surface[i]];
      for (const Neighbour& neighbour : neighbours_[surface[i]]) {
        if (neighbour.triangle == kNoNeighbour) {
          is_closed = false;
          continue;
        }
        const bool turn = (state == State::kTurn) == neighbour.has_same_winding;
        const State wanted = turn ? State::kTurn : State::kAsIs;
        if (state_[neighbour.triangle] == State::kUnseen) {
          state_[neighbour.triangle] = wanted;
          surface.push_back(neighbour.triangle);
        }
        is_orientable &= state_[neighbour.triangle] == wanted;
      }
    }
    if (!is_orientable) return 0;
    return Turn(surface, is_closed);
  }

  size_t Turn(const std::vector<uint32_t>& surface, bool is_closed) {
    const size_t marked =
        std::count_if(surface.begin(), surface.end(), [this](uint32_t t) { return state_[t] == State::kTurn; });
    State to_turn = 2 * marked > surface.size() ? State::kAsIs : State::kTurn;
    // Volume of the surface with the triangles marked kTurn reversed.
    const double volume = is_closed ? Volume(surface) : 0.0;
    if (volume > 0.0) to_turn = State::kTurn;
    if (volume < 0.0) to_turn = State::kAsIs;
    size_t turned = 0;
    for (const uint32_t t : surface) {
      if (state_[t] != to_turn) continue;
      std::swap(model_.triangles[t][1], model_.triangles[t][2]);
      ++turned;
    }
    return turned;
  }

  // Returns 0 if the volume is within rounding errors, as that of a sheet with two sides.
  double Volume(const std::vector<uint32_t>& surface) const {
    const Eigen::Vector3d origin = model_.points[model_.triangles[surface[0]][0]];
    double volume = 0.0, magnitude = 0.0;
    for (const uint32_t t : surface) {
      const auto& [i, j, k] = model_.triangles[t];
      const double part =
          (model_.points[i] - origin).dot((model_.points[j] - origin).cross(model_.points[k] - origin)) / 6.0;
      volume += state_[t] == State::kTurn ? -part : part;
      magnitude += std::abs(part);
    }
    constexpr double kRounding = 1e-9;  // of some million additions in double precision
    return std::abs(volume) > kRounding * magnitude ? volume : 0.0;
  }

  RawMesh& model_;
  std::vector<std::array<Neighbour, 3>> neighbours_;
  std::vector<State> state_;
};

}  // namespace

std::vector<EdgeUse> SortedEdgeUses(absl::Span<const std::array<uint32_t, 3>> triangles) {
  std::vector<EdgeUse> uses;
  uses.reserve(3 * triangles.size());
  for (uint32_t t = 0; t < triangles.size(); ++t) {
    for (uint8_t side = 0; side < 3; ++side) {
      const uint32_t from = triangles[t][side], to = triangles[t][(side + 1) % 3];
      uses.push_back({std::min(from, to), std::max(from, to), t, side, from < to});
    }
  }
  std::sort(uses.begin(), uses.end(), [](const EdgeUse& a, const EdgeUse& b) {
    return std::tie(a.low, a.high, a.triangle, a.side) < std::tie(b.low, b.high, b.triangle, b.side);
  });
  return uses;
}

double BoundingBoxDiagonal(const RawMesh& model) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : model.points) box.extend(point);
  return box.isEmpty() ? 0.0 : box.diagonal().norm();
}

void Weld(double tolerance_m, RawMesh& model, std::vector<std::string>& notices) {
  PointGrid grid(tolerance_m);
  std::vector<Eigen::Vector3d> kept;
  std::vector<uint32_t> index(model.points.size());
  for (size_t i = 0; i < model.points.size(); ++i) index[i] = grid.FindOrAdd(model.points[i], kept);
  model.points = std::move(kept);
  for (auto& triangle : model.triangles) {
    for (uint32_t& vertex : triangle) vertex = index[vertex];
  }
  for (auto& line : model.lines) {
    for (uint32_t& vertex : line) vertex = index[vertex];
  }

  AddNotice(std::erase_if(model.triangles, [&](const auto& t) { return !HasArea(model, t, tolerance_m); }),
            "triangles without area dropped", notices);
  // Duplicates have the same corners in the same cyclic order; the other side of a sheet has the reverse order.
  AddNotice(RemoveDuplicates(model.triangles,
                             [](std::array<uint32_t, 3> t) {
                               std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
                               return t;
                             }),
            "duplicate triangles dropped", notices);
  AddNotice(std::erase_if(model.lines, [](const auto& line) { return line[0] == line[1]; }),
            "lines of length zero dropped", notices);
  AddNotice(RemoveDuplicates(model.lines,
                             [](std::array<uint32_t, 2> line) {
                               std::sort(line.begin(), line.end());
                               return line;
                             }),
            "duplicate lines dropped", notices);
}

void OrientTriangles(RawMesh& model, std::vector<std::string>& notices) {
  AddNotice(Orienter(model).Orient(),
            "triangles turned: their winding differed from that of their neighbours or was inward", notices);
}

}  // namespace evpose
