// SPDX-License-Identifier: Apache-2.0

// Recordings of iniVation's cameras: AEDAT 2.0, 3.1 and 4.0 (client/containers/aedat/README.md).
#pragma once

#include "client/containers/container_format.h"

namespace evpose::client {

extern const ContainerFormat kAedatFormat;

}  // namespace evpose::client
