// SPDX-License-Identifier: Apache-2.0

// The program is built without the page.
#include "client/view/page_files.h"

namespace evpose::client {

absl::Span<const PageFile> EmbeddedPage() { return {}; }

}  // namespace evpose::client
