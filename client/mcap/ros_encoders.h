// SPDX-License-Identifier: Apache-2.0

// Messages of ROS 2 in CDR, with poses, models, cameras and images of evpose. Doubles are written to the bit.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "evpose/types.h"

namespace evpose::client {

struct RosHeader {
  uint64_t stamp_ns = 0;  // less than 2^31 seconds
  std::string frame_id;
};

// geometry_msgs/PoseWithCovarianceStamped. ROS has the covariance row by row in the order x, y, z, rotations about the
// fixed axes X, Y and Z of the frame; to first order that is evpose's perturbation on the left, [translation,
// rotation].
std::string EncodePose(const RosHeader& header, const Transform& pose, const Eigen::Matrix<double, 6, 6>& covariance);
// geometry_msgs/TwistStamped. `twist`: [vx vy vz wx wy wz], m/s and rad/s.
std::string EncodeTwist(const RosHeader& header, const Eigen::Matrix<double, 6, 1>& twist);
// tf2_msgs/TFMessage with one transform, from the frame `child` to that of the header.
std::string EncodeTransform(const RosHeader& header, std::string_view child, const Transform& header_from_child);
// std_msgs/String.
std::string EncodeText(std::string_view text);
// sensor_msgs/CameraInfo; the images are not rectified.
std::string EncodeCamera(const RosHeader& header, const Camera& camera);
// visualization_msgs/MarkerArray: the triangles and the edges of an object, in its frame. The markers move with the
// frame.
std::string EncodeModel(std::string_view object_frame, const ModelGeometry& geometry);
// sensor_msgs/CompressedImage.
std::string EncodeImage(const RosHeader& header, std::string_view format, std::string_view bytes);
// foxglove_msgs/ImageAnnotations: the outlines, coloured by state, for an image with the stamp `stamp_ns`.
std::string EncodeOutlines(uint64_t stamp_ns, const std::vector<ObjectOutline>& outlines);

struct RosStatus {
  enum Level : uint8_t { kOk = 0, kWarn = 1, kError = 2 };
  Level level = kOk;
  std::string name;
  std::string message;
  std::vector<std::pair<std::string, std::string>> values;
};
// diagnostic_msgs/DiagnosticArray.
std::string EncodeDiagnostics(const RosHeader& header, std::string_view hardware_id,
                              const std::vector<RosStatus>& statuses);

}  // namespace evpose::client
