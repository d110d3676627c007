// SPDX-License-Identifier: Apache-2.0
#include "core/association/element_arcs.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/base/yield_point.h"
#include "core/geometry/image_clip.h"

namespace evpose {
namespace {

// Least cosine of the turn of an arc: 25 degrees, up to which a circle differs from a parabola by 3e-4 of its radius.
constexpr double kLeastArcCosine = 0.906;
// Largest distance, pixels, of the elements of an arc from the parabola. The error is systematic: 0.1 px would move the
// depth of an object of 200 px by 0.05 %; arcs within 0.1 px would save no time.
constexpr double kMaxArcErrorPx = 0.03;
// Largest sagitta that the turn between two elements of a smooth curve implies, relative to
// EdgeElementOptions::sagitta_px. Where the curve has a corner between long elements, it is larger.
constexpr double kMaxSagittaRatio = 1.5;

// Equation (11) of the README in the image, pixels: the displacement of the chord to the mean of the arc, and the
// sagitta, both along the normal (-y, x) of the chord's direction (x, y).
struct Arc {
  double mean_px = 0.0;
  double sagitta_px = 0.0;
};

// The image of an element of a chain.
struct Link {
  int index = 0;
  Eigen::Vector2d p1_px, p2_px;
  Eigen::Vector2d direction = Eigen::Vector2d::Zero();  // unit
  double length_px = 0.0;
};

Eigen::Vector2d NormalOf(const Eigen::Vector2d& direction) { return {-direction.y(), direction.x()}; }

// Fits an arc to the elements of a run; nullopt if one of them is farther from it than kMaxArcErrorPx.
std::optional<Arc> FitArc(absl::Span<const Link> run) {
  const Eigen::Vector2d chord = run.back().p2_px - run.front().p1_px;
  const double chord_px = chord.norm();
  if (!(chord_px > 0.0)) return std::nullopt;
  const Eigen::Vector2d along = chord / chord_px, normal = NormalOf(along);
  // The middle of an element relative to the first end of the chord, its position from -1 to 1, and the mean of 1/3 -
  // position^2 over the element.
  const auto middle_of = [&](const Link& link) {
    return Eigen::Vector2d(0.5 * (link.p1_px + link.p2_px) - run.front().p1_px);
  };
  const auto position_of = [&](const Link& link) { return 2.0 * middle_of(link).dot(along) / chord_px - 1.0; };
  const auto shape_of = [&](const Link& link) {
    const double position = position_of(link), half = link.length_px / chord_px;
    return 1.0 / 3.0 - position * position - half * half / 3.0;
  };
  double slopes = 0.0, squares = 0.0, offsets = 0.0, shapes = 0.0, length_px = 0.0;
  for (const Link& link : run) {
    const double position = position_of(link);
    slopes += link.length_px * position * link.direction.dot(normal) / link.direction.dot(along);
    squares += link.length_px * position * position;
    offsets += link.length_px * middle_of(link).dot(normal);
    shapes += link.length_px * shape_of(link);
    length_px += link.length_px;
  }
  Arc arc;
  arc.sagitta_px = -0.25 * chord_px * slopes / squares;
  arc.mean_px = (offsets - shapes * arc.sagitta_px) / length_px;
  for (const Link& link : run) {
    const double error_px = middle_of(link).dot(normal) - arc.mean_px - shape_of(link) * arc.sagitta_px;
    if (!(std::abs(error_px) <= kMaxArcErrorPx)) return std::nullopt;
  }
  return arc;
}

class ArcJoiner {
 public:
  ArcJoiner(const CameraModel& camera, const RigidTransform& camera_from_object, const EdgeElementOptions& options,
            const std::vector<EdgeElement>& elements, const std::vector<TrackedLine>& lines)
      : camera_(camera),
        camera_from_object_(camera_from_object),
        options_(options),
        elements_(elements),
        lines_(lines),
        arc_of_(lines.size(), -1) {}

  void Join(std::vector<EdgeElement>& elements, std::vector<TrackedLine>& lines) {
    elements.clear();
    lines.clear();
    for (size_t k = 0; k < lines_.size(); ++k) {
      YieldPoint(k);
      if (arc_of_[k] >= 0) continue;
      const std::vector<Link> chain = ChainOf(static_cast<int>(k));
      for (size_t begin = 0, end; begin < chain.size(); begin = end) {
        std::optional<Arc> arc;
        end = LongestRun(chain, begin, arc);
        Append(absl::MakeConstSpan(chain).subspan(begin, end - begin), arc, elements, lines);
      }
    }
    for (TrackedLine& line : lines) {
      if (line.previous >= 0) line.previous = arc_of_[line.previous];
      if (line.next >= 0) line.next = arc_of_[line.next];
    }
  }

 private:
  bool IsOneCurve(int a, int b) const {
    return elements_[a].curve == elements_[b].curve && lines_[a].kind == lines_[b].kind &&
           lines_[a].prior_contrast == lines_[b].prior_contrast;
  }

  // The elements that are connected with element `k`, in the order of their links.
  std::vector<Link> ChainOf(int k) const {
    int first = k;
    for (int before = lines_[k].previous; before >= 0 && before != k && IsOneCurve(before, first);
         before = lines_[first].previous) {
      first = before;
    }
    std::vector<Link> chain;
    for (int at = first;;) {
      chain.push_back(LinkOf(at));
      const int next = lines_[at].next;
      if (next < 0 || next == first || !IsOneCurve(at, next)) return chain;
      at = next;
    }
  }

  Link LinkOf(int index) const {
    const TrackedLine& line = lines_[index];
    const auto project = [&](const Eigen::Vector3d& point_object) {
      Eigen::Vector3d point = camera_from_object_ * point_object;
      point.z() = std::max(point.z(), kClipDepthM);  // elements are cut there up to rounding
      return camera_.Project(point);
    };
    Link link{index, project(line.p1), project(line.p2), Eigen::Vector2d::Zero(), 0.0};
    const Eigen::Vector2d extent = link.p2_px - link.p1_px;
    link.length_px = extent.norm();
    if (link.length_px > 0.0) link.direction = extent / link.length_px;
    return link;
  }

  // Whether the curve is smooth from one element to the next.
  bool IsSmooth(const Link& a, const Link& b) const {
    const double turn = a.direction.x() * b.direction.y() - a.direction.y() * b.direction.x();
    // An arc that turns by `turn` over the length of its chord has the sagitta turn * length / 8; the length is the
    // mean of both elements, and the sine of the turn stands for the turn.
    const double sagitta_px = std::abs(turn) * (a.length_px + b.length_px) / 16.0;
    return a.direction.dot(b.direction) > 0.0 && sagitta_px <= kMaxSagittaRatio * options_.sagitta_px;
  }

  // Returns the end of the longest run from `begin` that is an arc; `arc` is empty for one element.
  size_t LongestRun(const std::vector<Link>& chain, size_t begin, std::optional<Arc>& arc) const {
    double length_px = chain[begin].length_px;
    size_t end = begin + 1;
    for (; end < chain.size(); ++end) {
      length_px += chain[end].length_px;
      if (!(length_px <= options_.max_arc_px) || !IsSmooth(chain[end - 1], chain[end])) break;
      if (!(chain[begin].direction.dot(chain[end].direction) >= kLeastArcCosine)) break;
      const std::optional<Arc> longer = FitArc(absl::MakeConstSpan(chain).subspan(begin, end + 1 - begin));
      if (!longer) break;
      arc = longer;
    }
    return end;
  }

  // The vector, object frame, parallel to the image across the line through `p1` and `p2` (object frame), that moves
  // the image of `point` by one pixel along `normal`; zero if there is none.
  Eigen::Vector3d MoveOfPixel(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2, const Eigen::Vector2d& normal,
                              const Eigen::Vector3d& point_object) const {
    const Eigen::Vector3d point = camera_from_object_ * point_object;
    const Eigen::Vector3d across = (camera_from_object_ * p1).cross(camera_from_object_ * p2).normalized();
    const Eigen::Vector2d moved(camera_.fx_px * (across.x() - across.z() * point.x() / point.z()) / point.z(),
                                camera_.fy_px * (across.y() - across.z() * point.y() / point.z()) / point.z());
    const double pixels = moved.dot(normal);
    if (!(std::abs(pixels) > 0.0)) return Eigen::Vector3d::Zero();
    return camera_from_object_.rotation.transpose() * across / pixels;
  }

  void Append(absl::Span<const Link> run, const std::optional<Arc>& arc, std::vector<EdgeElement>& elements,
              std::vector<TrackedLine>& lines) {
    for (const Link& link : run) arc_of_[link.index] = static_cast<int>(lines.size());
    const EdgeElement& last = elements_[run.back().index];
    EdgeElement& element = elements.emplace_back(elements_[run.front().index]);
    TrackedLine& line = lines.emplace_back(lines_[run.front().index]);
    if (!arc) return;
    const Eigen::Vector2d normal = NormalOf((run.back().p2_px - run.front().p1_px).normalized());
    const auto move_at = [&, p1 = element.p1](const Eigen::Vector3d& point) {
      return MoveOfPixel(p1, last.p2, normal, point);
    };
    line.next = lines_[run.back().index].next;
    line.sagitta = arc->sagitta_px * move_at(0.5 * (element.p1 + last.p2));
    line.p1 = element.p1 + arc->mean_px * move_at(element.p1);
    line.p2 = last.p2 + arc->mean_px * move_at(last.p2);
    element.p1 = line.p1;
    element.p2 = line.p2;
    if (element.kind != EdgeKind::kContour) return;
    element.normals[1] = last.normals[1];
    element.radius_m[1] = last.radius_m[1];
  }

  const CameraModel& camera_;
  const RigidTransform& camera_from_object_;
  const EdgeElementOptions& options_;
  const std::vector<EdgeElement>& elements_;
  const std::vector<TrackedLine>& lines_;
  std::vector<int> arc_of_;  // index of the arc of each element; -1: not joined yet
};

}  // namespace

void JoinArcs(const CameraModel& camera, const RigidTransform& camera_from_object, const EdgeElementOptions& options,
              std::vector<EdgeElement>& elements, std::vector<TrackedLine>& lines) {
  const std::vector<EdgeElement> all_elements = elements;
  const std::vector<TrackedLine> all_lines = lines;
  ArcJoiner(camera, camera_from_object, options, all_elements, all_lines).Join(elements, lines);
}

}  // namespace evpose
