// SPDX-License-Identifier: Apache-2.0

// A page without a browser, and a source that a test controls.
#pragma once

#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <condition_variable>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/view/view_source.h"

namespace evpose::client {

// A binary message, or a text message as its header.
struct ReceivedMessage {
  nlohmann::json header = nlohmann::json::object();
  std::vector<std::string> sections;

  std::string type() const { return header.value("type", ""); }
};

inline ReceivedMessage ParseFrame(const std::string& bytes, bool is_binary) {
  ReceivedMessage message;
  if (!is_binary) {
    message.header = nlohmann::json::parse(bytes);
    return message;
  }
  const auto padded = [](size_t size) { return (size + 3) / 4 * 4; };
  uint32_t length = 0;
  std::memcpy(&length, bytes.data(), sizeof(length));
  message.header = nlohmann::json::parse(bytes.substr(sizeof(length), length));
  size_t offset = sizeof(length) + padded(length);
  for (const size_t size : message.header["sections"].get<std::vector<size_t>>()) {
    message.sections.push_back(bytes.substr(offset, size));
    offset += padded(size);
  }
  if (offset != bytes.size()) message.header["type"] = "broken";
  return message;
}

// The numbers of a section.
inline std::vector<float> Floats(const std::string& bytes) {
  std::vector<float> floats(bytes.size() / sizeof(float));
  std::memcpy(floats.data(), bytes.data(), bytes.size());
  return floats;
}

struct HttpResponse {
  unsigned status = 0;  // 0: the connection was closed without an answer
  std::map<std::string, std::string> headers;
  std::string body;
};

// One request with the given headers, to the server at this address.
inline HttpResponse Request(int port, const std::string& text, const std::string& address = "127.0.0.1") {
  boost::asio::io_context context;
  boost::asio::ip::tcp::socket socket(context);
  socket.connect({boost::asio::ip::make_address(address), static_cast<uint16_t>(port)});
  boost::system::error_code error;
  boost::asio::write(socket, boost::asio::buffer(text), error);
  boost::beast::flat_buffer buffer;
  boost::beast::http::response_parser<boost::beast::http::string_body> parser;
  parser.skip(text.rfind("HEAD", 0) == 0);
  boost::beast::http::read(socket, buffer, parser, error);
  HttpResponse answer;
  if (!parser.is_header_done()) return answer;
  answer.status = parser.get().result_int();
  for (const auto& field : parser.get()) {
    answer.headers[std::string(field.name_string())] = std::string(field.value());
  }
  answer.body = parser.get().body();
  return answer;
}

inline HttpResponse Get(int port, const std::string& path, const std::string& host,
                        const std::string& address = "127.0.0.1") {
  return Request(port, absl::StrCat("GET ", path, " HTTP/1.1\r\nHost: ", host, "\r\n\r\n"), address);
}

// The request of a browser for the WebSocket, from a page of this origin.
inline HttpResponse OpenStream(int port, const std::string& host, const std::string& origin) {
  return Request(port, absl::StrCat("GET /stream HTTP/1.1\r\nHost: ", host, "\r\nOrigin: ", origin,
                                    "\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n",
                                    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"));
}

// A WebSocket; calls wait.
class TestPage {
 public:
  explicit TestPage(int port) : socket_(context_) {
    const std::string host = absl::StrCat("127.0.0.1:", port);
    socket_.next_layer().connect({boost::asio::ip::address_v4::loopback(), static_cast<uint16_t>(port)});
    socket_.set_option(boost::beast::websocket::stream_base::decorator(
        [&](boost::beast::websocket::request_type& r) { r.set(boost::beast::http::field::origin, "http://" + host); }));
    boost::system::error_code error;
    socket_.handshake(host, "/stream", error);
  }

  void Send(const nlohmann::json& message) { SendText(message.dump()); }
  void SendText(const std::string& text, bool is_text = true) {
    boost::system::error_code error;
    socket_.text(is_text);
    socket_.write(boost::asio::buffer(text), error);
  }
  // The next message; one of type "closed" with the code after the end.
  ReceivedMessage Read() {
    boost::beast::flat_buffer buffer;
    boost::system::error_code error;
    socket_.read(buffer, error);
    if (error) {
      const auto& reason = socket_.reason();
      return {{{"type", "closed"}, {"code", reason.code}, {"reason", std::string(reason.reason.c_str())}}, {}};
    }
    const auto data = buffer.data();
    return ParseFrame(std::string(static_cast<const char*>(data.data()), data.size()), socket_.got_binary());
  }
  // The next message of this type; the others are left out.
  ReceivedMessage ReadUntil(const std::string& type) {
    while (true) {
      ReceivedMessage message = Read();
      if (message.type() == type || message.type() == "closed") return message;
    }
  }
  void Disconnect() { socket_.next_layer().close(); }

 private:
  boost::asio::io_context context_;
  boost::beast::websocket::stream<boost::asio::ip::tcp::socket> socket_;
};

// Hands out the outboxes of its pages.
class TestSource : public ViewSource {
 public:
  std::unique_ptr<PageView> Open(std::shared_ptr<PageOutbox> outbox) override {
    const std::lock_guard lock(mutex_);
    outbox->Set(PageOutbox::Latest::kHello, ToText(HelloMessage{false, "test", ""}));
    outboxes_.push_back(std::move(outbox));
    ++num_views_;
    changed_.notify_all();
    return std::make_unique<View>(*this);
  }
  std::shared_ptr<PageOutbox> WaitForPage(size_t number) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return outboxes_.size() > number; });
    return outboxes_[number];
  }
  void WaitForViews(size_t count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return num_views_ == count; });
  }
  PageRequest WaitForRequest(size_t number) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return requests_.size() > number; });
    return requests_[number];
  }

 private:
  class View : public PageView {
   public:
    explicit View(TestSource& source) : source_(source) {}
    ~View() override {
      const std::lock_guard lock(source_.mutex_);
      --source_.num_views_;
      source_.changed_.notify_all();
    }
    absl::Status Handle(const PageRequest& request) override {
      const std::lock_guard lock(source_.mutex_);
      source_.requests_.push_back(request);
      source_.changed_.notify_all();
      return absl::OkStatus();
    }

   private:
    TestSource& source_;
  };

  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::shared_ptr<PageOutbox>> outboxes_;
  std::vector<PageRequest> requests_;
  size_t num_views_ = 0;
};

}  // namespace evpose::client
