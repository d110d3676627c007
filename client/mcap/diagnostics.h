// SPDX-License-Identifier: Apache-2.0

// The health of a session as diagnostics of ROS.
#pragma once

#include <vector>

#include "client/mcap/ros_encoders.h"
#include "evpose/types.h"

namespace evpose::client {

// A status for the session, "evpose", and one for each object, "evpose: OBJECT": the names that deploy/ros2/poses uses.
// The session is WARN if it falls behind the camera (ProcessingHealth::falls_behind), otherwise OK. The
// objects are TRACKING: OK; LOST: ERROR; otherwise WARN, with the reason for a missing pose.
std::vector<RosStatus> Diagnose(const SessionHealth& health);

}  // namespace evpose::client
