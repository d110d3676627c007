// SPDX-License-Identifier: Apache-2.0

// Definitions of the message types of ROS 2 that evpose writes.
#pragma once

#include <string>
#include <string_view>

namespace evpose::client {

inline constexpr std::string_view kPoseType = "geometry_msgs/msg/PoseWithCovarianceStamped";
inline constexpr std::string_view kTwistType = "geometry_msgs/msg/TwistStamped";
inline constexpr std::string_view kTransformsType = "tf2_msgs/msg/TFMessage";
inline constexpr std::string_view kTextType = "std_msgs/msg/String";
inline constexpr std::string_view kCameraInfoType = "sensor_msgs/msg/CameraInfo";
inline constexpr std::string_view kImageType = "sensor_msgs/msg/CompressedImage";
inline constexpr std::string_view kMarkersType = "visualization_msgs/msg/MarkerArray";
inline constexpr std::string_view kDiagnosticsType = "diagnostic_msgs/msg/DiagnosticArray";
inline constexpr std::string_view kAnnotationsType = "foxglove_msgs/msg/ImageAnnotations";

// The definition of one of these types, followed by those of the types that it contains, as the schema encoding ros2msg
// of MCAP has them (https://mcap.dev/spec/registry).
std::string RosDefinition(std::string_view type);

}  // namespace evpose::client
