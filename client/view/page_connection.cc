// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_connection.h"

#include <boost/asio/buffer.hpp>
#include <boost/asio/post.hpp>
#include <chrono>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;

constexpr std::chrono::seconds kIdleTimeout(30);  // a page that answers no ping for this time is gone
constexpr size_t kMaxCloseReason = 123;           // bytes, of the protocol

absl::string_view View(beast::string_view text) { return {text.data(), text.size()}; }

}  // namespace

PageConnection::PageConnection(boost::asio::ip::tcp::socket socket, const PageSite& site,
                               std::chrono::milliseconds timeout, Owner& owner)
    : site_(site), timeout_(timeout), owner_(owner), timer_(socket.get_executor()), http_(std::move(socket)) {}

void PageConnection::Start() {
  buffer_.max_size(PageServer::kMaxRequestBytes);
  parser_.emplace();
  parser_->body_limit(std::numeric_limits<uint64_t>::max());  // bodies are not read; Beast 1.74 takes none as 0
  http_->expires_after(timeout_);
  http::async_read_header(*http_, buffer_, *parser_, [self = shared_from_this()](const Error& error, size_t) {
    if (error) return self->Finish();
    self->Answer();
  });
}

void PageConnection::Answer() {
  const auto& request = parser_->get();
  const absl::string_view host = View(request[http::field::host]);
  if (const absl::Status status = site_.CheckHost(host); !status.ok()) {
    return Respond(http::status::forbidden, "text/plain", status.message());
  }
  const absl::string_view target = View(request.target());
  const bool is_get = request.method() == http::verb::get;
  if (target == kStreamPath && is_get && websocket::is_upgrade(request)) {
    const absl::Status status = site_.CheckOrigin(View(request[http::field::origin]), host);
    if (!status.ok()) return Respond(http::status::forbidden, "text/plain", status.message());
    return AcceptWebSocket();
  }
  if (!is_get && request.method() != http::verb::head) {
    return Respond(http::status::method_not_allowed, "text/plain", "only GET and HEAD\n");
  }
  const PageFile* const file = site_.Find(target);
  if (file == nullptr) return Respond(http::status::not_found, "text/plain", "there is no such page\n");
  RespondWith(*file);
}

void PageConnection::RespondWith(const PageFile& file) {
  if (!file.is_gzip) return Respond(http::status::ok, file.content_type, file.bytes);
  response_.set(http::field::vary, "Accept-Encoding");
  if (AcceptsGzip(View(parser_->get()[http::field::accept_encoding]))) {
    response_.set(http::field::content_encoding, "gzip");
    return Respond(http::status::ok, file.content_type, file.bytes);
  }
  const absl::StatusOr<std::string> plain = Decompress(file.bytes);
  if (plain.ok()) return Respond(http::status::ok, file.content_type, *plain);
  Respond(http::status::internal_server_error, "text/plain", plain.status().message());
}

void PageConnection::Respond(http::status status, absl::string_view content_type, absl::string_view body) {
  const auto& request = parser_->get();
  response_.result(status);
  for (const auto& [name, value] : site_.Headers(View(request[http::field::host]))) response_.set(name, value);
  if (status == http::status::forbidden) response_.erase("Content-Security-Policy");  // contains the unchecked host
  if (status == http::status::method_not_allowed) response_.set(http::field::allow, "GET, HEAD");
  response_.set(http::field::content_type, absl::StrCat(content_type, "; charset=utf-8"));
  response_.keep_alive(false);
  response_.content_length(body.size());
  if (request.method() != http::verb::head) response_.body() = std::string(body);
  serializer_.emplace(response_);
  WriteResponse();
}

void PageConnection::WriteResponse() {
  http_->expires_after(timeout_);
  http::async_write_some(*http_, *serializer_, [self = shared_from_this()](const Error& error, size_t) {
    if (!error && !self->serializer_->is_done()) return self->WriteResponse();
    Error ignored;
    self->http_->socket().shutdown(boost::asio::ip::tcp::socket::shutdown_send, ignored);
    self->Finish();
  });
}

void PageConnection::AcceptWebSocket() {
  http_->expires_never();  // the timeouts of the WebSocket and of timer_ replace it
  socket_.emplace(std::move(*http_));
  http_.reset();
  socket_->set_option(websocket::stream_base::timeout{timeout_, kIdleTimeout, /*keep_alive_pings=*/true});
  socket_->read_message_max(PageServer::kMaxMessageBytes);
  socket_->auto_fragment(false);
  StartTimer();
  socket_->async_accept(parser_->get(), [self = shared_from_this()](const Error& error) {
    if (error) return self->Finish();
    self->buffer_.consume(self->buffer_.size());
    self->Read();
  });
}

void PageConnection::Read() {
  socket_->async_read(buffer_, [self = shared_from_this()](const Error& error, size_t) {
    if (error) return self->Finish();
    self->HandleMessage();
    self->buffer_.consume(self->buffer_.size());
    self->Read();  // also while it closes: the error of a read ends the connection
  });
}

void PageConnection::HandleMessage() {
  if (close_) return;
  const auto data = buffer_.data();
  const absl::StatusOr<PageRequest> request =
      ParsePageRequest({static_cast<const char*>(data.data()), socket_->got_text() ? data.size() : 0});
  absl::Status status = request.status();
  if (status.ok() && view_ == nullptr) {
    status = OpenPage(*request);
  } else if (const AckRequest* ack = status.ok() ? std::get_if<AckRequest>(&*request) : nullptr) {
    outbox_->Acknowledge(ack->number);
  } else if (status.ok()) {
    status = view_->Handle(*request);
  }
  if (status.ok()) return;
  const bool is_full = absl::IsResourceExhausted(status);
  Close(is_full ? websocket::close_code::try_again_later : websocket::close_code::policy_error,
        std::string(status.message()));
}

absl::Status PageConnection::OpenPage(const PageRequest& request) {
  const KeyRequest* const key = std::get_if<KeyRequest>(&request);
  if (key == nullptr || !site_.IsKey(key->key)) {
    return absl::PermissionDeniedError("the key is wrong: open the address that this evpose has printed");
  }
  StopTimer();
  // The outbox calls this function on other threads.
  const auto is_scheduled = std::make_shared<std::atomic<bool>>(false);
  outbox_ = std::make_shared<PageOutbox>([weak = weak_from_this(), is_scheduled, executor = socket_->get_executor()] {
    if (is_scheduled->exchange(true)) return;
    boost::asio::post(executor, [weak, is_scheduled] {
      *is_scheduled = false;
      if (const std::shared_ptr<PageConnection> self = weak.lock()) self->Pump();
    });
  });
  EVPOSE_ASSIGN_OR_RETURN(view_, owner_.OpenPage(outbox_));
  return absl::OkStatus();
}

void PageConnection::Pump() {
  if (is_writing_ || close_ || is_finished_) return;
  std::optional<PageOutbox::Frame> frame = outbox_->Next();
  if (!frame) {
    if (is_ending_) Close(websocket::close_code::going_away, "evpose view has ended");
    return;
  }
  frame_ = std::move(*frame);
  is_writing_ = true;
  socket_->binary(frame_.is_binary);
  StartTimer();
  socket_->async_write(boost::asio::buffer(frame_.bytes), [self = shared_from_this()](const Error& error, size_t) {
    self->is_writing_ = false;
    self->StopTimer();
    if (error) return self->Finish();
    if (self->close_) return self->SendClose();
    self->Pump();
  });
}

void PageConnection::Close(uint16_t code, const std::string& reason) {
  if (close_) return;
  const std::string text = reason.substr(0, kMaxCloseReason);
  close_ = websocket::close_reason(static_cast<websocket::close_code>(code), beast::string_view(text));
  if (!is_writing_) SendClose();
}

void PageConnection::SendClose() {
  StartTimer();
  socket_->async_close(*close_, [self = shared_from_this()](const Error&) { self->Finish(); });
}

void PageConnection::Shutdown() {
  if (is_finished_) return;
  if (view_ != nullptr) {
    is_ending_ = true;
    return Pump();
  }
  if (http_) http_->close();
  if (socket_) beast::get_lowest_layer(*socket_).close();
}

void PageConnection::StartTimer() {
  timer_.expires_after(timeout_);
  timer_.async_wait([self = shared_from_this()](const Error& error) {
    // A timer that was started again expires at another time.
    if (error || self->timer_.expiry() > std::chrono::steady_clock::now()) return;
    beast::get_lowest_layer(*self->socket_).close();  // pending operations end with an error
  });
}

void PageConnection::StopTimer() { timer_.cancel(); }

void PageConnection::Finish() {
  if (is_finished_) return;
  is_finished_ = true;
  StopTimer();
  if (socket_) beast::get_lowest_layer(*socket_).close();
  if (outbox_) outbox_->Close();
  owner_.Closed(shared_from_this(), std::move(view_));
}

}  // namespace evpose::client
