// SPDX-License-Identifier: Apache-2.0

// A connection of the page server: one HTTP request, or the WebSocket of a page.
#pragma once

#include <atomic>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <chrono>
#include <memory>
#include <optional>
#include <string>

#include "client/view/page_site.h"

namespace evpose::client {

// Used by the server's thread only.
class PageConnection : public std::enable_shared_from_this<PageConnection> {
 public:
  class Owner {
   public:
    virtual ~Owner() = default;
    // Opens the view of a page that has sent the right key. Error: RESOURCE_EXHAUSTED if too many pages are open.
    virtual absl::StatusOr<std::unique_ptr<PageView>> OpenPage(std::shared_ptr<PageOutbox> outbox) = 0;
    // Is the last call of each connection. `view` is the result of OpenPage(); null if the connection never was that of
    // a page.
    virtual void Closed(const std::shared_ptr<PageConnection>& connection, std::unique_ptr<PageView> view) = 0;
  };

  // Both references must outlive the connection.
  PageConnection(boost::asio::ip::tcp::socket socket, const PageSite& site, std::chrono::milliseconds timeout,
                 Owner& owner);

  void Start();
  bool has_page() const { return view_ != nullptr; }
  PageOutbox* outbox() { return outbox_.get(); }
  // Ends the connection. A page first receives the frames that wait in its outbox, then the close code "going away".
  void Shutdown();
  // Returns the view if the server ends before the connection has called Owner::Closed().
  std::unique_ptr<PageView> TakeView() { return std::move(view_); }

 private:
  using Error = boost::system::error_code;
  using WebSocket = boost::beast::websocket::stream<boost::beast::tcp_stream>;

  void Answer();
  void RespondWith(const PageFile& file);
  void Respond(boost::beast::http::status status, absl::string_view content_type, absl::string_view body);
  // Sends the next piece of the response, as large as the connection takes at once.
  void WriteResponse();
  void AcceptWebSocket();
  void Read();
  void HandleMessage();
  absl::Status OpenPage(const PageRequest& request);
  // Sends the next frame unless one is being sent. If no frame waits and the connection is ending, closes it.
  void Pump();
  void Close(uint16_t code, const std::string& reason);
  void SendClose();
  // Closes the connection after the timeout unless StopTimer() is called before.
  void StartTimer();
  void StopTimer();
  void Finish();

  const PageSite& site_;
  const std::chrono::milliseconds timeout_;
  Owner& owner_;
  boost::asio::steady_timer timer_;
  std::optional<boost::beast::tcp_stream> http_;  // until the WebSocket is accepted
  std::optional<WebSocket> socket_;
  boost::beast::flat_buffer buffer_;
  std::optional<boost::beast::http::request_parser<boost::beast::http::empty_body>> parser_;
  boost::beast::http::response<boost::beast::http::string_body> response_;
  std::optional<boost::beast::http::response_serializer<boost::beast::http::string_body>> serializer_;
  std::shared_ptr<PageOutbox> outbox_;
  std::unique_ptr<PageView> view_;
  PageOutbox::Frame frame_;  // the frame that is being sent
  std::optional<boost::beast::websocket::close_reason> close_;
  bool is_writing_ = false;
  bool is_ending_ = false;
  bool is_finished_ = false;
};

}  // namespace evpose::client
