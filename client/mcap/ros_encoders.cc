// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/ros_encoders.h"

#include <algorithm>

#include "client/mcap/cdr_writer.h"

namespace evpose::client {
namespace {

constexpr uint64_t kNanosecondsPerSecond = 1'000'000'000;

struct Colour {
  double r, g, b, a;
};
// Translucent grey faces, so that a model behind them stays visible, and edges in bright green, which stands out from
// them and from the background of a viewer.
constexpr Colour kFaceColour = {0.55, 0.62, 0.70, 0.6};
constexpr Colour kEdgeColour = {0.43, 0.94, 0.43, 1.0};

void PutTime(uint64_t stamp_ns, CdrWriter& out) {
  out.Put(static_cast<int32_t>(stamp_ns / kNanosecondsPerSecond));
  out.Put(static_cast<uint32_t>(stamp_ns % kNanosecondsPerSecond));
}

void PutHeader(const RosHeader& header, CdrWriter& out) {
  PutTime(header.stamp_ns, out);
  out.PutString(header.frame_id);
}

void PutVector(const Eigen::Vector3d& vector, CdrWriter& out) {
  for (const double value : vector) out.Put(value);
}

void PutTransform(const Transform& transform, CdrWriter& out) {
  PutVector(transform.translation_m, out);
  const Eigen::Quaterniond q = transform.Quaternion();
  for (const double value : {q.x(), q.y(), q.z(), q.w()}) out.Put(value);
}

// std_msgs/ColorRGBA
void PutColour(const Colour& colour, CdrWriter& out) {
  for (const double value : {colour.r, colour.g, colour.b, colour.a}) out.Put(static_cast<float>(value));
}

// foxglove_msgs/Color
void PutFoxgloveColour(const Colour& colour, CdrWriter& out) {
  for (const double value : {colour.r, colour.g, colour.b, colour.a}) out.Put(value);
}

Colour StateColour(TrackState state) {
  switch (state) {
    case TrackState::kTracking:
      return kEdgeColour;
    case TrackState::kDegraded:
      return {0.96, 0.78, 0.20, 1.0};
    case TrackState::kAmbiguous:
      return {0.85, 0.45, 0.95, 1.0};
    default:
      return {0.92, 0.35, 0.31, 1.0};
  }
}

std::string_view LensName(LensModel model) {
  switch (model) {
    case LensModel::kRational:
      return "rational_polynomial";
    case LensModel::kFisheye:
      return "equidistant";
    default:
      return "plumb_bob";
  }
}

size_t NumLensCoefficients(LensModel model) {
  switch (model) {
    case LensModel::kRational:
      return 8;
    case LensModel::kFisheye:
      return 4;
    default:
      return 5;
  }
}

// The diagonal of the bounding box, metres.
double SizeOf(const ModelGeometry& geometry) {
  Eigen::AlignedBox3f box;
  for (const Eigen::Vector3f& vertex : geometry.vertices_m) box.extend(vertex);
  for (const auto& edge : geometry.edges_m) box.extend(edge[0]).extend(edge[1]);
  return box.isEmpty() ? 0.0 : static_cast<double>(box.diagonal().norm());
}

// visualization_msgs/Marker
void PutMarker(std::string_view frame, int32_t id, int32_t type, double scale_m, const Colour& colour,
               const std::vector<Eigen::Vector3f>& points, CdrWriter& out) {
  PutHeader({.stamp_ns = 0, .frame_id = std::string(frame)}, out);  // time 0: at the latest pose
  out.PutString("model");
  out.Put(id);
  out.Put(type);
  out.Put<int32_t>(0);  // add
  PutTransform({}, out);
  PutVector(Eigen::Vector3d::Constant(scale_m), out);
  PutColour(colour, out);
  out.Put<int32_t>(0);  // lifetime: without end
  out.Put<uint32_t>(0);
  out.Put<uint8_t>(1);  // moves with its frame
  out.PutCount(points.size());
  for (const Eigen::Vector3f& point : points) PutVector(point.cast<double>(), out);
  out.PutCount(0);  // colours of the points
  out.PutString("");
  PutHeader({}, out);  // texture: header, format, bytes
  out.PutString("");
  out.PutCount(0);
  out.PutCount(0);  // coordinates in the texture
  out.PutString("");
  out.PutString("");
  out.PutString("");  // mesh file: name, bytes
  out.PutCount(0);
  out.Put<uint8_t>(0);
}

}  // namespace

std::string EncodePose(const RosHeader& header, const Transform& pose, const Eigen::Matrix<double, 6, 6>& covariance) {
  CdrWriter out;
  PutHeader(header, out);
  PutTransform(pose, out);
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 6; ++column) out.Put(covariance(row, column));
  }
  return out.message();
}

std::string EncodeTwist(const RosHeader& header, const Eigen::Matrix<double, 6, 1>& twist) {
  CdrWriter out;
  PutHeader(header, out);
  for (const double value : twist) out.Put(value);
  return out.message();
}

std::string EncodeTransform(const RosHeader& header, std::string_view child, const Transform& header_from_child) {
  CdrWriter out;
  out.PutCount(1);
  PutHeader(header, out);
  out.PutString(child);
  PutTransform(header_from_child, out);
  return out.message();
}

std::string EncodeText(std::string_view text) {
  CdrWriter out;
  out.PutString(text);
  return out.message();
}

std::string EncodeCamera(const RosHeader& header, const Camera& camera) {
  CdrWriter out;
  PutHeader(header, out);
  out.Put(static_cast<uint32_t>(camera.height_px));
  out.Put(static_cast<uint32_t>(camera.width_px));
  out.PutString(LensName(camera.lens_model));
  const size_t num_coefficients = NumLensCoefficients(camera.lens_model);
  out.PutCount(num_coefficients);
  for (size_t i = 0; i < num_coefficients; ++i) out.Put(camera.distortion[i]);
  Eigen::Matrix<double, 3, 4> projection = Eigen::Matrix<double, 3, 4>::Identity();
  projection(0, 0) = camera.fx_px;
  projection(1, 1) = camera.fy_px;
  projection(0, 2) = camera.cx_px;
  projection(1, 2) = camera.cy_px;
  const auto put_rows = [&out](const auto& matrix, int num_columns) {
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < num_columns; ++column) out.Put(static_cast<double>(matrix(row, column)));
    }
  };
  put_rows(projection, 3);                                    // k
  put_rows(Eigen::Matrix3d(Eigen::Matrix3d::Identity()), 3);  // r
  put_rows(projection, 4);                                    // p
  for (int i = 0; i < 6; ++i) out.Put<uint32_t>(0);           // binning, region of interest: the whole image
  out.Put<uint8_t>(0);
  return out.message();
}

std::string EncodeModel(std::string_view object_frame, const ModelGeometry& geometry) {
  constexpr int32_t kLineList = 5, kTriangleList = 11;
  constexpr double kLineWidth = 0.004;  // width of the lines, relative to the model's size
  std::vector<Eigen::Vector3f> corners, ends;
  for (const auto& face : geometry.faces) {
    for (const uint32_t vertex : face) corners.push_back(geometry.vertices_m[vertex]);
  }
  for (const auto& edge : geometry.edges_m) ends.insert(ends.end(), edge.begin(), edge.end());
  CdrWriter out;
  // A list of no points is an error in some viewers.
  out.PutCount((corners.empty() ? 0 : 1) + (ends.empty() ? 0 : 1));
  if (!corners.empty()) PutMarker(object_frame, 0, kTriangleList, 1.0, kFaceColour, corners, out);
  if (!ends.empty()) PutMarker(object_frame, 1, kLineList, kLineWidth * SizeOf(geometry), kEdgeColour, ends, out);
  return out.message();
}

std::string EncodeImage(const RosHeader& header, std::string_view format, std::string_view bytes) {
  CdrWriter out;
  PutHeader(header, out);
  out.PutString(format);
  out.PutBytes(bytes);
  return out.message();
}

std::string EncodeOutlines(uint64_t stamp_ns, const std::vector<ObjectOutline>& outlines) {
  constexpr uint8_t kLineList = 4;
  constexpr double kThicknessPx = 1.5;  // width of the lines in a viewer
  CdrWriter out;
  out.PutCount(0);  // circles
  out.PutCount(outlines.size());
  for (const ObjectOutline& outline : outlines) {
    PutTime(stamp_ns, out);
    out.Put(kLineList);
    out.PutCount(2 * outline.segments.size());
    for (const ObjectOutline::Segment& segment : outline.segments) {
      for (const Eigen::Vector2f& end_px : {segment.p1_px, segment.p2_px}) {
        // Foxglove: (0, 0) is the corner of the first pixel, not its centre.
        out.Put(static_cast<double>(end_px.x()) + 0.5);
        out.Put(static_cast<double>(end_px.y()) + 0.5);
      }
    }
    PutFoxgloveColour(StateColour(outline.state), out);
    out.PutCount(0);  // colours of the segments
    PutFoxgloveColour({0, 0, 0, 0}, out);
    out.Put(kThicknessPx);
  }
  out.PutCount(0);  // texts
  return out.message();
}

std::string EncodeDiagnostics(const RosHeader& header, std::string_view hardware_id,
                              const std::vector<RosStatus>& statuses) {
  CdrWriter out;
  PutHeader(header, out);
  out.PutCount(statuses.size());
  for (const RosStatus& status : statuses) {
    out.Put(static_cast<uint8_t>(status.level));
    out.PutString(status.name);
    out.PutString(status.message);
    out.PutString(hardware_id);
    out.PutCount(status.values.size());
    for (const auto& [key, value] : status.values) {
      out.PutString(key);
      out.PutString(value);
    }
  }
  return out.message();
}

}  // namespace evpose::client
