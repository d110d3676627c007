// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "server/sessions/types/session_config.h"

namespace evpose::server {

// Trackers as a session's config asks for them. Those of one camera share what they look up of it, and those of one
// model what is known of it beforehand. Errors: INVALID_ARGUMENT with the field of the config.
TrackerFactory MakeTrackerFactory();

}  // namespace evpose::server
