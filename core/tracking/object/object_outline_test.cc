// SPDX-License-Identifier: Apache-2.0

// The outlines of tracked objects, on ideal events: where their segments lie, and that reading them changes nothing.
#include "core/tracking/object/object_outline.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <vector>

#include "core/contours/contour_shapes_testing.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

using testing::ConstantTwist;
using testing::IdealEventOptions;
using testing::MakeIdealEvents;
using testing::MakePose;

Eigen::Vector2d OutlinePixelOf(const CameraModel& camera, const Eigen::Vector3d& point) {
  const DistortedPoint distorted = DistortNormalised(camera.lens_model, camera.distortion, point.head<2>() / point.z());
  return {camera.fx_px * distorted.point.x() + camera.cx_px, camera.fy_px * distorted.point.y() + camera.cy_px};
}

double SegmentDistancePx(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& at) {
  const Eigen::Vector2d along = b - a;
  const double share = std::clamp(along.dot(at - a) / along.squaredNorm(), 0.0, 1.0);
  return (at - a - share * along).norm();
}

// Distance from the image of the nearest of the model's lines, whose images are curves: sampled finely.
double LinesDistancePx(const CameraModel& camera, const RigidTransform& pose, const ObjectModel& model,
                       const Eigen::Vector2d& at) {
  constexpr int kSamples = 400;
  double nearest_px = std::numeric_limits<double>::infinity();
  for (const ModelLine& line : model.lines) {
    Eigen::Vector2d before = OutlinePixelOf(camera, pose * line.p1);
    for (int i = 1; i <= kSamples; ++i) {
      const Eigen::Vector2d now =
          OutlinePixelOf(camera, pose * Eigen::Vector3d(line.p1 + (line.p2 - line.p1) * i / kSamples));
      nearest_px = std::min(nearest_px, SegmentDistancePx(before, now, at));
      before = now;
    }
  }
  return nearest_px;
}

struct Outlined {
  std::vector<PoseEstimate> estimates;
  std::vector<ObjectOutline> outlines;  // after each piece of the events; without those of an object without a pose
};

// The events that a sensor behind the lens has; those of MakeIdealEvents() are of a lens without distortion.
std::vector<Event> EventsBehind(const CameraModel& lens, const ObjectModel& model, const testing::Motion& motion) {
  // As large as the undistorted image: the scene lies in its middle half.
  CameraModel plane = testing::MakeCamera(3 * lens.width_px, 3 * lens.height_px, lens.fx_px);
  plane.cx_px = lens.cx_px + lens.width_px;
  plane.cy_px = lens.cy_px + lens.height_px;
  IdealEventOptions ideal;
  ideal.duration_us = 60'000;
  ideal.sigma_px = 0.3;
  std::vector<Event> events;
  for (Event event : MakeIdealEvents(model, plane, motion, ideal)) {
    const Eigen::Vector2d undistorted_px(event.x - lens.width_px, event.y - lens.height_px);
    if (!lens.IsInImage(undistorted_px)) continue;
    const Eigen::Vector2d pixel = lens.Distort(undistorted_px);
    event.x = static_cast<uint16_t>(std::lround(std::max(0.0, pixel.x())));
    event.y = static_cast<uint16_t>(std::lround(std::max(0.0, pixel.y())));
    events.push_back(event);
  }
  return events;
}

// Few enough for ten outlines of an object that is small in the image.
constexpr size_t kPieceEvents = 250;

// Tracks events in pieces, with or without asking for the outline after each.
Outlined TrackOutlined(const std::shared_ptr<const ObjectModel>& model, const CameraModel& camera,
                       const RigidTransform& start, const Vector6d& twist, bool asks) {
  const std::vector<Event> events = EventsBehind(camera, *model, ConstantTwist(start, twist));
  const auto tracker = Tracker::Create(model, camera, WithoutInitialization(), start).value();
  Outlined run;
  for (size_t at = 0; at < events.size(); at += kPieceEvents) {
    tracker->AddEvents(absl::MakeConstSpan(events).subspan(at, kPieceEvents), run.estimates);
    ObjectOutline outline;
    if (asks && tracker->Outline(0, outline)) run.outlines.push_back(outline);
  }
  tracker->Finish(run.estimates);
  return run;
}

CameraModel DistortedCamera() {
  CameraModel camera = kCamera;
  camera.distortion = {-0.32, 0.11, 0.001, -0.002};
  return camera;
}

// A lens of 120 degrees on the diagonal, with the object 40 degrees beside the axis: in a turned view.
CameraModel FisheyeCamera() {
  CameraModel camera = kCamera;
  camera.fx_px = camera.fy_px = 240.0;
  camera.distortion = {-0.02, 0.004, 0.0, 0.0};
  camera.lens_model = LensModel::kFisheye;
  return camera;
}
const RigidTransform kBesideAxis = testing::MakePose({0.42, -0.05, 0.45}, {0.6, 0.5, 0.2});
const Vector6d kOutlineTwist = Twist(0.05, -0.1, 0.02, 1.0, -2.0, 0.7);

// The segments of a cube lie on the images of its lines, and cover those that are visible.
void ExpectOnLines(const CameraModel& camera, const RigidTransform& start) {
  const auto cube = Cube();
  const Outlined run = TrackOutlined(cube, camera, start, kOutlineTwist, true);
  ASSERT_GT(run.outlines.size(), 10u);
  const ObjectOutline& outline = run.outlines.back();
  EXPECT_EQ(outline.state, TrackState::kTracking);
  EXPECT_GE(outline.edges.size(), 3u);
  EXPECT_LE(outline.edges.size(), 12u);
  const std::vector<OutlineSegment> segments = ProjectOutline(camera, outline);
  ASSERT_GE(segments.size(), outline.edges.size());
  double length_px = 0.0, straight_px = 0.0;
  for (const OutlineSegment& segment : segments) {
    EXPECT_EQ(segment.kind, EdgeKind::kCrease);
    const Eigen::Vector2d p1 = segment.p1_px.cast<double>(), p2 = segment.p2_px.cast<double>();
    for (const double share : {0.0, 0.25, 0.5, 0.75, 1.0}) {
      EXPECT_LT(LinesDistancePx(camera, outline.camera_from_object, *cube, p1 + share * (p2 - p1)), 0.1);
    }
    length_px += (p2 - p1).norm();
  }
  for (const ObjectOutline::Edge& edge : outline.edges) {
    straight_px += (OutlinePixelOf(camera, outline.camera_from_object * edge.p1) -
                    OutlinePixelOf(camera, outline.camera_from_object * edge.p2))
                       .norm();
  }
  EXPECT_GE(length_px, 0.999 * straight_px);  // nothing is left out
  EXPECT_LE(length_px, 1.02 * straight_px);   // nothing is drawn twice
}

TEST(ObjectOutlineTest, SegmentsOfACubeLieOnItsLines) {
  ExpectOnLines(kCamera, kStart);
  ExpectOnLines(DistortedCamera(), kStart);
  ExpectOnLines(FisheyeCamera(), kBesideAxis);
}

// The outline has the latest pose, to the bit, and asking for it changes no pose.
TEST(ObjectOutlineTest, HasTheLatestPoseAndChangesNone) {
  for (const bool is_fisheye : {false, true}) {
    const CameraModel camera = is_fisheye ? FisheyeCamera() : DistortedCamera();
    const RigidTransform start = is_fisheye ? kBesideAxis : kStart;
    const Outlined asked = TrackOutlined(Cube(), camera, start, kOutlineTwist, true);
    const Outlined not_asked = TrackOutlined(Cube(), camera, start, kOutlineTwist, false);
    ASSERT_EQ(asked.estimates.size(), not_asked.estimates.size());
    std::map<int64_t, const PoseEstimate*> by_time;
    for (size_t i = 0; i < asked.estimates.size(); ++i) {
      const PoseEstimate &a = asked.estimates[i], &b = not_asked.estimates[i];
      EXPECT_EQ(a.t_us, b.t_us);
      EXPECT_EQ(a.camera_from_object.rotation, b.camera_from_object.rotation);
      EXPECT_EQ(a.camera_from_object.translation_m, b.camera_from_object.translation_m);
      EXPECT_EQ(a.covariance, b.covariance);
      by_time[a.t_us] = &a;
    }
    ASSERT_GT(asked.outlines.size(), 10u);
    for (const ObjectOutline& outline : asked.outlines) {
      ASSERT_TRUE(by_time.contains(outline.t_us));
      const PoseEstimate& published = *by_time[outline.t_us];
      EXPECT_EQ(outline.state, published.state);
      EXPECT_EQ(outline.camera_from_object.rotation, published.camera_from_object.rotation);
      EXPECT_EQ(outline.camera_from_object.translation_m, published.camera_from_object.translation_m);
    }
  }
}

// The contour of a capsule: every point of its image lies on the outline of the sphere or the cylinder, so that the
// ray through it is at the distance of the radius from the axis of the capsule.
TEST(ObjectOutlineTest, ContoursOfACapsuleTouchItsSurface) {
  constexpr double kRadius = 0.05, kHalf = 0.04;
  auto capsule = std::make_shared<ObjectModel>(CapsuleModel(kHalf, kRadius, 96, 48));
  capsule->continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, {0, 0, 0}, {0, 0, 1}, true};
  const Outlined run =
      TrackOutlined(capsule, kCamera, MakePose({0.02, -0.01, 0.6}, {1.2, 0.3, 0.0}), kOutlineTwist, true);
  ASSERT_FALSE(run.outlines.empty());
  const ObjectOutline& outline = run.outlines.back();
  const std::vector<OutlineSegment> segments = ProjectOutline(kCamera, outline);
  EXPECT_GT(segments.size(), outline.edges.size());  // arcs are drawn as several segments
  const RigidTransform object_from_camera = outline.camera_from_object.Inverse();
  for (const OutlineSegment& segment : segments) {
    EXPECT_EQ(segment.kind, EdgeKind::kContour);
    const Eigen::Vector2d middle = 0.5 * (segment.p1_px + segment.p2_px).cast<double>();
    const Eigen::Vector3d ray = object_from_camera.rotation * BearingOf(kCamera, middle).normalized();
    double nearest_m = std::numeric_limits<double>::infinity(), depth_m = 0.0;
    for (double z = -kHalf; z <= kHalf; z += kHalf / 200) {
      const Eigen::Vector3d to_axis = Eigen::Vector3d(0, 0, z) - object_from_camera.translation_m;
      const double distance_m = to_axis.cross(ray).norm();
      if (distance_m >= nearest_m) continue;
      nearest_m = distance_m;
      depth_m = to_axis.dot(ray);
    }
    EXPECT_LT(std::abs(nearest_m - kRadius) / depth_m * kCamera.fx_px, 0.5);
  }
}

// A session asks after each slice of events, and several slices can belong to one window.
TEST(ObjectOutlineTest, EdgesAreCopiedOnceForEachWindow) {
  const std::vector<Event> events = EventsBehind(kCamera, *Cube(), ConstantTwist(kStart, kOutlineTwist));
  const auto tracker = Tracker::Create(Cube(), kCamera, WithoutInitialization(), kStart).value();
  std::vector<PoseEstimate> estimates;
  ObjectOutline kept;
  int num_calls = 0, num_copies = 0;
  std::set<int64_t> times_us;
  for (size_t at = 0; at < events.size(); at += kPieceEvents / 10) {
    tracker->AddEvents(absl::MakeConstSpan(events).subspan(at, kPieceEvents / 10), estimates);
    ObjectOutline copied;
    if (!tracker->Outline(0, copied)) continue;
    times_us.insert(copied.t_us);
    const ObjectOutline before = kept;
    kept.edges.clear();  // shows whether the edges are copied
    ASSERT_TRUE(tracker->Outline(0, kept));
    ++num_calls;
    if (kept.edges.empty()) {
      kept.edges = before.edges;
    } else {
      ++num_copies;
    }
    EXPECT_EQ(kept.t_us, copied.t_us);
    EXPECT_EQ(kept.state, copied.state);
    EXPECT_EQ(kept.camera_from_object, copied.camera_from_object);
    ASSERT_EQ(kept.edges.size(), copied.edges.size());
    for (size_t i = 0; i < kept.edges.size(); ++i) {
      EXPECT_EQ(kept.edges[i].p1, copied.edges[i].p1);
      EXPECT_EQ(kept.edges[i].p2, copied.edges[i].p2);
    }
  }
  EXPECT_EQ(static_cast<size_t>(num_copies), times_us.size());
  EXPECT_GT(num_calls, 2 * num_copies);
}

TEST(ObjectOutlineTest, AnObjectWithoutAPoseHasNone) {
  const auto tracker = Tracker::Create(Cube(), kCamera, WithoutInitialization(), kStart).value();
  ObjectOutline outline;
  EXPECT_FALSE(tracker->Outline(0, outline));
}

ObjectOutline OneEdge(const Eigen::Vector3d& p1, const Eigen::Vector3d& p2) {
  ObjectOutline outline;
  outline.edges.push_back({p1, p2, Eigen::Vector3d::Zero(), EdgeKind::kBoundary});
  return outline;
}

TEST(ProjectOutlineTest, LeavesOutWhatTheCameraCannotShow) {
  EXPECT_EQ(ProjectOutline(kCamera, OneEdge({0, 0, 1}, {0.1, 0, 1})).size(), 1u);
  EXPECT_TRUE(ProjectOutline(kCamera, OneEdge({0, 0, -1}, {0.1, 0, -1})).empty());
  EXPECT_TRUE(ProjectOutline(kCamera, OneEdge({9, 0, 1}, {9, 1, 1})).empty());
  // Half of a line is behind the camera: of the rest, the part near the image remains.
  const std::vector<OutlineSegment> cut = ProjectOutline(kCamera, OneEdge({0.2, 0.1, 1}, {0.2, 0.1, -1}));
  ASSERT_FALSE(cut.empty());
  for (const OutlineSegment& segment : cut) {
    EXPECT_EQ(segment.kind, EdgeKind::kBoundary);
    EXPECT_TRUE(segment.p1_px.allFinite() && segment.p2_px.allFinite());
    EXPECT_LT(segment.p2_px.x(), 2 * 640);
  }
}

TEST(ProjectOutlineTest, BoundsTheNumberOfSegments) {
  ObjectOutline outline = OneEdge({0, 0, 1}, {0.1, 0, 1});
  outline.edges.resize(3 * kMaxOutlineSegments, outline.edges.front());
  EXPECT_EQ(ProjectOutline(kCamera, outline).size(), kMaxOutlineSegments);
}

}  // namespace
}  // namespace evpose
