// SPDX-License-Identifier: Apache-2.0

// Messages of ROS 2 with events, in CDR (OMG DDS-XTypes 1.3, section 7.4.1, version 1 of the encoding). The first two
// bytes are 00 00 for big-endian and 00 01 for little-endian numbers; a number is aligned to its size from the fifth
// byte on.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "client/containers/event_source.h"

namespace evpose::client {

// event_camera_msgs/msg/EventPacket (ros-event-camera/event_camera_msgs:msg_ros2/EventPacket.msg), and
// event_array_msgs/msg/EventArray, its former name.
struct EventPacket {
  uint32_t height = 0;
  uint32_t width = 0;
  uint64_t seq = 0;
  std::string_view encoding;  // a part of the message
  bool is_big_endian = false;
  std::string_view events;  // a part of the message
};

// nullopt if the message is damaged.
std::optional<EventPacket> ParseEventPacket(std::string_view message);

struct EventArray {
  uint32_t height = 0;
  uint32_t width = 0;
  uint32_t num_missing = 0;  // events that the message announces beyond its end
};

// dvs_msgs/msg/EventArray (uzh-rpg/rpg_dvs_ros:dvs_msgs/msg/EventArray.msg): appends its events. nullopt if the message
// is damaged before the first event.
std::optional<EventArray> ParseEventArray(std::string_view message, std::vector<SourceEvent>& events);

}  // namespace evpose::client
