// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/texture_lines.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/check_range.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Margin, pixels. An edge that is nearer to the boundary of the parts of an image that are on the surface is taken for
// that boundary.
constexpr int kMarginPx = 2;
// Repetitions of an image on one triangle; more are the texture of a floor, not the edges of an object.
constexpr int kMaxRepetitions = 64;
// Segments that are compared with triangles: bounds time and memory.
constexpr size_t kMaxComparisons = 5'000'000;
// Side of the cells in which segments are looked up, pixels: about the length of a segment.
constexpr int kCellPx = 32;

// A triangle in the pixels of its image, moved by whole images so that a part of it lies in the image.
struct PlacedTriangle {
  size_t triangle;
  std::array<Eigen::Vector2d, 3> corners;
};

struct Segment {
  size_t edge;
  Eigen::Vector2d p1, p2;
};

// A part of an edge on the object.
struct Piece {
  size_t edge;
  Eigen::Vector3d p1, p2;
};

// The triangles of one image.
std::vector<PlacedTriangle> PlaceTriangles(const Scene& scene, int image) {
  const cv::Size size = scene.images[static_cast<size_t>(image)].size();
  std::vector<PlacedTriangle> placed;
  for (size_t i = 0; i < scene.mesh.triangles.size(); ++i) {
    if (scene.image_of[i] != image) continue;
    Eigen::AlignedBox2d box;
    for (const Eigen::Vector2d& corner : scene.image_positions[i]) box.extend(corner);
    const Eigen::Array2d first = box.min().array().floor(), last = box.max().array().ceil();
    const Eigen::Array2d count = (last - first).max(1.0);
    if (!(count.prod() <= kMaxRepetitions) || !(first.abs().maxCoeff() < 1e6)) continue;  // also of NaN
    for (double u = first.x(); u < first.x() + count.x(); ++u) {
      for (double v = first.y(); v < first.y() + count.y(); ++v) {
        PlacedTriangle& triangle = placed.emplace_back();
        triangle.triangle = i;
        for (size_t k = 0; k < 3; ++k) {
          const Eigen::Vector2d corner = scene.image_positions[i][k] - Eigen::Vector2d(u, v);
          triangle.corners[k] = {corner.x() * size.width - 0.5, (1.0 - corner.y()) * size.height - 0.5};
        }
      }
    }
  }
  return placed;
}

// The parts of the image that are on the surface, without a margin. The boundary of the image itself has none, because
// the image may continue there.
cv::Mat MaskOf(const std::vector<PlacedTriangle>& triangles, const cv::Size& size) {
  constexpr int kShift = 4;  // fillConvexPoly takes sixteenths of a pixel
  cv::Mat mask = cv::Mat::zeros(size, CV_8U);
  for (const PlacedTriangle& triangle : triangles) {
    std::array<cv::Point, 3> corners;
    for (size_t k = 0; k < 3; ++k) {
      const Eigen::Vector2d scaled = triangle.corners[k] * (1 << kShift);
      corners[k] = {static_cast<int>(std::lround(scaled.x())), static_cast<int>(std::lround(scaled.y()))};
    }
    cv::fillConvexPoly(mask, corners.data(), 3, cv::Scalar(255), cv::LINE_8, kShift);
  }
  const int width = 2 * kMarginPx + 1;
  cv::erode(mask, mask, cv::Mat::ones(width, width, CV_8U));
  return mask;
}

// Segments by the cells of a grid.
class SegmentGrid {
 public:
  SegmentGrid(const std::vector<TextureEdge>& edges, const cv::Size& size)
      : columns_(size.width / kCellPx + 1), rows_(size.height / kCellPx + 1), cells_(columns_ * rows_) {
    for (size_t edge = 0; edge < edges.size(); ++edge) {
      for (size_t i = 1; i < edges[edge].points.size(); ++i)
        Add({edge, edges[edge].points[i - 1], edges[edge].points[i]});
    }
    last_query_.resize(segments_.size(), 0);
  }

  // Calls `visit` once for each segment that may touch the box. Returns the number of cells and segments it looked at.
  template <typename Visit>
  size_t ForEachNear(const Eigen::AlignedBox2d& box, const Visit& visit) {
    ++query_;
    size_t work = 0;
    const auto [first_column, first_row] = CellOf(box.min());
    const auto [last_column, last_row] = CellOf(box.max());
    for (size_t row = first_row; row <= last_row; ++row) {
      for (size_t column = first_column; column <= last_column; ++column) {
        ++work;
        for (const size_t i : cells_[row * columns_ + column]) {
          ++work;
          if (std::exchange(last_query_[i], query_) != query_) visit(segments_[i]);
        }
      }
    }
    return work;
  }

 private:
  std::pair<size_t, size_t> CellOf(const Eigen::Vector2d& p) const {
    const auto index = [](double px, size_t count) {
      return static_cast<size_t>(std::clamp(px / kCellPx, 0.0, static_cast<double>(count - 1)));
    };
    return {index(p.x(), columns_), index(p.y(), rows_)};
  }

  // Registers the segment in the cells of the bounding boxes of parts not longer than a cell.
  void Add(const Segment& segment) {
    const Eigen::Vector2d step = segment.p2 - segment.p1;
    const int parts = std::max(1, static_cast<int>(std::ceil(step.norm() / kCellPx)));
    for (int part = 0; part < parts; ++part) {
      Eigen::AlignedBox2d box(Eigen::Vector2d(segment.p1 + step * part / parts));
      box.extend(Eigen::Vector2d(segment.p1 + step * (part + 1) / parts));
      const auto [first_column, first_row] = CellOf(box.min());
      const auto [last_column, last_row] = CellOf(box.max());
      for (size_t row = first_row; row <= last_row; ++row) {
        for (size_t column = first_column; column <= last_column; ++column) {
          std::vector<size_t>& cell = cells_[row * columns_ + column];
          if (cell.empty() || cell.back() != segments_.size()) cell.push_back(segments_.size());
        }
      }
    }
    segments_.push_back(segment);
  }

  const size_t columns_, rows_;
  std::vector<std::vector<size_t>> cells_;
  std::vector<Segment> segments_;
  std::vector<uint64_t> last_query_;  // number of the latest query that visited each segment
  uint64_t query_ = 0;
};

// Appends the part of the segment in the triangle, moved to the object by its barycentric coordinates.
void AppendPiece(const Scene& scene, const PlacedTriangle& placed, const Segment& segment, std::vector<Piece>& pieces) {
  Eigen::Matrix2d sides;
  sides << placed.corners[1] - placed.corners[0], placed.corners[2] - placed.corners[0];
  if (std::abs(sides.determinant()) < 1e-3) return;  // square pixels: the image is not spread on it
  const Eigen::Matrix2d inverse = sides.inverse();
  const auto coordinates = [&](const Eigen::Vector2d& p) -> Eigen::Vector3d {
    const Eigen::Vector2d b = inverse * (p - placed.corners[0]);
    return {1.0 - b.sum(), b.x(), b.y()};
  };
  const Eigen::Vector3d begin = coordinates(segment.p1), step = coordinates(segment.p2) - begin;
  double from = 0.0, to = 1.0;
  for (int i = 0; i < 3; ++i) {
    if (step[i] > 0.0) from = std::max(from, -begin[i] / step[i]);
    if (step[i] < 0.0) to = std::min(to, -begin[i] / step[i]);
    if (step[i] == 0.0 && begin[i] < 0.0) return;
  }
  if (!(from < to)) return;
  const auto& corners = scene.mesh.triangles[placed.triangle];
  const auto on_object = [&](double s) -> Eigen::Vector3d {
    const Eigen::Vector3d b = begin + s * step;
    return b[0] * scene.mesh.points[corners[0]] + b[1] * scene.mesh.points[corners[1]] +
           b[2] * scene.mesh.points[corners[2]];
  };
  pieces.push_back({segment.edge, on_object(from), on_object(to)});
}

// Appends the pieces of one image; `contrasts` gets the contrast of each edge. False if the work was too much.
bool AppendPieces(const Scene& scene, int image, const TextureEdgeOptions& options, std::vector<Piece>& pieces,
                  std::vector<double>& contrasts) {
  const std::vector<PlacedTriangle> triangles = PlaceTriangles(scene, image);
  const cv::Mat& grey = scene.images[static_cast<size_t>(image)];
  const std::vector<TextureEdge> edges = FindTextureEdges(grey, MaskOf(triangles, grey.size()), options);
  SegmentGrid grid(edges, grey.size());
  const size_t first_edge = contrasts.size();
  for (const TextureEdge& edge : edges) contrasts.push_back(edge.contrast);
  size_t work = 0;
  for (const PlacedTriangle& triangle : triangles) {
    Eigen::AlignedBox2d box;
    for (const Eigen::Vector2d& corner : triangle.corners) box.extend(corner);
    const size_t first_piece = pieces.size();
    work += grid.ForEachNear(box, [&](const Segment& segment) { AppendPiece(scene, triangle, segment, pieces); });
    for (size_t i = first_piece; i < pieces.size(); ++i) pieces[i].edge += first_edge;
    if (work > kMaxComparisons) return false;
  }
  return true;
}

// The edges that become lines: those long enough, by falling product of length and contrast, while their pieces are at
// most `max_lines`.
std::vector<bool> Select(const std::vector<Piece>& pieces, const std::vector<double>& contrasts, double min_length,
                         size_t max_lines) {
  std::vector<double> lengths(contrasts.size(), 0.0);
  std::vector<size_t> counts(contrasts.size(), 0);
  for (const Piece& piece : pieces) {
    lengths[piece.edge] += (piece.p2 - piece.p1).norm();
    ++counts[piece.edge];
  }
  std::vector<size_t> order(contrasts.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return lengths[a] * contrasts[a] > lengths[b] * contrasts[b]; });
  std::vector<bool> is_selected(contrasts.size(), false);
  size_t total = 0;
  for (const size_t edge : order) {
    if (lengths[edge] < min_length || total + counts[edge] > max_lines) continue;
    total += counts[edge];
    is_selected[edge] = true;
  }
  return is_selected;
}

}  // namespace

absl::Status TextureLineOptions::Validate() const {
  constexpr double kMaxLines = 1e6;  // half of the triangles and lines that a server accepts
  EVPOSE_RETURN_IF_ERROR(CheckRange("TextureLineOptions.max_lines", static_cast<double>(max_lines), 0.0, kMaxLines));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TextureLineOptions.min_length_ratio", min_length_ratio, 0.0, 1.0));
  return edges.Validate();
}

absl::Status AddTextureLines(Scene& scene, const TextureLineOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  if (scene.images.empty()) return absl::OkStatus();
  std::vector<Piece> pieces;
  std::vector<double> contrasts;
  try {
    for (int image = 0; image < static_cast<int>(scene.images.size()); ++image) {
      if (!AppendPieces(scene, image, options.edges, pieces, contrasts)) {
        scene.notices.push_back("an image repeats too often on too many triangles: only some of its edges are used");
      }
    }
  } catch (const cv::Exception& error) {
    return absl::InvalidArgumentError(absl::StrCat("the edges of an image cannot be found: ", error.what()));
  }
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : scene.mesh.points) box.extend(point);
  const std::vector<bool> is_selected =
      Select(pieces, contrasts, options.min_length_ratio * box.diagonal().norm(), options.max_lines);
  size_t used = 0;
  for (const Piece& piece : pieces) {
    if (!is_selected[piece.edge]) continue;
    const auto first = static_cast<uint32_t>(scene.mesh.points.size());
    scene.mesh.points.push_back(piece.p1);
    scene.mesh.points.push_back(piece.p2);
    scene.mesh.lines.push_back({first, first + 1});
    ++used;
  }
  scene.notices.push_back(absl::StrCat("the edges of ", Counted(scene.images.size(), "image"), ": ",
                                       Counted(used, "painted line"), " of ", pieces.size(), " found"));
  return absl::OkStatus();
}

}  // namespace evpose::client
