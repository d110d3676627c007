// SPDX-License-Identifier: Apache-2.0
#include "core/mesh/types/raw_mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"

namespace evpose {
namespace {

// Searching one ear of a polygon with n corners takes up to n^2 steps, and the polygon has n - 2 ears.
constexpr size_t kMaxCorners = 512;

// The corner at which the diagonal of a quadrilateral begins: its concave corner if it has one, else the first.
size_t DiagonalCorner(absl::Span<const uint32_t> corners, absl::Span<const Eigen::Vector3d> points) {
  for (size_t i = 0; i < 4; ++i) {
    const auto side = [&](size_t offset) -> Eigen::Vector3d {
      return points[corners[(i + offset) % 4]] - points[corners[i]];
    };
    // The angles between the diagonal and the two sides exceed 180 degrees together when their cosines' sum is
    // negative.
    if ((side(1).normalized() + side(3).normalized()).dot(side(2)) < 0.0) return i;
  }
  return 0;
}

// The corners projected along the coordinate axis that is closest to the normal, counter-clockwise.
std::vector<Eigen::Vector2d> Project(absl::Span<const uint32_t> corners, absl::Span<const Eigen::Vector3d> points) {
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // by Newell's method: twice the area of each projection
  for (size_t i = 0; i < corners.size(); ++i) {
    normal += points[corners[i]].cross(points[corners[(i + 1) % corners.size()]]);
  }
  int dropped;
  normal.cwiseAbs().maxCoeff(&dropped);
  int first = (dropped + 1) % 3, second = (dropped + 2) % 3;
  if (normal[dropped] < 0.0) std::swap(first, second);
  std::vector<Eigen::Vector2d> projected;
  for (const uint32_t corner : corners) projected.push_back({points[corner][first], points[corner][second]});
  return projected;
}

bool IsInside(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c, const Eigen::Vector2d& p) {
  const Eigen::Vector2d ab = b - a, ac = c - a, ap = p - a;
  const double area = ab.x() * ac.y() - ab.y() * ac.x();
  if (area == 0.0) return false;
  const double u = (ap.x() * ac.y() - ap.y() * ac.x()) / area;
  const double v = (ab.x() * ap.y() - ab.y() * ap.x()) / area;
  return u > 0.0 && v > 0.0 && u + v < 1.0;
}

// Whether the triangle of three successive corners turns left or is flat, and contains no corner of the polygon.
bool IsEar(const std::vector<Eigen::Vector2d>& polygon, size_t i, size_t j, size_t k) {
  const Eigen::Vector2d &a = polygon[i], &b = polygon[j], &c = polygon[k];
  if (a.x() * (c.y() - b.y()) + b.x() * (a.y() - c.y()) + c.x() * (b.y() - a.y()) > 0.0) return false;
  for (const Eigen::Vector2d& p : polygon) {
    // Two corners may share one place: a hole is connected to the outline by two edges between the same points.
    if (p != a && p != b && p != c && IsInside(a, b, c, p)) return false;
  }
  return true;
}

}  // namespace

absl::Status ElementCounter::AddFace(size_t corners) {
  if (corners == 0) return absl::InvalidArgumentError("a face has no corners");
  if (corners > kMaxCorners) {
    return absl::InvalidArgumentError(
        absl::StrFormat("a face has %d corners, but at most %d are read; triangulate the model", corners, kMaxCorners));
  }
  return Add(std::max<size_t>(corners, 3) - 2);
}

absl::Status ElementCounter::AddLines(size_t count) { return Add(count); }

absl::Status ElementCounter::Add(size_t count) {
  elements_ += count;
  if (elements_ <= limits_.max_triangles) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("more than %d triangles and line elements; simplify the model", limits_.max_triangles));
}

Eigen::Vector3f StatedNormal(const Eigen::Vector3d& vector) {
  const double length = vector.norm();
  if (!std::isnormal(length)) return Eigen::Vector3f::Zero();
  return (vector / length).cast<float>();
}

void AppendPolygon(absl::Span<const uint32_t> corners, RawMesh& mesh, absl::Span<const Eigen::Vector3f> normals) {
  const auto append = [&](size_t i, size_t j, size_t k) {
    mesh.triangles.push_back({corners[i], corners[j], corners[k]});
    if (!normals.empty()) mesh.corner_normals.push_back({normals[i], normals[j], normals[k]});
  };
  if (corners.size() <= 3) return append(0, corners.size() > 1 ? 1 : 0, corners.size() - 1);
  if (corners.size() == 4) {
    const size_t first = DiagonalCorner(corners, mesh.points);
    append(first, (first + 1) % 4, (first + 2) % 4);
    append(first, (first + 2) % 4, (first + 3) % 4);
    return;
  }
  const std::vector<Eigen::Vector2d> polygon = Project(corners, mesh.points);
  std::vector<size_t> rest(corners.size());
  std::iota(rest.begin(), rest.end(), size_t{0});
  size_t at = 0, failures = 0;
  while (rest.size() > 3) {
    const size_t before = rest[(at + rest.size() - 1) % rest.size()], after = rest[(at + 1) % rest.size()];
    if (IsEar(polygon, before, rest[at], after)) {
      append(before, rest[at], after);
      rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(at));
      failures = 0;
    } else {
      // Every simple polygon has an ear (Meisters, "Polygons have ears", 1975): this one crosses itself.
      if (++failures == rest.size()) {
        ++mesh.cut_polygons;
        return;
      }
      ++at;
    }
    if (at == rest.size()) at = 0;
  }
  append(rest[0], rest[1], rest[2]);
}

void TakeNotices(RawMesh& mesh, std::vector<std::string>& notices) {
  std::move(mesh.notices.begin(), mesh.notices.end(), std::back_inserter(notices));
  mesh.notices.clear();
  if (mesh.cut_polygons == 0) return;
  notices.push_back(absl::StrCat(Counted(mesh.cut_polygons, "polygon"),
                                 " not read completely, because the outline crosses itself: the surface has holes "
                                 "there; export the model as triangles"));
  mesh.cut_polygons = 0;
}

}  // namespace evpose
