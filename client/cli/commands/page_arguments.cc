// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/page_arguments.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <thread>

#include "absl/strings/str_cat.h"
#include "client/view/page_files.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "server/connections/listen_address.h"

namespace evpose::client {
namespace {

constexpr char kPageGroup[] = "Page";

// Waits for xdg-open, which may run as long as the browser, and reports a failure.
void WaitForBrowser(pid_t pid) {
  int status = 0;
  while (waitpid(pid, &status, 0) < 0 && errno == EINTR) continue;
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return;
  // The command may have ended, and its streams with it.
  dprintf(STDERR_FILENO, "xdg-open has not opened a browser: open the address in one\n");
}

// Opens an address in the user's browser.
void OpenInBrowser(const std::string& url, std::ostream& err) {
  std::string program = "xdg-open";
  std::string address = url;
  char* const arguments[] = {program.data(), address.data(), nullptr};
  // The output of xdg-open is discarded: it repeats the address, and lists all browsers that it has not found.
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    posix_spawn_file_actions_addopen(&actions, stream, "/dev/null", O_RDWR, 0);
  }
  pid_t pid = 0;
  const int error = posix_spawnp(&pid, program.c_str(), &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) {
    err << "xdg-open is not installed: open the address in a browser" << std::endl;
    return;
  }
  std::thread(WaitForBrowser, pid).detach();
}

}  // namespace

void PageArguments::AddTo(CLI::App& app) {
  app.option_defaults()->group(kPageGroup);
  CLI::Option* const port_option = app.add_option("--port", port, "Port on 127.0.0.1. Default: 0, a free one")
                                       ->type_name("PORT")
                                       ->check(NumberRange(0, 65535));
  app.add_option("--listen", listen,
                 "Address to listen on, for containers, whose port is published on 127.0.0.1 of the host only")
      ->type_name("HOST:PORT")
      ->check([](const std::string& text) { return std::string(server::ParseListenAddress(text).status().message()); })
      ->excludes(port_option);
  app.add_option("--allow-host", hosts,
                 "Another name and port by which browsers may reach the page, as of a reverse proxy with "
                 "authentication. May be repeated")
      ->type_name("NAME[:PORT]")
      ->allow_extra_args(false);
  app.add_flag("--open", is_opened, "Open the page in the browser (xdg-open)");
}

absl::Status CheckHasPage() {
  if (!EmbeddedPage().empty()) return absl::OkStatus();
  return absl::UnimplementedError(
      "this evpose was built without its page: install nodejs and npm (deploy/install-dependencies.sh), and build it "
      "again with cmake -DEVPOSE_VIEW=ON, which names what is missing");
}

absl::StatusOr<std::unique_ptr<PageServer>> PageArguments::Listen() const {
  EVPOSE_RETURN_IF_ERROR(CheckHasPage());
  PageServerOptions options;
  options.listen = listen.empty() ? absl::StrCat("127.0.0.1:", port) : listen;
  options.hosts = hosts;
  return PageServer::Listen(options, EmbeddedPage());
}

void PageArguments::Serve(PageServer& server, ViewSource& source, std::ostream& out, std::ostream& err) const {
  server.Serve(source);
  if (const auto address = server::ParseListenAddress(listen); address.ok() && !address->IsLoopback()) {
    err << "warning: the link to the page is not encrypted, and other machines can reach " << listen
        << ": publish its port on 127.0.0.1 of this machine only, or use ssh or a reverse proxy with TLS" << std::endl;
  }
  out << server.url() << std::endl;
  if (is_opened) OpenInBrowser(server.url(), err);
}

}  // namespace evpose::client
