// SPDX-License-Identifier: Apache-2.0

// Explains, for people, why an object has no confirmed pose.
#pragma once

#include <string>

#include "server/sessions/types/session_state.h"

namespace evpose::server {

// Returns the text of ObjectHealth.detail; empty when the object has a confirmed pose.
std::string ExplainMissingPose(const ObjectHealth& object);

}  // namespace evpose::server
