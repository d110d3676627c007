// SPDX-License-Identifier: Apache-2.0

// The options of the commands that serve a page to the browser.
#pragma once

#include <memory>
#include <ostream>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/cli/common/command.h"
#include "client/view/page_server.h"

namespace evpose::client {

struct PageArguments {
  int port = 0;
  std::string listen;  // empty: 127.0.0.1 and the port
  std::vector<std::string> hosts;
  bool is_opened = false;

  void AddTo(CLI::App& app);
  // Errors: those of CheckHasPage() and PageServer::Listen().
  absl::StatusOr<std::unique_ptr<PageServer>> Listen() const;
  // Serves the page and prints its address in one line on `out`. `source` must outlive the server. Reports on `err`
  // a browser that cannot be opened, and an address that other machines can reach.
  void Serve(PageServer& server, ViewSource& source, std::ostream& out, std::ostream& err) const;
};

// Error: UNIMPLEMENTED, with advice, if this program was built without the page.
absl::Status CheckHasPage();

}  // namespace evpose::client
