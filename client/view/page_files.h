// SPDX-License-Identifier: Apache-2.0

// The files of the page that is built from page/, as part of this program.
#pragma once

#include "absl/types/span.h"
#include "client/view/page_server.h"

namespace evpose::client {

// Empty if the program was built without the page (EVPOSE_VIEW).
absl::Span<const PageFile> EmbeddedPage();

}  // namespace evpose::client
