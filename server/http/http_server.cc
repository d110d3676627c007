// SPDX-License-Identifier: Apache-2.0
#include "server/http/http_server.h"

#include <algorithm>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http.hpp>
#include <chrono>
#include <limits>
#include <list>
#include <map>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/status_macros.h"
#include "server/connections/connection_ledger.h"
#include "server/connections/listen_address.h"
#include "server/http/listener_thread.h"

namespace evpose::server {
namespace {

namespace beast = boost::beast;
namespace http = beast::http;
using boost::asio::ip::tcp;
using Error = boost::system::error_code;

constexpr std::chrono::seconds kRequestTimeout(5);  // from the connection to the last byte of the response
constexpr size_t kMaxRequestBytes = 8192;           // request line and headers; bodies are not read
// Enough for the scrapers and probes of a server. Beyond it the oldest connection of the client address that has the
// most is closed: a probe sends its request at once, whereas connections that wait are idle or hostile, and a flood of
// connections from one address must not close those of probes from others.
constexpr size_t kMaxConnections = 32;

std::string AcceptOf(const http::request<http::empty_body>& request) {
  std::string accept;
  const auto [begin, end] = request.equal_range(http::field::accept);
  for (auto it = begin; it != end; ++it) {
    const auto value = it->value();
    absl::StrAppend(&accept, accept.empty() ? "" : ",", absl::string_view(value.data(), value.size()));
  }
  return accept;
}

// One request and its response. Used by the server's thread only.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  using MakePage = std::function<HttpPage(const http::request<http::empty_body>&)>;
  Connection(tcp::socket socket, const MakePage& make_page) : stream_(std::move(socket)), make_page_(make_page) {
    Error ignored;  // the client may have gone already
    peer_ = PeerOf(stream_.socket().remote_endpoint(ignored).address());
    parser_.body_limit(std::numeric_limits<uint64_t>::max());  // bodies are not read; Beast 1.74 takes none as 0
  }

  // `done` is called once, when the connection can be destroyed.
  void Start(std::function<void()> done) {
    done_ = std::move(done);
    stream_.expires_after(kRequestTimeout);
    http::async_read_header(stream_, buffer_, parser_, [self = shared_from_this()](const Error& error, size_t) {
      if (error) return self->done_();
      self->Answer();
    });
  }

  void Close() { stream_.close(); }
  const boost::asio::ip::address& peer() const { return peer_; }

 private:
  void Answer() {
    HttpPage page = make_page_(parser_.get());
    response_.result(static_cast<unsigned>(page.status));
    response_.set(http::field::content_type, page.content_type);
    response_.set(http::field::cache_control, "no-store");
    if (page.status == 405) response_.set(http::field::allow, "GET, HEAD");
    response_.keep_alive(false);
    response_.content_length(page.body.size());
    if (parser_.get().method() != http::verb::head) response_.body() = std::move(page.body);
    http::async_write(stream_, response_, [self = shared_from_this()](const Error&, size_t) {
      Error ignored;
      self->stream_.socket().shutdown(tcp::socket::shutdown_send, ignored);
      self->done_();
    });
  }

  beast::tcp_stream stream_;
  boost::asio::ip::address peer_;
  const MakePage& make_page_;
  beast::flat_buffer buffer_{kMaxRequestBytes};
  http::request_parser<http::empty_body> parser_;
  http::response<http::string_body> response_;
  std::function<void()> done_;
};

class BeastServer : public HttpServer {
 public:
  explicit BeastServer(Pages pages) : pages_(std::move(pages)) {}
  ~BeastServer() override { listener_.Stop(); }

  absl::Status Listen(const ListenAddress& address) { return listener_.Listen(address); }

  int port() const override { return listener_.port(); }

 private:
  void Add(tcp::socket socket) {
    if (connections_.size() == kMaxConnections) CloseOne();
    const auto connection = std::make_shared<Connection>(std::move(socket), make_page_);
    connections_.push_back(connection);
    connection->Start([this, weak = std::weak_ptr<Connection>(connection)] { connections_.remove(weak.lock()); });
  }

  void CloseOne() {
    std::map<boost::asio::ip::address, int> num_by_peer;
    for (const auto& connection : connections_) ++num_by_peer[connection->peer()];
    const auto most = std::max_element(num_by_peer.begin(), num_by_peer.end(),
                                       [](const auto& a, const auto& b) { return a.second < b.second; });
    const auto oldest = std::find_if(connections_.begin(), connections_.end(),
                                     [most](const auto& connection) { return connection->peer() == most->first; });
    (*oldest)->Close();
    connections_.erase(oldest);
  }

  HttpPage MakePage(const http::request<http::empty_body>& request) const {
    if (request.method() == http::verb::unknown)
      return {.status = 400, .body = "the method of the request is unknown: use GET\n"};
    const std::string target(request.target());
    const auto page = pages_.find(target.substr(0, target.find('?')));
    if (page == pages_.end()) {
      return {.status = 404, .body = absl::StrCat("there is no such page; the pages are: ", Paths(), "\n")};
    }
    const bool is_read = request.method() == http::verb::get || request.method() == http::verb::head;
    return is_read ? page->second(AcceptOf(request)) : HttpPage{.status = 405, .body = "only GET and HEAD\n"};
  }

  std::string Paths() const {
    return absl::StrJoin(pages_, " ", [](std::string* paths, const auto& page) { paths->append(page.first); });
  }

  const Pages pages_;
  const Connection::MakePage make_page_ = [this](const auto& request) { return MakePage(request); };
  ListenerThread listener_{[this](tcp::socket socket) { Add(std::move(socket)); }};
  std::list<std::shared_ptr<Connection>> connections_;  // the oldest first
};

}  // namespace

absl::StatusOr<std::unique_ptr<HttpServer>> HttpServer::Start(const std::string& listen_address, Pages pages) {
  EVPOSE_ASSIGN_OR_RETURN(const ListenAddress address, ParseListenAddress(listen_address));
  auto server = std::make_unique<BeastServer>(std::move(pages));
  EVPOSE_RETURN_IF_ERROR(server->Listen(address));
  return server;
}

}  // namespace evpose::server
