// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/ros_encoders.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/mcap/cdr_writer.h"
#include "client/mcap/diagnostics.h"
#include "client/mcap/event_png.h"
#include "client/mcap/mcap_testing.h"
#include "client/mcap/ros_types.h"
#include "core/geometry/rigid_transform.h"

namespace evpose::client {
namespace {

constexpr uint64_t kStampNs = 1'700'000'000'123'456'789;

MessageReader Decode(std::string_view type, std::string_view message) {
  return MessageReader(std::string(type), RosDefinition(type), message);
}

Transform ATransform() {
  Transform transform;
  transform.rotation = Eigen::Quaterniond(0.5, 0.5, -0.5, 0.5).toRotationMatrix();
  transform.translation_m = {0.1, -0.2, 1.5};
  return transform;
}

void ExpectPose(const MessageReader& message, const std::string& position, const std::string& rotation,
                const Transform& pose) {
  const Eigen::Quaterniond q = pose.Quaternion();
  EXPECT_EQ(message.Number(position + ".x"), pose.translation_m.x());
  EXPECT_EQ(message.Number(position + ".y"), pose.translation_m.y());
  EXPECT_EQ(message.Number(position + ".z"), pose.translation_m.z());
  EXPECT_EQ(message.Number(rotation + ".x"), q.x());
  EXPECT_EQ(message.Number(rotation + ".y"), q.y());
  EXPECT_EQ(message.Number(rotation + ".z"), q.z());
  EXPECT_EQ(message.Number(rotation + ".w"), q.w());
}

void ExpectHeader(const MessageReader& message, const std::string& header, const std::string& frame) {
  EXPECT_EQ(message.Number(header + ".stamp.sec"), 1'700'000'000);
  EXPECT_EQ(message.Number(header + ".stamp.nanosec"), 123'456'789);
  EXPECT_EQ(message.Text(header + ".frame_id"), frame);
}

TEST(CdrWriter, AlignsNumbersToTheirSizes) {
  CdrWriter out;
  out.Put(uint8_t{1});
  out.Put(uint16_t{0x0302});
  out.Put(uint8_t{4});
  out.Put(uint32_t{0x08070605});
  out.PutString("ab");
  out.Put(1.0);
  out.PutBytes("x");
  out.Put(0.5f);
  const std::string expected(
      "\x00\x01\x00\x00"                  // encapsulation: CDR, little-endian
      "\x01\x00\x02\x03\x04\x00\x00\x00"  // one byte, padding, two bytes, one byte, padding
      "\x05\x06\x07\x08"                  //
      "\x03\x00\x00\x00"
      "ab\x00\x00\x00\x00\x00\x00"  // the text, its zero, padding to 24
      "\x00\x00\x00\x00\x00\x00\xf0\x3f"
      "\x01\x00\x00\x00x\x00\x00\x00"
      "\x00\x00\x00\x3f",
      4 + 8 + 4 + 4 + 8 + 8 + 8 + 4);
  EXPECT_EQ(out.message(), expected);
}

TEST(RosTypes, EveryContainedTypeIsDefinedOnce) {
  for (const std::string_view type : {kPoseType, kTwistType, kTransformsType, kTextType, kCameraInfoType, kImageType,
                                      kMarkersType, kDiagnosticsType, kAnnotationsType}) {
    const std::string text = RosDefinition(type);
    EXPECT_FALSE(text.empty()) << type;
    const std::vector<std::string> lines = absl::StrSplit(text, '\n');
    std::map<std::string, int> defined;
    for (const std::string& line : lines) {
      if (line.starts_with("MSG: ")) ++defined[line.substr(5)];
    }
    for (const auto& [name, count] : defined) EXPECT_EQ(count, 1) << name;
    for (const std::string& line : lines) {
      const std::string field = line.substr(0, line.find_first_of(" ["));
      EXPECT_TRUE(!absl::StrContains(field, '/') || defined.contains(field)) << type << ": " << field;
    }
  }
  EXPECT_EQ(RosDefinition("nav_msgs/msg/Path"), "");
  EXPECT_EQ(RosDefinition(kTextType), "string data\n");
}

TEST(RosEncoders, APoseToTheBit) {
  Eigen::Matrix<double, 6, 6> covariance;
  for (int i = 0; i < 36; ++i) covariance(i / 6, i % 6) = std::sqrt(2.0 + i);
  covariance(2, 3) = std::numeric_limits<double>::quiet_NaN();
  covariance(4, 5) = -0.0;
  const std::string bytes = EncodePose({kStampNs, "evpose_camera"}, ATransform(), covariance);
  EXPECT_EQ(bytes.size(), 380u);  // 4, stamp 8, text 4 + 14, padding to 32, 7 and 36 doubles
  const MessageReader message = Decode(kPoseType, bytes);
  ExpectHeader(message, "header", "evpose_camera");
  ExpectPose(message, "pose.pose.position", "pose.pose.orientation", ATransform());
  for (int i = 0; i < 36; ++i) {
    EXPECT_EQ(std::bit_cast<uint64_t>(message.Number(absl::StrCat("pose.covariance[", i, "]"))),
              std::bit_cast<uint64_t>(covariance(i / 6, i % 6)));
  }
}

// REP 103 and geometry_msgs/PoseWithCovariance: small rotations about the fixed axes X, Y and Z of the frame.
TEST(RosEncoders, TheCovarianceOfRosIsThatOfThePerturbationOnTheLeft) {
  const RigidTransform pose = {ATransform().rotation, ATransform().translation_m};
  const auto about = [](double angle, const Eigen::Vector3d& axis) {
    return Eigen::AngleAxisd(angle, axis).toRotationMatrix();
  };
  for (int axis = 0; axis < 6; ++axis) {
    for (const double size : {1e-4, 1e-5}) {
      Vector6d xi = Vector6d::Zero();
      xi[axis] = size;
      xi[(axis + 1) % 6] = 0.5 * size;
      const Eigen::Matrix3d ros_rotation = about(xi[5], Eigen::Vector3d::UnitZ()) *
                                           about(xi[4], Eigen::Vector3d::UnitY()) *
                                           about(xi[3], Eigen::Vector3d::UnitX()) * pose.rotation;
      const RigidTransform perturbed = Perturb(pose, xi);
      EXPECT_LT((ros_rotation - perturbed.rotation).norm(), 2 * size * size);
      EXPECT_LT((pose.translation_m + xi.head<3>() - perturbed.translation_m).norm(), 1e-15);
    }
  }
}

TEST(RosEncoders, ATwistAndATransform) {
  Eigen::Matrix<double, 6, 1> twist;
  twist << 1, 2, 3, 4, 5, 6;
  const std::string twist_bytes = EncodeTwist({kStampNs, "world"}, twist);
  const MessageReader message = Decode(kTwistType, twist_bytes);
  ExpectHeader(message, "header", "world");
  EXPECT_EQ(message.Number("twist.linear.x"), 1);
  EXPECT_EQ(message.Number("twist.linear.z"), 3);
  EXPECT_EQ(message.Number("twist.angular.x"), 4);
  EXPECT_EQ(message.Number("twist.angular.z"), 6);

  const std::string transform_bytes = EncodeTransform({kStampNs, "evpose_camera"}, "left hand", ATransform());
  const MessageReader transform = Decode(kTransformsType, transform_bytes);
  EXPECT_EQ(transform.Number("transforms#"), 1);
  ExpectHeader(transform, "transforms[0].header", "evpose_camera");
  EXPECT_EQ(transform.Text("transforms[0].child_frame_id"), "left hand");
  ExpectPose(transform, "transforms[0].transform.translation", "transforms[0].transform.rotation", ATransform());
}

TEST(RosEncoders, CamerasOfAllLenses) {
  struct Lens {
    LensModel model;
    std::string name;
    int num_coefficients;
  };
  for (const Lens& lens :
       {Lens{LensModel::kBrown, "plumb_bob", 5}, Lens{LensModel::kRational, "rational_polynomial", 8},
        Lens{LensModel::kFisheye, "equidistant", 4}}) {
    Camera camera = {.width_px = 1280, .height_px = 720, .fx_px = 1700, .fy_px = 1701, .cx_px = 640.5, .cy_px = 359};
    camera.lens_model = lens.model;
    for (int i = 0; i < lens.num_coefficients; ++i) camera.distortion[static_cast<size_t>(i)] = 0.1 * i;
    const std::string bytes = EncodeCamera({kStampNs, "evpose_camera"}, camera);
    const MessageReader message = Decode(kCameraInfoType, bytes);
    ExpectHeader(message, "header", "evpose_camera");
    EXPECT_EQ(message.Number("width"), 1280);
    EXPECT_EQ(message.Number("height"), 720);
    EXPECT_EQ(message.Text("distortion_model"), lens.name);
    EXPECT_EQ(message.Number("d#"), lens.num_coefficients);
    for (int i = 0; i < lens.num_coefficients; ++i) EXPECT_EQ(message.Number(absl::StrCat("d[", i, "]")), 0.1 * i);
    const std::vector<double> k = {1700, 0, 640.5, 0, 1701, 359, 0, 0, 1};
    for (size_t i = 0; i < 9; ++i) EXPECT_EQ(message.Number(absl::StrCat("k[", i, "]")), k[i]);
    for (size_t i = 0; i < 9; ++i) EXPECT_EQ(message.Number(absl::StrCat("r[", i, "]")), i % 4 == 0 ? 1 : 0);
    const std::vector<double> p = {1700, 0, 640.5, 0, 0, 1701, 359, 0, 0, 0, 1, 0};
    for (size_t i = 0; i < 12; ++i) EXPECT_EQ(message.Number(absl::StrCat("p[", i, "]")), p[i]);
    EXPECT_EQ(message.Number("roi.width"), 0);
  }
}

TEST(RosEncoders, AModelAsTrianglesAndLines) {
  ModelGeometry geometry;
  geometry.vertices_m = {{0, 0, 0}, {3, 0, 0}, {0, 4, 0}, {0, 0, 1}};
  geometry.faces = {{0, 1, 2}, {0, 2, 3}};
  geometry.edges_m = {{Eigen::Vector3f(0, 0, 0), Eigen::Vector3f(3, 0, 0)}};
  const std::string bytes = EncodeModel("part", geometry);
  const MessageReader message = Decode(kMarkersType, bytes);
  EXPECT_EQ(message.Number("markers#"), 2);
  EXPECT_EQ(message.Number("markers[0].type"), 11);
  EXPECT_EQ(message.Number("markers[0].points#"), 6);
  EXPECT_EQ(message.Number("markers[0].points[4].y"), 4);
  EXPECT_EQ(message.Number("markers[0].points[5].z"), 1);
  EXPECT_EQ(message.Number("markers[0].scale.x"), 1);
  EXPECT_EQ(message.Number("markers[1].type"), 5);
  EXPECT_EQ(message.Number("markers[1].points#"), 2);
  EXPECT_NEAR(message.Number("markers[1].scale.x"), 0.004 * std::sqrt(26.0), 1e-8);
  for (const std::string marker : {"markers[0]", "markers[1]"}) {
    EXPECT_EQ(message.Text(marker + ".header.frame_id"), "part");
    EXPECT_EQ(message.Number(marker + ".header.stamp.sec"), 0);
    EXPECT_EQ(message.Number(marker + ".frame_locked"), 1);
    EXPECT_EQ(message.Number(marker + ".pose.orientation.w"), 1);
  }
  EXPECT_NE(message.Number("markers[0].id"), message.Number("markers[1].id"));
  const std::string nothing = EncodeModel("part", {});
  EXPECT_EQ(Decode(kMarkersType, nothing).Number("markers#"), 0);
}

TEST(RosEncoders, ImagesAndOutlines) {
  const std::string image_bytes = EncodeImage({kStampNs, "evpose_camera"}, "png", std::string("a\0b", 3));
  const MessageReader image = Decode(kImageType, image_bytes);
  ExpectHeader(image, "header", "evpose_camera");
  EXPECT_EQ(image.Text("format"), "png");
  EXPECT_EQ(image.Text("data"), std::string("a\0b", 3));

  std::vector<ObjectOutline> outlines(2);
  outlines[0].state = TrackState::kTracking;
  outlines[0].segments = {{{10.0f, 20.0f}, {30.5f, 40.0f}, EdgeKind::kCrease}, {{1, 2}, {3, 4}, EdgeKind::kBoundary}};
  outlines[1].state = TrackState::kDegraded;
  const std::string bytes = EncodeOutlines(kStampNs, outlines);
  const MessageReader message = Decode(kAnnotationsType, bytes);
  EXPECT_EQ(message.Number("points#"), 2);
  EXPECT_EQ(message.Number("points[0].timestamp.nanosec"), 123'456'789);
  EXPECT_EQ(message.Number("points[0].type"), 4);
  EXPECT_EQ(message.Number("points[0].points#"), 4);
  EXPECT_EQ(message.Number("points[0].points[0].x"), 10.5);  // of the corner of the first pixel
  EXPECT_EQ(message.Number("points[0].points[1].x"), 31.0);
  EXPECT_EQ(message.Number("points[0].points[3].y"), 4.5);
  EXPECT_GT(message.Number("points[0].outline_color.g"), message.Number("points[0].outline_color.r"));
  EXPECT_GT(message.Number("points[1].outline_color.r"), message.Number("points[1].outline_color.g"));
  EXPECT_EQ(message.Number("circles#"), 0);
  EXPECT_EQ(message.Number("texts#"), 0);
}

TEST(RosEncoders, DiagnosticsOfASession) {
  SessionHealth health;
  health.real_time_ratio = 1.5;
  health.processing.falls_behind = true;
  health.event_rate_hz = 1.25e6;
  health.latency_p99 = absl::Milliseconds(2);
  health.dropped_events = 3;
  ObjectHealth lost = {.object_id = "part", .state = TrackState::kLost, .losses = 2, .explained_ratio = 0.25f};
  lost.detail = "too few lines";
  lost.latest_loss = Loss{.t_us = 5, .cause = LossCause::kContradicted};
  health.objects = {lost, {.object_id = "other", .state = TrackState::kTracking}, {.object_id = "third"}};
  const std::string bytes = EncodeDiagnostics({kStampNs, ""}, "sessions/1", Diagnose(health));
  const MessageReader message = Decode(kDiagnosticsType, bytes);
  EXPECT_EQ(message.Number("status#"), 4);
  EXPECT_EQ(message.Text("status[0].name"), "evpose");
  EXPECT_EQ(message.Text("status[0].message"), "falls behind the camera");
  EXPECT_EQ(message.Number("status[0].level"), 1);
  EXPECT_EQ(message.Text("status[0].values[0].key"), "event rate [1/s]");
  EXPECT_EQ(message.Text("status[0].values[0].value"), "1.25e+06");
  EXPECT_EQ(message.Text("status[0].values[3].key"), "latency, 99th percentile [ms]");
  EXPECT_EQ(message.Text("status[1].name"), "evpose: part");
  EXPECT_EQ(message.Text("status[1].message"), "LOST: too few lines");
  EXPECT_EQ(message.Text("status[1].hardware_id"), "sessions/1");
  EXPECT_EQ(message.Number("status[1].level"), 2);
  EXPECT_EQ(message.Text("status[1].values[3].value"), "CONTRADICTED");
  EXPECT_EQ(message.Number("status[2].level"), 0);
  EXPECT_EQ(message.Text("status[3].message"), "INITIALIZING");
  EXPECT_EQ(message.Number("status[3].level"), 1);
}

TEST(EventPng, EveryPixelHasTheColourOfItsCell) {
  const std::vector<cv::Vec3b> colours = {{28, 24, 22}, {255, 190, 90}, {80, 90, 235}, {230, 230, 230}};  // blue first
  for (const int cell_px : {1, 2, 4}) {
    EventImage image = {.cell_px = cell_px, .width = 7, .height = 5};
    image.cells.resize((7 * 5 + 3) / 4);
    for (size_t i = 0; i < image.cells.size(); ++i) image.cells[i] = static_cast<uint8_t>(0x1b + 73 * i);
    // The last cells in each direction are incomplete.
    const int width = 7 * cell_px - (cell_px > 1 ? 1 : 0), height = 5 * cell_px - (cell_px > 1 ? 1 : 0);
    const std::string png = EventImagePng(image, width, height);
    const cv::Mat decoded = cv::imdecode(std::vector<uint8_t>(png.begin(), png.end()), cv::IMREAD_COLOR);
    ASSERT_EQ(decoded.size(), cv::Size(width, height));
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        ASSERT_EQ(decoded.at<cv::Vec3b>(y, x), colours[static_cast<size_t>(image.CellAt(x / cell_px, y / cell_px))])
            << cell_px << ": " << x << ", " << y;
      }
    }
  }
}

}  // namespace
}  // namespace evpose::client
