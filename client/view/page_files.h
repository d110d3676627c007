// SPDX-License-Identifier: Apache-2.0

// The page that is built from page/, in this program.
#pragma once

#include "absl/types/span.h"
#include "client/view/page_server.h"

namespace evpose::client {

// Empty if the program was built without the page (EVPOSE_VIEW).
absl::Span<const PageFile> EmbeddedPage();

}  // namespace evpose::client
