// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_server.h"

#include <algorithm>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <condition_variable>
#include <list>
#include <mutex>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/view/page_connection.h"
#include "client/view/page_site.h"
#include "core/base/status_macros.h"
#include "server/connections/listen_address.h"
#include "server/runtime/random_name.h"

namespace evpose::client {
namespace {

using boost::asio::ip::tcp;
using AsioError = boost::system::error_code;

constexpr std::chrono::milliseconds kAcceptPause(100);  // until accept() is tried again after an error
constexpr std::chrono::seconds kEndTimeout(1);          // for the last messages to the pages

// Returns the host of the page's address: 127.0.0.1 for a server that listens on all addresses of the machine.
std::string BrowserHost(const server::ListenAddress& address, const boost::asio::ip::address& bound) {
  if (bound.is_unspecified()) return "127.0.0.1";
  AsioError error;
  boost::asio::ip::make_address(address.host, error);
  return error ? address.host : bound.to_string();  // browsers shorten an IPv6 address in the same way
}

}  // namespace

class PageServer::Impl : public PageConnection::Owner {
 public:
  ~Impl() override;

  absl::Status Listen(const PageServerOptions& options, absl::Span<const PageFile> files);
  void Serve(ViewSource& source);
  int port() const { return port_; }
  std::string url() const { return absl::StrCat("http://", site_->address(), "/#", key_); }
  void End(const std::string& reason);

  absl::StatusOr<std::unique_ptr<PageView>> OpenPage(std::shared_ptr<PageOutbox> outbox) override;
  void Closed(const std::shared_ptr<PageConnection>& connection, std::unique_ptr<PageView> view) override;

 private:
  void Accept(tcp::acceptor& acceptor);
  void AcceptAfterPause(tcp::acceptor& acceptor);
  void Add(tcp::socket socket);
  void Shutdown();
  // Destroys views, which may wait for calls to a server.
  void DestroyViews(const std::stop_token& stop);

  ViewSource* source_ = nullptr;  // set before the threads begin
  std::string key_;
  std::chrono::milliseconds timeout_{};
  int port_ = 0;
  std::unique_ptr<PageSite> site_;
  boost::asio::io_context context_{1};
  boost::asio::steady_timer end_timer_{context_};
  std::vector<tcp::acceptor> acceptors_;
  std::list<std::shared_ptr<PageConnection>> connections_;
  bool is_ending_ = false;
  std::atomic<size_t> num_views_ = 0;  // including those that are being destroyed
  std::mutex mutex_;
  std::condition_variable_any has_views_;
  std::vector<std::unique_ptr<PageView>> finished_views_ ABSL_GUARDED_BY(mutex_);
  std::thread thread_;
  std::jthread destroyer_;
};

PageServer::Impl::~Impl() {
  if (!thread_.joinable()) return;  // Serve() was not called
  boost::asio::post(context_, [this] { Shutdown(); });
  thread_.join();
  for (const std::shared_ptr<PageConnection>& connection : connections_) connection->TakeView().reset();
  destroyer_ = {};
}

absl::Status PageServer::Impl::Listen(const PageServerOptions& options, absl::Span<const PageFile> files) {
  EVPOSE_ASSIGN_OR_RETURN(const server::ListenAddress address, server::ParseListenAddress(options.listen));
  timeout_ = options.timeout;
  EVPOSE_ASSIGN_OR_RETURN(key_, server::RandomHex128());
  EVPOSE_ASSIGN_OR_RETURN(acceptors_, server::ListenOn(context_, address));
  const tcp::endpoint bound = acceptors_.front().local_endpoint();
  port_ = bound.port();
  const server::ListenAddress of_page{BrowserHost(address, bound.address()), port_};
  site_ = std::make_unique<PageSite>(files, of_page, options.hosts, key_);
  return absl::OkStatus();
}

void PageServer::Impl::Serve(ViewSource& source) {
  source_ = &source;
  for (tcp::acceptor& acceptor : acceptors_) Accept(acceptor);
  thread_ = std::thread([this] { context_.run(); });
  destroyer_ = std::jthread([this](const std::stop_token& stop) { DestroyViews(stop); });
}

void PageServer::Impl::Accept(tcp::acceptor& acceptor) {
  acceptor.async_accept([this, &acceptor](const AsioError& error, tcp::socket socket) {
    if (is_ending_) return;
    if (error) return AcceptAfterPause(acceptor);
    Accept(acceptor);
    Add(std::move(socket));
  });
}

// Called after an error, in particular when no descriptor is free.
void PageServer::Impl::AcceptAfterPause(tcp::acceptor& acceptor) {
  const auto pause = std::make_shared<boost::asio::steady_timer>(context_, kAcceptPause);
  pause->async_wait([this, &acceptor, pause](const AsioError&) {
    if (!is_ending_) Accept(acceptor);
  });
}

void PageServer::Impl::Add(tcp::socket socket) {
  if (connections_.size() >= kMaxConnections) {
    // A browser sends its request at once. The oldest connection without a page is therefore idle or hostile.
    const auto idle =
        std::find_if(connections_.begin(), connections_.end(), [](const auto& each) { return !each->has_page(); });
    const std::shared_ptr<PageConnection> oldest = *idle;  // at most kMaxPages have a page
    connections_.erase(idle);
    oldest->Shutdown();
  }
  connections_.push_back(std::make_shared<PageConnection>(std::move(socket), *site_, timeout_, *this));
  connections_.back()->Start();
}

absl::StatusOr<std::unique_ptr<PageView>> PageServer::Impl::OpenPage(std::shared_ptr<PageOutbox> outbox) {
  if (num_views_ >= kMaxPages) {
    return absl::ResourceExhaustedError(absl::StrCat(kMaxPages, " pages are open: close one of them"));
  }
  ++num_views_;
  return source_->Open(std::move(outbox));
}

void PageServer::Impl::Closed(const std::shared_ptr<PageConnection>& connection, std::unique_ptr<PageView> view) {
  connections_.remove(connection);
  if (is_ending_ && connections_.empty()) end_timer_.cancel();
  if (view == nullptr) return;
  const std::lock_guard lock(mutex_);
  finished_views_.push_back(std::move(view));
  has_views_.notify_one();
}

void PageServer::Impl::DestroyViews(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (true) {
    has_views_.wait(lock, stop, [this] { return !finished_views_.empty(); });
    if (finished_views_.empty()) return;
    std::unique_ptr<PageView> view = std::move(finished_views_.back());
    finished_views_.pop_back();
    lock.unlock();
    view.reset();
    --num_views_;
    lock.lock();
  }
}

void PageServer::Impl::End(const std::string& reason) {
  boost::asio::post(context_, [this, reason] {
    for (const std::shared_ptr<PageConnection>& connection : connections_) {
      if (connection->has_page()) connection->outbox()->Set(PageOutbox::Latest::kEnd, EndText(reason));
    }
  });
}

void PageServer::Impl::Shutdown() {
  is_ending_ = true;
  for (tcp::acceptor& acceptor : acceptors_) acceptor.close();
  for (const auto& connection : std::vector(connections_.begin(), connections_.end())) connection->Shutdown();
  end_timer_.expires_after(kEndTimeout);
  end_timer_.async_wait([this](const AsioError&) { context_.stop(); });
  if (connections_.empty()) end_timer_.cancel();
}

PageServer::PageServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PageServer::~PageServer() = default;

absl::StatusOr<std::unique_ptr<PageServer>> PageServer::Listen(const PageServerOptions& options,
                                                               absl::Span<const PageFile> files) {
  auto impl = std::make_unique<Impl>();
  EVPOSE_RETURN_IF_ERROR(impl->Listen(options, files));
  return std::unique_ptr<PageServer>(new PageServer(std::move(impl)));
}

void PageServer::Serve(ViewSource& source) { impl_->Serve(source); }
int PageServer::port() const { return impl_->port(); }
std::string PageServer::url() const { return impl_->url(); }
void PageServer::End(const std::string& reason) { impl_->End(reason); }

}  // namespace evpose::client
