// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/templates/turn_scan.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/base/yield_point.h"
#include "core/initialization/templates/orientation.h"
#include "core/models/continuous_symmetry.h"

namespace evpose {
namespace {

using Eigen::Vector2d;

constexpr size_t kMaxScanned = 40'000;  // events; twice as many as the interval has unless many have the same time
// Turns for which the visible edges are extracted. For each of them an odd number of turns is tried, so many that the
// edges farthest from the axis move by three quarters of the gate of near events from one to the next.
constexpr int kExtractedTurns = 24;
constexpr int kMaxFineTurns = 15;
constexpr double kStepRad = 2.0 * std::numbers::pi / kExtractedTurns;
constexpr int kTurnSamples = 120;
// Least difference of two turns that are returned, of that between two extractions: 6 degrees, within which the
// alignment finds one from the other.
constexpr double kApartOfExtracted = 0.4;
// The excess that a turn must have: of independent turns, one of fifteen has it by chance.
constexpr double kLeastSigma = 1.5;
// Pixels from an edge within which events are near, and within which they count, as in the test of health
// (core/tracking/README.md, equation (1)); the share of near ones in uniform clutter, and the variance of counts.
constexpr double kNearPx = 2.0;
constexpr double kGatePx = 8.0;
constexpr double kClutterShare = kNearPx / kGatePx;
constexpr double kDispersion = 5.0;
// Events that are compared with edges in one scan: about 20 ms.
constexpr int64_t kMaxCompared = 4'000'000;

// A sample in the map.
struct MapSample {
  Vector2d at = Vector2d::Zero();
  Vector2d along = Vector2d::Zero();
  int bin = 0;
};

// False if it is behind the camera.
bool ProjectEnds(const CameraModel& camera, const RigidTransform& camera_from_object, const EdgeSample& sample,
                 Vector2d& p1, Vector2d& p2) {
  constexpr double kNearestM = 1e-6;
  const Eigen::Vector3d a = camera_from_object * (sample.point - sample.along);
  const Eigen::Vector3d b = camera_from_object * (sample.point + sample.along);
  if (!(a.z() > kNearestM && b.z() > kNearestM)) return false;
  p1 = camera.Project(a);
  p2 = camera.Project(b);
  return true;
}

bool ToMap(const CameraModel& map_camera, const RigidTransform& camera_from_object, const EdgeSample& sample,
           MapSample& image) {
  Vector2d p1, p2;
  if (!ProjectEnds(map_camera, camera_from_object, sample, p1, p2)) return false;
  image = {0.5 * (p1 + p2), 0.5 * (p2 - p1), OrientationBin(p2.x() - p1.x(), p2.y() - p1.y())};
  return true;
}

// Calls `visit` with the cells at most one cell beside the sample, those inside the map.
template <typename Visit>
void ForEachCell(const EdgeDistanceMap& map, const MapSample& image, const Visit& visit) {
  const double length = image.along.norm();
  if (!(length < EdgeDistanceMap::kCellsOfBox)) return;
  const int steps = std::max(1, static_cast<int>(length));
  for (int step = -steps; step <= steps; ++step) {
    const Vector2d at = image.at + static_cast<double>(step) / steps * image.along;
    if (!(std::abs(at.x()) < 1e6 && std::abs(at.y()) < 1e6)) continue;
    const int x = static_cast<int>(std::floor(at.x() + 0.5)), y = static_cast<int>(std::floor(at.y() + 0.5));
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        if (map.IsInside(x + dx, y + dy)) visit(map.Place(x + dx, y + dy));
      }
    }
  }
}

// Number of turns that have an edge of this direction at a place of the map.
class TurnCounts {
 public:
  explicit TurnCounts(size_t num_places) : counts_(num_places * kOrientationBins), latest_(counts_.size()) {}

  // `turn` is counted once.
  void Add(size_t place, int bin, int turn) {
    for (const int beside : {-1, 0, 1}) {
      const size_t k = place * kOrientationBins + (bin + beside + kOrientationBins) % kOrientationBins;
      if (latest_[k] == turn + 1) continue;
      latest_[k] = static_cast<uint8_t>(turn + 1);
      ++counts_[k];
    }
  }
  int At(size_t place, int bin) const { return counts_[place * kOrientationBins + bin]; }
  int MaxAt(size_t place) const {
    const auto first = counts_.begin() + static_cast<std::ptrdiff_t>(place * kOrientationBins);
    return *std::max_element(first, first + kOrientationBins);
  }

 private:
  std::vector<uint8_t> counts_;
  std::vector<uint8_t> latest_;  // 1 + the turn that was counted last
};

int NumExtracted(const TemplateModel& model) {
  return std::max(1, kExtractedTurns * model.num_spins() / kTemplateTurns);
}

double SigmaOf(double near, double gated) {
  if (!(gated > 0.0)) return 0.0;
  return (near - kClutterShare * gated) / std::sqrt(kDispersion * kClutterShare * (1.0 - kClutterShare) * gated);
}

// Returns the best ones that are at least so many steps from each other. `turns` are in steps around the axis.
std::vector<ScannedTurn> BestTurns(std::vector<ScannedTurn> turns, int steps_apart, size_t max_turns) {
  const int count = static_cast<int>(turns.size());
  std::vector<ScannedTurn> best;
  while (best.size() < max_turns) {
    const auto most = std::max_element(turns.begin(), turns.end(),
                                       [](const ScannedTurn& a, const ScannedTurn& b) { return a.sigma < b.sigma; });
    if (most->sigma < kLeastSigma) break;
    best.push_back(*most);
    const int at = static_cast<int>(most - turns.begin());
    for (int beside = 1 - steps_apart; beside < steps_apart; ++beside) {
      turns[static_cast<size_t>((at + beside + count) % count)].sigma = 0.0;
    }
  }
  return best;
}

}  // namespace

TurnScanner::TurnScanner(const TemplateModel& model, const CameraModel& camera, absl::Span<const PixelEvent> events,
                         int64_t t_begin_us, int64_t t_end_us)
    : model_(model), camera_(camera), columns_(camera.width_px / kTilePx + 1), rows_(camera.height_px / kTilePx + 1) {
  const auto begin = std::lower_bound(events.begin(), events.end(), t_begin_us,
                                      [](const PixelEvent& event, int64_t t_us) { return event.t_us < t_us; });
  events = events.subspan(begin - events.begin());
  if (events.size() > kMaxScanned) events = events.subspan(events.size() - kMaxScanned);
  const int64_t duration_us = std::max<int64_t>(1, t_end_us - t_begin_us);
  for (int slice = 0; slice < kSlices; ++slice) {
    after_middle_s_[slice] = 1e-6 * static_cast<double>(duration_us) * ((slice + 0.5) / kSlices - 0.5);
  }
  const size_t tiles = static_cast<size_t>(columns_) * rows_;
  const auto place_of = [&](const PixelEvent& event) {
    const int64_t slice = std::clamp<int64_t>(kSlices * (event.t_us - t_begin_us) / duration_us, 0, kSlices - 1);
    const int column = static_cast<int>(std::clamp(event.u_px, 0.0f, static_cast<float>(camera.width_px))) / kTilePx;
    const int row = static_cast<int>(std::clamp(event.v_px, 0.0f, static_cast<float>(camera.height_px))) / kTilePx;
    return static_cast<size_t>(slice) * tiles + static_cast<size_t>(row) * columns_ + column;
  };
  first_of_tile_.assign(kSlices * tiles + 1, 0);
  for (const PixelEvent& event : events) ++first_of_tile_[place_of(event) + 1];
  for (size_t i = 1; i < first_of_tile_.size(); ++i) first_of_tile_[i] += first_of_tile_[i - 1];
  std::vector<uint32_t> next(first_of_tile_.begin(), first_of_tile_.end() - 1);
  events_.resize(events.size());
  for (const PixelEvent& event : events) events_[next[place_of(event)]++] = {event.u_px, event.v_px};
}

RigidTransform TurnScanner::Turned(const RigidTransform& camera_from_object, double turn) const {
  const ContinuousSymmetry& axis = *model_.near_axis();
  return camera_from_object * AboutCentre(axis, ExpSo3(kStepRad * turn * axis.axis));
}

int TurnScanner::NumFineTurns(const TurnedEdges& edges, const RigidTransform& camera_from_object) const {
  constexpr double kStepPx = 1.5 * kNearPx;
  const ContinuousSymmetry& axis = *model_.near_axis();
  double radius_m = 0.0;
  for (const std::vector<EdgeSample>& samples : edges.of_turn) {
    for (const EdgeSample& sample : samples) {
      radius_m = std::max(radius_m, axis.axis.cross(Eigen::Vector3d(sample.point - axis.centre)).norm());
    }
  }
  const double depth_m = (camera_from_object * model_.centre()).norm();
  const double moved_px = kStepRad * radius_m * camera_.MaxFocalPx() / std::max(depth_m, model_.radius_m());
  const double half = std::clamp(0.5 * (moved_px / kStepPx - 1.0), 0.0, 0.5 * (kMaxFineTurns - 1));
  return 2 * static_cast<int>(std::ceil(half)) + 1;
}

TurnScanner::TurnedEdges TurnScanner::ExtractEdges(const EdgeDistanceMap& map,
                                                   const RigidTransform& camera_from_object) const {
  const CameraModel map_camera = map.CameraOf(camera_);
  const size_t num_places = static_cast<size_t>(map.width()) * map.height();
  const int num_turns = NumExtracted(model_);
  TurnedEdges edges;
  edges.of_turn.resize(num_turns);
  TurnCounts counts(num_places);
  MapSample image;
  for (int turn = 0; turn < num_turns; ++turn) {
    YieldPoint();
    const RigidTransform pose = Turned(camera_from_object, turn);
    SampleVisibleEdges(model_.edges(), map_camera, pose, kTurnSamples, edges.of_turn[turn]);
    for (const EdgeSample& sample : edges.of_turn[turn]) {
      if (!ToMap(map_camera, pose, sample, image)) continue;
      ForEachCell(map, image, [&](size_t place) { counts.Add(place, image.bin, turn); });
    }
  }
  edges.is_common.resize(num_places);
  for (size_t place = 0; place < num_places; ++place) edges.is_common[place] = 2 * counts.MaxAt(place) > num_turns;
  for (int turn = 0; turn < num_turns; ++turn) {
    const RigidTransform pose = Turned(camera_from_object, turn);
    std::erase_if(edges.of_turn[turn], [&](const EdgeSample& sample) {
      if (!ToMap(map_camera, pose, sample, image)) return true;
      const int x = static_cast<int>(std::floor(image.at.x() + 0.5)),
                y = static_cast<int>(std::floor(image.at.y() + 0.5));
      return !map.IsInside(x, y) || 2 * counts.At(map.Place(x, y), image.bin) > num_turns;
    });
  }
  return edges;
}

void TurnScanner::AddEventsBeside(const Vector2d& p1, const Vector2d& p2, int slice, const EdgeDistanceMap& map,
                                  const std::vector<uint8_t>& is_common, int64_t& budget, Counts& counts) const {
  const double length = (p2 - p1).norm();
  if (!(length > 0.0 && length < 1e4)) return;
  const Vector2d along = (p2 - p1) / length;
  const Vector2d low = p1.cwiseMin(p2).array() - kGatePx, high = p1.cwiseMax(p2).array() + kGatePx;
  if (!(high.x() >= 0.0 && high.y() >= 0.0 && low.x() < camera_.width_px && low.y() < camera_.height_px)) return;
  const int left = std::max(0, static_cast<int>(low.x()) / kTilePx);
  const int right = std::min(columns_ - 1, static_cast<int>(high.x()) / kTilePx);
  const int top = std::max(0, static_cast<int>(low.y()) / kTilePx);
  const int bottom = std::min(rows_ - 1, static_cast<int>(high.y()) / kTilePx);
  for (int row = top; row <= bottom; ++row) {
    const size_t first = (static_cast<size_t>(slice) * rows_ + row) * columns_;
    const uint32_t end = first_of_tile_[first + right + 1];
    for (uint32_t k = first_of_tile_[first + left]; k < end; ++k) {
      --budget;
      const Vector2d from_p1 = events_[k].cast<double>() - p1;
      const double at = from_p1.dot(along);
      const double distance = std::abs(along.x() * from_p1.y() - along.y() * from_p1.x());
      if (!(at >= 0.0 && at < length && distance < kGatePx)) continue;
      const Vector2d cell = map.ToCells(events_[k].cast<double>());
      const int x = static_cast<int>(std::floor(cell.x() + 0.5)), y = static_cast<int>(std::floor(cell.y() + 0.5));
      if (!map.IsInside(x, y) || is_common[map.Place(x, y)] != 0) continue;
      counts.gated += 1.0;
      if (distance < kNearPx) counts.near += 1.0;
    }
  }
}

std::vector<ScannedTurn> TurnScanner::Scan(const EdgeDistanceMap& map, const RigidTransform& camera_from_object,
                                           const Vector6d& twist, size_t max_turns) const {
  const TurnedEdges edges = ExtractEdges(map, camera_from_object);
  const Eigen::Vector3d angular = twist.tail<3>();
  std::vector<ScannedTurn> turns;
  int64_t budget = kMaxCompared;
  const int num_turns = static_cast<int>(edges.of_turn.size());
  const int num_fine = NumFineTurns(edges, camera_from_object);
  for (int step = 0; step < num_turns * num_fine; ++step) {
    YieldPoint();
    // The edges are those of the nearest turn for which they were extracted. Behind the last one the symmetries of the
    // object repeat the first one.
    const int turn = (step + num_fine / 2) / num_fine;
    const double turned_by = static_cast<double>(step) / num_fine - (turn < num_turns ? 0 : num_turns);
    const RigidTransform turned = Turned(camera_from_object, turned_by);
    Vector6d motion = twist;
    motion.head<3>() += angular.cross(Eigen::Vector3d(turned.translation_m - camera_from_object.translation_m));
    Counts counts;
    for (int slice = 0; slice < kSlices && budget > 0; ++slice) {
      const RigidTransform pose = Perturb(turned, after_middle_s_[slice] * motion);
      Vector2d p1, p2;
      for (const EdgeSample& sample : edges.of_turn[turn % num_turns]) {
        if (!ProjectEnds(camera_, pose, sample, p1, p2)) continue;
        AddEventsBeside(p1, p2, slice, map, edges.is_common, budget, counts);
      }
    }
    turns.push_back({turned, SigmaOf(counts.near, counts.gated)});
  }
  const int steps_apart = std::max(1, static_cast<int>(kApartOfExtracted * num_fine));
  return BestTurns(std::move(turns), steps_apart, max_turns);
}

}  // namespace evpose
