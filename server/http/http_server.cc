// SPDX-License-Identifier: Apache-2.0
#include "server/http/http_server.h"

#include <civetweb.h>

#include <chrono>
#include <future>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/string_view.h"
#include "core/base/status_macros.h"
#include "server/rpc/listen_address.h"

namespace evpose::server {
namespace {

// Enough for a Prometheus scraper, two probes and one person at the same time; further requests wait.
constexpr char kNumThreads[] = "4";
constexpr char kRequestTimeoutMs[] = "5000";  // a stalled client must not occupy a thread for long
constexpr char kMaxRequestBytes[] = "8192";   // request line and headers; bodies are not read

class CivetwebServer : public HttpServer {
 public:
  explicit CivetwebServer(Pages pages) : pages_(std::move(pages)) { mg_init_library(MG_FEATURES_DEFAULT); }
  ~CivetwebServer() override {
    if (context_ != nullptr) Stop();
    mg_exit_library();
  }

  absl::Status Listen(const ListenAddress& address) {
    mg_callbacks callbacks = {};
    callbacks.begin_request = [](mg_connection* connection) {
      const mg_request_info& request = *mg_get_request_info(connection);
      return static_cast<const CivetwebServer*>(request.user_data)->Answer(*connection, request);
    };
    callbacks.log_message = [](const mg_connection*, const char*) {
      return 1;
    };  // no log: errors of clients are not ours
    host_ = address.host;
    const std::string listening = address.WithPort(address.port);
    const char* options[] = {"listening_ports", listening.c_str(),  "num_threads",    kNumThreads, "request_timeout_ms",
                             kRequestTimeoutMs, "max_request_size", kMaxRequestBytes, nullptr};
    context_ = mg_start(&callbacks, this, options);
    mg_server_port port = {};
    if (context_ == nullptr || mg_get_server_ports(context_, 1, &port) != 1) {
      EVPOSE_RETURN_IF_ERROR(ProbeListenAddress(address));
      return absl::UnavailableError(
          absl::StrCat("cannot listen on ", listening, ": give an IPv4 address of this machine, or 0.0.0.0 for all"));
    }
    port_ = port.port;
    return absl::OkStatus();
  }

  int port() const override { return port_; }

 private:
  // Stops civetweb and waits for its threads. They check the stop flag every two seconds and at each new connection;
  // connecting therefore makes the shutdown fast.
  void Stop() {
    const std::future<void> stopped = std::async(std::launch::async, mg_stop, context_);
    while (stopped.wait_for(std::chrono::milliseconds(5)) != std::future_status::ready) {
      char error[128];
      mg_connection* const visit = mg_connect_client(host_.c_str(), port_, /*use_ssl=*/0, error, sizeof(error));
      if (visit != nullptr) mg_close_connection(visit);
    }
  }

  // Sends the page. Returns its status, which tells civetweb that the request has been handled.
  int Answer(mg_connection& connection, const mg_request_info& request) const {
    const HttpPage page = MakePage(request);
    const std::string head =
        absl::StrCat("HTTP/1.1 ", page.status, " ", mg_get_response_code_text(&connection, page.status),
                     "\r\nContent-Type: ", page.content_type, "\r\nContent-Length: ", page.body.size(),
                     "\r\nCache-Control: no-store", page.status == 405 ? "\r\nAllow: GET, HEAD" : "",
                     "\r\nConnection: close\r\n\r\n");
    const bool has_body = absl::string_view(request.request_method) != "HEAD";
    const std::string answer = absl::StrCat(head, has_body ? page.body : "");
    mg_write(&connection, answer.data(), answer.size());
    return page.status;
  }

  HttpPage MakePage(const mg_request_info& request) const {
    const auto page = pages_.find(request.local_uri);
    if (page == pages_.end())
      return {.status = 404, .body = absl::StrCat("there is no such page; the pages are: ", Paths(), "\n")};
    const absl::string_view method = request.request_method;
    if (method != "GET" && method != "HEAD") return {.status = 405, .body = "only GET and HEAD\n"};
    return page->second();
  }

  std::string Paths() const {
    return absl::StrJoin(pages_, " ", [](std::string* paths, const auto& page) { paths->append(page.first); });
  }

  const Pages pages_;
  mg_context* context_ = nullptr;
  std::string host_;
  int port_ = 0;
};

}  // namespace

absl::StatusOr<std::unique_ptr<HttpServer>> HttpServer::Start(const std::string& listen_address, Pages pages) {
  EVPOSE_ASSIGN_OR_RETURN(const ListenAddress address, ParseListenAddress(listen_address));
  auto server = std::make_unique<CivetwebServer>(std::move(pages));
  EVPOSE_RETURN_IF_ERROR(server->Listen(address));
  return server;
}

}  // namespace evpose::server
