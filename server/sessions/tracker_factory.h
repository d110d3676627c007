// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "server/sessions/types/session_config.h"

namespace evpose::server {

// Creates the tracker that a session's configuration describes. Trackers with the same camera share its lookup tables;
// trackers with the same model share the data precomputed for the search. Errors: INVALID_ARGUMENT with the field of
// the configuration.
TrackerFactory MakeTrackerFactory();

}  // namespace evpose::server
