// SPDX-License-Identifier: Apache-2.0
#include "core/calibration/line_samples.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/calibration/event_displacement.h"
#include "core/numerics/statistics.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Number of pieces of a line, at least: fewer, longer ones hide the bend of the line by the lens.
constexpr double kMinPieces = 6.0, kMinPiecesIfSparse = 3.0;
constexpr int kCellPx = 8;           // side of the cells in which the pieces near an event are looked up
constexpr size_t kMaxPieces = 2000;  // bounds the work of a model with many lines
constexpr double kStepS = 1e-5;      // step of the difference quotient of velocities: far below a pixel

double DistanceToSegment(const Vector2d& point, const Vector2d& begin, const Vector2d& end) {
  const Vector2d side = end - begin;
  const double at = std::clamp((point - begin).dot(side) / std::max(side.squaredNorm(), 1e-12), 0.0, 1.0);
  return (point - begin - at * side).norm();
}

}  // namespace

LineSampler::LineSampler(const CameraModel& camera, const ModelEdges& edges, const LineSampleOptions& options)
    : camera_(camera),
      options_(options),
      visible_(camera, edges),
      columns_(camera.width_px / kCellPx + 1),
      rows_(camera.height_px / kCellPx + 1),
      cells_(static_cast<size_t>(columns_) * rows_) {}

bool LineSampler::ProjectPoint(const RigidTransform& pose, const Vector3d& point, Vector2d& pixel) const {
  const Vector3d point_camera = pose * point;
  if (!(point_camera.z() > 1e-6)) return false;
  const Vector2d undistorted = camera_.Project(point_camera);
  if (!camera_.IsInImage(undistorted)) return false;
  pixel = camera_.Distort(undistorted);
  return true;
}

void LineSampler::AddPieces(const TrackedLine& line, double pieces_per_line, const CalibrationInterval& interval) {
  const RigidTransform& pose = interval.camera_from_object;
  Vector2d first, last;
  if (!ProjectPoint(pose, line.p1, first) || !ProjectPoint(pose, line.p2, last)) {
    // Partly out of view: as many pieces as a line across the image; those outside are left out.
    first = {0.0, 0.0};
    last = {static_cast<double>(camera_.width_px), 0.0};
  }
  // Short lines have shorter pieces: those near the ends are too near to other lines to be used.
  const double length_px = (last - first).norm();
  const int count = static_cast<int>(
      std::ceil(length_px / std::clamp(length_px / pieces_per_line, options_.min_piece_px, options_.piece_px)));
  RigidTransform later = pose;
  later.translation_m += kStepS * interval.twist.head<3>();
  later.rotation = ExpSo3(kStepS * interval.twist.tail<3>()) * pose.rotation;
  for (int i = 0; i < count && pieces_.size() < kMaxPieces; ++i) {
    const auto at = [&](double fraction) -> Vector3d { return line.p1 + fraction / count * (line.p2 - line.p1); };
    Piece piece;
    Vector2d moved;
    piece.line = line.curve;
    piece.point = at(i + 0.5);
    if (!ProjectPoint(pose, at(i), piece.begin) || !ProjectPoint(pose, at(i + 1.0), piece.end) ||
        !ProjectPoint(pose, piece.point, piece.middle) || !ProjectPoint(later, piece.point, moved)) {
      continue;
    }
    const double chord_px = (piece.end - piece.begin).norm();
    if (chord_px < 1.0) continue;
    piece.along = (piece.end - piece.begin) / chord_px;
    piece.normal = {-piece.along.y(), piece.along.x()};
    piece.half_px = 0.5 * chord_px;
    piece.bow_px = piece.normal.dot(0.5 * (piece.begin + piece.end) - piece.middle);
    const Vector2d velocity = (moved - piece.middle) / kStepS;
    piece.normal_speed_px_s = velocity.dot(piece.normal);
    piece.along_speed_px_s = velocity.dot(piece.along);
    pieces_.push_back(std::move(piece));
  }
}

bool LineSampler::AddCompanion(const Piece& other, double min_gate_px, Piece& piece) const {
  constexpr double kMaxTurn = 0.1;      // sine of the angle: 2 px over a piece of 20 px
  constexpr double kSamePlacePx = 1.0;  // successive pieces of one line have nearly the same distance
  const double across = other.normal.dot(piece.normal);
  const double turn = other.along.dot(piece.normal);
  if (std::abs(turn) > kMaxTurn || std::abs(across) < 0.5) return false;
  const double distance_px = other.normal.dot(other.middle - piece.middle) / across;
  if (std::abs(distance_px) >= 3.0 * min_gate_px) return false;
  const double along_px = piece.along.dot(other.middle - piece.middle);
  // Beyond its end there are no events of the other one.
  if (std::abs(along_px) > other.half_px + piece.half_px) return true;
  for (const double known_px : piece.companions_px) {
    if (std::abs(known_px - distance_px) < kSamePlacePx) return true;
  }
  piece.companions_px.push_back(distance_px);
  return true;
}

void LineSampler::SetGates(double min_gate_px) {
  for (Piece& piece : pieces_) {
    double clear_px = 3.0 * options_.gate_px;
    for (const Piece& other : pieces_) {
      if (other.line == piece.line || AddCompanion(other, min_gate_px, piece)) continue;
      // A farther piece cannot be within the clearance.
      if ((other.middle - piece.middle).norm() > clear_px + piece.half_px + other.half_px) continue;
      for (const Vector2d& point : {piece.begin, piece.middle, piece.end}) {
        clear_px = std::min(clear_px, DistanceToSegment(point, other.begin, other.end));
      }
      clear_px = std::min(clear_px, DistanceToSegment(other.middle, piece.begin, piece.end));
    }
    piece.gate_px = piece.companions_px.empty() ? clear_px / 3.0 : std::min(clear_px / 3.0, min_gate_px);
    const bool is_used =
        piece.gate_px >= min_gate_px && std::abs(piece.normal_speed_px_s) >= options_.min_speed_px_per_s;
    if (!is_used) piece.gate_px = 0.0;
  }
}

void LineSampler::EnterCells(int index) {
  const Piece& piece = pieces_[index];
  double reach_px = options_.gate_px + 2.0;  // and the motion within the interval
  for (const double distance_px : piece.companions_px) {
    reach_px = std::max(reach_px, options_.gate_px + 2.0 + std::abs(distance_px));
  }
  const Vector2d low = piece.begin.cwiseMin(piece.end), high = piece.begin.cwiseMax(piece.end);
  const auto cell = [](double px, int count) { return std::clamp(static_cast<int>(px) / kCellPx, 0, count - 1); };
  for (int row = cell(low.y() - reach_px, rows_); row <= cell(high.y() + reach_px, rows_); ++row) {
    for (int column = cell(low.x() - reach_px, columns_); column <= cell(high.x() + reach_px, columns_); ++column) {
      std::vector<int>& entries = cells_[static_cast<size_t>(row) * columns_ + column];
      if (entries.empty()) used_cells_.push_back(row * columns_ + column);
      entries.push_back(index);
    }
  }
}

void LineSampler::MakePieces(const Cut& cut, const CalibrationInterval& interval) {
  for (const int cell : used_cells_) cells_[cell].clear();
  used_cells_.clear();
  pieces_.clear();
  for (const TrackedLine& line : visible_.At(interval.camera_from_object)) {
    if (!line.is_element) AddPieces(line, cut.pieces_per_line, interval);
  }
  SetGates(cut.min_gate_px);
  for (size_t i = 0; i < pieces_.size(); ++i) {
    if (pieces_[i].gate_px > 0.0) EnterCells(static_cast<int>(i));
  }
}

void LineSampler::AddEvent(const Event& event, double tau_s) {
  const Vector2d pixel(event.x, event.y);
  const size_t cell = static_cast<size_t>(event.y / kCellPx) * columns_ + event.x / kCellPx;
  if (event.x >= camera_.width_px || event.y >= camera_.height_px) return;
  for (const int index : cells_[cell]) {
    Piece& piece = pieces_[index];
    const Vector2d offset = pixel - piece.middle;
    const double along = offset.dot(piece.along) - tau_s * piece.along_speed_px_s;
    if (std::abs(along) > piece.half_px) continue;
    const double position = along / piece.half_px;
    const double distance =
        offset.dot(piece.normal) - tau_s * piece.normal_speed_px_s - piece.bow_px * position * position;
    const bool is_near = std::abs(distance) <= piece.gate_px ||
                         std::any_of(piece.companions_px.begin(), piece.companions_px.end(), [&](double companion_px) {
                           return std::abs(distance - companion_px) <= piece.gate_px;
                         });
    if (!is_near) continue;
    piece.distances_px.push_back(distance);
    piece.polarity[event.polarity != 0] += 1.0;
    if (piece.companions_px.empty()) return;
  }
}

void LineSampler::Finish(Piece& piece, double min_events, int index, std::vector<LineSample>& samples) const {
  if (static_cast<double>(piece.distances_px.size()) < min_events) return;
  std::vector<double>& distances = piece.distances_px;
  const std::vector<double>& companions = piece.companions_px;
  const double together = 1.0 + static_cast<double>(companions.size());
  double half_width_px = piece.gate_px, start_px = 0.0;
  if (companions.empty()) {
    start_px = UpperMedian(distances);
  } else {
    const auto [first, last] = std::minmax_element(companions.begin(), companions.end());
    half_width_px += 0.5 * (std::max(0.0, *last) - std::min(0.0, *first));
  }
  const EventDisplacement fit = FitDisplacement(distances, half_width_px, start_px, table_, companions);
  if (fit.num_events < min_events || std::abs(fit.mean_px) > piece.gate_px) return;
  LineSample sample;
  sample.interval = index;
  sample.line = piece.line;
  sample.point = piece.point;
  sample.pixel = piece.middle + fit.mean_px * piece.normal;
  sample.normal = piece.normal;
  // The same events are in the samples of all lines that are measured together.
  sample.num_events = fit.num_events / together;
  sample.sigma_px = std::sqrt(fit.spread_px * fit.spread_px * options_.events_per_information / sample.num_events +
                              options_.model_error_px * options_.model_error_px);
  const double kappa = (piece.polarity[1] - piece.polarity[0]) / (piece.polarity[1] + piece.polarity[0]);
  // The motion of a bright surface over a dark one makes pixels brighter.
  const double side = kappa * piece.normal_speed_px_s;
  if (companions.empty() && std::abs(kappa) >= options_.min_kappa) sample.dark_side = side > 0.0 ? 1.0 : -1.0;
  sample.motion = piece.normal_speed_px_s > 0.0 ? 1.0 : -1.0;
  sample.speed_px_per_s = std::abs(piece.normal_speed_px_s);
  // The length of the piece, until SetDensities().
  sample.events_per_px2 = 2.0 * piece.half_px;
  samples.push_back(sample);
}

void LineSampler::Sample(const CalibrationInterval& interval, int index, std::vector<LineSample>& samples) {
  std::vector<LineSample> most = SampleWith({kMinPieces, options_.min_events, options_.min_gate_px}, interval, index);
  if (static_cast<int>(most.size()) < options_.min_samples) {
    for (const Cut& cut : {Cut{kMinPiecesIfSparse, options_.min_events_if_sparse, options_.min_gate_px},
                           Cut{kMinPieces, options_.min_events_if_sparse, options_.min_gate_if_sparse_px}}) {
      std::vector<LineSample> sparse = SampleWith(cut, interval, index);
      if (sparse.size() > most.size()) most = std::move(sparse);
    }
  }
  samples.insert(samples.end(), most.begin(), most.end());
}

std::vector<LineSample> LineSampler::SampleWith(const Cut& cut, const CalibrationInterval& interval, int index) {
  MakePieces(cut, interval);
  for (const Event& event : interval.events) {
    AddEvent(event, 1e-6 * static_cast<double>(event.t_us - interval.t_us));
  }
  std::vector<LineSample> samples;
  for (Piece& piece : pieces_) Finish(piece, cut.min_events, index, samples);
  SetDensities(1e-6 * static_cast<double>(interval.duration_us), absl::MakeSpan(samples));
  return samples;
}

void LineSampler::SetDensities(double duration_s, absl::Span<LineSample> samples) const {
  // The pieces of a line are consecutive.
  for (size_t begin = 0; begin < samples.size();) {
    double events = 0.0, swept_px2 = 0.0;
    size_t end = begin;
    for (; end < samples.size() && samples[end].line == samples[begin].line; ++end) {
      events += samples[end].num_events;
      swept_px2 += samples[end].events_per_px2 * samples[end].speed_px_per_s * duration_s;
    }
    for (; begin < end; ++begin) samples[begin].events_per_px2 = swept_px2 > 0.0 ? events / swept_px2 : 0.0;
  }
}

}  // namespace evpose
