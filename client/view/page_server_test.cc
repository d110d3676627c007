// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <zlib.h>

#include <boost/asio/read_until.hpp>
#include <boost/asio/write.hpp>
#include <iterator>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/view/page_client_testing.h"
#include "client/view/pending_source.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

constexpr PageFile kFiles[] = {{"/", "text/html", "<p>page</p>"}, {"/app.js", "text/javascript", "run();"}};

std::string Gzip(const std::string& plain) {
  z_stream stream = {};
  EXPECT_EQ(deflateInit2(&stream, Z_BEST_COMPRESSION, Z_DEFLATED, 16 + MAX_WBITS, MAX_MEM_LEVEL, Z_DEFAULT_STRATEGY),
            Z_OK);
  std::string input = plain, bytes(deflateBound(&stream, plain.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(input.data());
  stream.avail_in = static_cast<uInt>(input.size());
  stream.next_out = reinterpret_cast<Bytef*>(bytes.data());
  stream.avail_out = static_cast<uInt>(bytes.size());
  EXPECT_EQ(deflate(&stream, Z_FINISH), Z_STREAM_END);
  bytes.resize(stream.total_out);
  deflateEnd(&stream);
  return bytes;
}

class PageServerTest : public ::testing::Test {
 protected:
  void Serve(PageServerOptions options = {}) {
    options.timeout = timeout_;
    auto server = PageServer::Listen(options, files_);
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = std::move(*server);
    server_->Serve(source_);
    key_ = server_->url().substr(server_->url().find('#') + 1);
    host_ = absl::StrCat("127.0.0.1:", server_->port());
  }
  std::unique_ptr<TestPage> OpenPage() {
    auto page = std::make_unique<TestPage>(server_->port());
    page->Send({{"type", "key"}, {"key", key_}});
    return page;
  }
  static PageImage Image(int64_t t_us) {
    PageImage image;
    image.t_us = t_us;
    image.image = {.from_t_us = t_us - 10, .to_t_us = t_us, .cell_px = 2, .width = 4, .height = 4, .num_events = 1};
    image.image.cells.assign(4, 0);
    return image;
  }

  std::vector<PageFile> files_{std::begin(kFiles), std::end(kFiles)};
  std::chrono::milliseconds timeout_{60'000};
  TestSource source_;
  std::unique_ptr<PageServer> server_;
  std::string key_;
  std::string host_;
};

TEST_F(PageServerTest, ServesItsFilesWithHeadersThatKeepOtherSitesOut) {
  Serve();
  EXPECT_EQ(server_->url(), absl::StrCat("http://", host_, "/#", key_));
  EXPECT_EQ(key_.size(), 32u);
  for (const std::string& host : {host_, absl::StrCat("localhost:", server_->port())}) {
    const HttpResponse page = Get(server_->port(), "/?x=1", host);
    EXPECT_EQ(page.status, 200u);
    EXPECT_EQ(page.body, "<p>page</p>");
    EXPECT_EQ(page.headers.at("Content-Type"), "text/html; charset=utf-8");
    EXPECT_THAT(page.headers.at("Content-Security-Policy"), HasSubstr("default-src 'none'; script-src 'self'"));
    EXPECT_THAT(page.headers.at("Content-Security-Policy"), HasSubstr("frame-ancestors 'none'"));
    EXPECT_EQ(page.headers.at("X-Content-Type-Options"), "nosniff");
    EXPECT_EQ(page.headers.at("Referrer-Policy"), "no-referrer");
    EXPECT_EQ(page.headers.at("Cross-Origin-Opener-Policy"), "same-origin");
    EXPECT_EQ(page.headers.at("Cache-Control"), "no-store");
  }
  EXPECT_EQ(Get(server_->port(), "/app.js", host_).headers.at("Content-Type"), "text/javascript; charset=utf-8");
  for (const char* const path : {"/other", "/app.js/", "/../etc/passwd", "/stream", "*"}) {
    EXPECT_EQ(Get(server_->port(), path, host_).status, 404u) << path;
  }
  EXPECT_EQ(Request(server_->port(), absl::StrCat("POST / HTTP/1.1\r\nHost: ", host_, "\r\n\r\n")).status, 405u);
  const HttpResponse head = Request(server_->port(), absl::StrCat("HEAD / HTTP/1.1\r\nHost: ", host_, "\r\n\r\n"));
  EXPECT_EQ(head.status, 200u);
  EXPECT_EQ(head.body, "");
}

TEST_F(PageServerTest, OtherHostsAndOriginsAreRefused) {
  Serve({.hosts = {"View.example:8443"}});
  for (const char* const host : {"attacker.example", "127.0.0.1", "127.0.0.1:1", "view.example", ""}) {
    const HttpResponse answer = Get(server_->port(), "/", host);
    EXPECT_EQ(answer.status, 403u) << host;
    EXPECT_THAT(answer.body, HasSubstr("--allow-host"));
  }
  EXPECT_EQ(Request(server_->port(), "GET / HTTP/1.1\r\n\r\n").status, 403u);
  EXPECT_EQ(Get(server_->port(), "/", "view.example:8443").status, 200u);
  for (const std::string& origin : {std::string("http://attacker.example"), std::string("null"),
                                    "http://localhost:" + std::to_string(server_->port()), "ftp://" + host_, host_}) {
    EXPECT_EQ(OpenStream(server_->port(), host_, origin).status, 403u) << origin;
  }
  EXPECT_EQ(OpenStream(server_->port(), host_, "http://" + host_).status, 101u);
  EXPECT_EQ(OpenStream(server_->port(), host_, "https://" + host_).status, 101u) << "behind a proxy with TLS";
}

TEST_F(PageServerTest, CompressedFilesAreSentAsTheClientAcceptsThem) {
  const std::string plain(100'000, 'x'), bytes = Gzip(plain);
  files_.push_back({"/large.txt", "text/plain", bytes, true});
  files_.push_back({"/damaged.txt", "text/plain", absl::string_view(bytes).substr(0, bytes.size() / 2), true});
  Serve();
  const auto get = [&](const std::string& path, const std::string& accepted) {
    return Request(server_->port(), absl::StrCat("GET ", path, " HTTP/1.1\r\nHost: ", host_, "\r\n", accepted, "\r\n"));
  };
  for (const char* const accepted : {"gzip", "br, GZIP;q=0.5", "deflate , gzip ; q=1"}) {
    const HttpResponse answer = get("/large.txt", absl::StrCat("Accept-Encoding: ", accepted, "\r\n"));
    EXPECT_EQ(answer.status, 200u);
    EXPECT_EQ(answer.headers.at("Content-Encoding"), "gzip") << accepted;
    EXPECT_EQ(answer.headers.at("Vary"), "Accept-Encoding");
    EXPECT_EQ(answer.body, bytes);
  }
  for (const char* const header : {"", "Accept-Encoding: br, identity\r\n", "Accept-Encoding: gzip;q=0\r\n",
                                   "Accept-Encoding: gzip; q=0.000, br\r\n"}) {
    const HttpResponse answer = get("/large.txt", header);
    EXPECT_EQ(answer.status, 200u);
    EXPECT_FALSE(answer.headers.contains("Content-Encoding")) << header;
    EXPECT_EQ(answer.headers.at("Vary"), "Accept-Encoding");
    EXPECT_EQ(answer.body, plain);
  }
  EXPECT_FALSE(get("/app.js", "Accept-Encoding: gzip\r\n").headers.contains("Content-Encoding"));
  const HttpResponse damaged = get("/damaged.txt", "");
  EXPECT_EQ(damaged.status, 500u);
  EXPECT_EQ(damaged.body, "a file of the page in this program is damaged\n");
}

TEST_F(PageServerTest, ASlowClientReceivesAWholeFile) {
  timeout_ = std::chrono::milliseconds(2'000);
  const std::string large(size_t{64} << 20, 'x');  // more than the buffers of the sockets hold
  files_.push_back({"/large.txt", "text/plain", large});
  Serve();
  boost::asio::io_context context;
  boost::asio::ip::tcp::socket slow(context), idle(context);
  for (auto* const socket : {&slow, &idle}) {
    socket->connect({boost::asio::ip::address_v4::loopback(), static_cast<uint16_t>(server_->port())});
  }
  boost::asio::write(slow, boost::asio::buffer(absl::StrCat("GET /large.txt HTTP/1.1\r\nHost: ", host_, "\r\n\r\n")));
  std::vector<char> piece(size_t{256} << 10);
  size_t received = 0;
  boost::system::error_code error;
  // The server closes the idle connection after the timeout. The slow one is older.
  for (pollfd closed = {idle.native_handle(), POLLIN, 0}; poll(&closed, 1, /*milliseconds*/ 20) == 0;) {
    received += slow.read_some(boost::asio::buffer(piece), error);
  }
  EXPECT_LT(received, large.size());
  while (!error) received += slow.read_some(boost::asio::buffer(piece), error);
  EXPECT_GT(received, large.size()) << error.message();
}

// The whole network 127.0.0.0/8 is this machine.
TEST_F(PageServerTest, TheAddressOfThePageIsThatOfTheServer) {
  Serve({.listen = "127.0.0.2:0"});
  const std::string host = absl::StrCat("127.0.0.2:", server_->port());
  EXPECT_EQ(server_->url(), absl::StrCat("http://", host, "/#", key_));
  const HttpResponse page = Get(server_->port(), "/", host, "127.0.0.2");
  EXPECT_EQ(page.status, 200u);
  EXPECT_THAT(page.headers.at("Content-Security-Policy"), HasSubstr(absl::StrCat("ws://", host, " ")));
  EXPECT_EQ(Get(server_->port(), "/", host_, "127.0.0.2").status, 200u) << "with ssh -L";
  EXPECT_EQ(Get(server_->port(), "/", absl::StrCat("127.0.0.3:", server_->port()), "127.0.0.2").status, 403u);

  Serve({.listen = "0.0.0.0:0"});
  EXPECT_EQ(server_->url(), absl::StrCat("http://", host_, "/#", key_)) << "browsers refuse 0.0.0.0";
  EXPECT_EQ(Get(server_->port(), "/", host_).status, 200u);
  EXPECT_EQ(Get(server_->port(), "/", absl::StrCat("0.0.0.0:", server_->port())).status, 403u);

  Serve({.listen = "LocalHost:0"});
  EXPECT_EQ(server_->url(), absl::StrCat("http://localhost:", server_->port(), "/#", key_));
}

TEST_F(PageServerTest, AnIpv6AddressHasBrackets) {
  boost::asio::io_context context;
  boost::system::error_code error;
  boost::asio::ip::tcp::acceptor acceptor(context);
  acceptor.open(boost::asio::ip::tcp::v6(), error);
  if (!error) acceptor.bind({boost::asio::ip::address_v6::loopback(), 0}, error);
  if (error) GTEST_SKIP() << "this machine has no IPv6: " << error.message();
  Serve({.listen = "[0:0:0:0:0:0:0:1]:0"});
  const std::string host = absl::StrCat("[::1]:", server_->port());
  EXPECT_EQ(server_->url(), absl::StrCat("http://", host, "/#", key_)) << "as browsers shorten it";
  const HttpResponse page = Get(server_->port(), "/", host, "::1");
  EXPECT_EQ(page.status, 200u);
  EXPECT_THAT(page.headers.at("Content-Security-Policy"), HasSubstr("connect-src 'self'; frame"));
}

TEST_F(PageServerTest, APageWithoutTheKeyIsClosed) {
  Serve();
  const std::string almost = key_.substr(0, 31) + (key_.back() == '0' ? '1' : '0');
  for (const nlohmann::json& message : {nlohmann::json{{"type", "key"}, {"key", almost}},
                                        {{"type", "key"}, {"key", ""}},
                                        {{"type", "list"}},
                                        {{"type", "key"}},
                                        nlohmann::json::array()}) {
    TestPage page(server_->port());
    page.Send(message);
    const ReceivedMessage answer = page.Read();
    EXPECT_EQ(answer.type(), "closed") << message;
    EXPECT_EQ(answer.header["code"], 1008) << message;
  }
  EXPECT_EQ(OpenPage()->Read().type(), "hello");
}

TEST_F(PageServerTest, WrongMessagesCloseThePageWithTheReason) {
  Serve();
  const auto answer_to = [&](const std::string& text, bool is_text = true) {
    const auto page = OpenPage();
    page->SendText(text, is_text);
    return page->ReadUntil("closed").header;
  };
  EXPECT_EQ(answer_to("{").at("code"), 1008);
  EXPECT_EQ(answer_to(R"({"type":"open"})").at("reason"), "session is no text");
  EXPECT_EQ(answer_to(R"({"type":"list"})", false).at("code"), 1008);
  const std::string long_text(PageServer::kMaxMessageBytes + 1, ' ');
  EXPECT_EQ(answer_to(R"({"type":"list"})" + long_text).at("type"), "closed");
  // Requests of more than the limit are not read.
  EXPECT_EQ(Get(server_->port(), "/", host_ + "\r\nX: " + std::string(PageServer::kMaxRequestBytes, 'x')).status, 0u);
  source_.WaitForViews(0);
}

TEST_F(PageServerTest, RequestsReachTheView) {
  Serve();
  const auto page = OpenPage();
  page->Send({{"type", "settings"}, {"window_ms", 5}, {"cell_px", 4}, {"rate_hz", 60}});
  page->Send({{"type", "seek"}, {"t_us", 1234567}});
  EXPECT_EQ(std::get<ImageSettings>(source_.WaitForRequest(0)), (ImageSettings{5.0, 4, 60.0}));
  EXPECT_EQ(std::get<SeekRequest>(source_.WaitForRequest(1)).t_us, 1234567);
}

TEST_F(PageServerTest, TwoImagesAreUnacknowledgedAndTheNewestWaits) {
  Serve();
  const auto page = OpenPage();
  const std::shared_ptr<PageOutbox> outbox = source_.WaitForPage(0);
  ASSERT_EQ(page->Read().type(), "hello");
  for (const int64_t t_us : {100, 200}) {
    outbox->SetImage(Image(t_us));
    const ReceivedMessage image = page->Read();
    ASSERT_EQ(image.type(), "image");
    EXPECT_EQ(image.header["t_us"], t_us);
  }
  EXPECT_FALSE(outbox->WantsImage());
  for (const int64_t t_us : {300, 400, 500}) outbox->SetImage(Image(t_us));
  outbox->AddNote(NoticeText(NoticeLevel::kInfo, "behind the images"));
  EXPECT_EQ(page->Read().type(), "notice") << "no third image";
  page->Send({{"type", "ack"}, {"number", 1}});
  const ReceivedMessage image = page->Read();
  EXPECT_EQ(image.header["number"], 3);
  EXPECT_EQ(image.header["t_us"], 500);
  EXPECT_EQ(image.header["skipped"], 2);
  page->Send({{"type", "ack"}, {"number", 1'000'000}});  // no such image
  outbox->SetImage(Image(600));
  EXPECT_EQ(page->Read().header["number"], 4);
}

TEST_F(PageServerTest, AStalledPageHoldsUpNoOtherAndIsClosed) {
  timeout_ = std::chrono::milliseconds(2'000);
  Serve();
  const auto stalled = OpenPage();
  const auto other = OpenPage();
  // More bytes than the buffers of the sockets hold.
  auto frames = std::make_shared<PageOutbox::Prepared>();
  for (int i = 0; i < 64; ++i) frames->push_back({std::string(1 << 20, ' ')});
  source_.WaitForPage(0)->Add(frames);
  const std::shared_ptr<PageOutbox> outbox = source_.WaitForPage(1);
  ASSERT_EQ(other->Read().type(), "hello");
  for (int i = 1; i <= 20; ++i) {
    outbox->SetImage(Image(i));
    ASSERT_EQ(other->Read().header["t_us"], i);
    other->Send({{"type", "ack"}, {"number", i}});
  }
  source_.WaitForViews(1);
  outbox->SetImage(Image(21));
  EXPECT_EQ(other->Read().header["t_us"], 21);
}

TEST_F(PageServerTest, TheNinthPageIsRefusedUntilAnotherLeaves) {
  Serve();
  std::vector<std::unique_ptr<TestPage>> pages;
  for (size_t i = 0; i < PageServer::kMaxPages; ++i) {
    pages.push_back(OpenPage());
    ASSERT_EQ(pages.back()->Read().type(), "hello");
  }
  const ReceivedMessage refused = OpenPage()->Read();
  EXPECT_EQ(refused.header["code"], 1013);
  EXPECT_THAT(refused.header["reason"].get<std::string>(), HasSubstr("8 pages are open"));
  pages.front()->Disconnect();
  source_.WaitForViews(PageServer::kMaxPages - 1);
  // The place of the page becomes free shortly after the view has ended.
  while (true) {
    const ReceivedMessage answer = OpenPage()->Read();
    if (answer.type() == "hello") break;
    ASSERT_EQ(answer.header["code"], 1013);
  }
}

TEST_F(PageServerTest, IdleConnectionsMakeRoomForPages) {
  Serve();
  const auto page = OpenPage();
  ASSERT_EQ(page->Read().type(), "hello");
  boost::asio::io_context context;
  std::vector<boost::asio::ip::tcp::socket> idle;
  for (size_t i = 0; i < 2 * PageServer::kMaxConnections; ++i) {
    idle.emplace_back(context).connect(
        {boost::asio::ip::address_v4::loopback(), static_cast<uint16_t>(server_->port())});
  }
  EXPECT_EQ(Get(server_->port(), "/", host_).status, 200u);
  source_.WaitForPage(0)->AddNote(NoticeText(NoticeLevel::kInfo, "still there"));
  EXPECT_EQ(page->Read().type(), "notice");
}

TEST_F(PageServerTest, TheEndReachesThePages) {
  Serve();
  const auto page = OpenPage();
  ASSERT_EQ(page->Read().type(), "hello");
  server_->End("that was all");
  EXPECT_EQ(page->Read().header["reason"], "that was all");
  std::thread reader([&] { EXPECT_EQ(page->Read().header["code"], 1001); });
  server_.reset();
  reader.join();
  source_.WaitForViews(0);
}

TEST_F(PageServerTest, TheEndIsSentBeforeThePageIsClosed) {
  Serve();
  const auto page = OpenPage();
  ASSERT_EQ(page->Read().type(), "hello");
  std::thread reader([&] {
    EXPECT_EQ(page->Read().header["reason"], "that was all");
    EXPECT_EQ(page->Read().header["code"], 1001);
  });
  server_->End("that was all");
  server_.reset();
  reader.join();
}

TEST_F(PageServerTest, APageThatComesBeforeTheSourceWaitsForIt) {
  auto server = PageServer::Listen({.timeout = timeout_}, kFiles);
  ASSERT_TRUE(server.ok()) << server.status();
  server_ = std::move(*server);
  boost::asio::io_context context;
  boost::asio::ip::tcp::socket socket(context);
  socket.connect({boost::asio::ip::address_v4::loopback(), static_cast<uint16_t>(server_->port())});
  const std::string request = absl::StrCat("GET /app.js HTTP/1.1\r\nHost: 127.0.0.1:", server_->port(), "\r\n\r\n");
  boost::asio::write(socket, boost::asio::buffer(request));
  server_->Serve(source_);
  std::string answer;
  boost::system::error_code error;
  boost::asio::read_until(socket, boost::asio::dynamic_buffer(answer), "run();", error);
  EXPECT_FALSE(error) << error.message() << ": " << answer;
  // A server without a call of Serve() ends, too.
  EXPECT_TRUE(PageServer::Listen({}, kFiles).ok());
}

TEST(PendingSourceTest, PagesAreShownTheSourceWhenItIsThere) {
  TestSource source;
  PendingSource pending({.is_recording = true, .source = "a.raw"}, "reading poses.csv");
  const auto early = std::make_shared<PageOutbox>([] {});
  const auto gone = std::make_shared<PageOutbox>([] {});
  const std::unique_ptr<PageView> view = pending.Open(early);
  pending.Open(gone).reset();
  const ReceivedMessage hello = ParseFrame(early->Next()->bytes, false);
  EXPECT_EQ(hello.header["mode"], "recording");
  EXPECT_EQ(hello.header["source"], "a.raw");
  EXPECT_EQ(ParseFrame(early->Next()->bytes, false).header["text"], "reading poses.csv");
  EXPECT_TRUE(view->Handle(ImageSettings{20.0, 1, 10.0}).ok());
  EXPECT_TRUE(view->Handle(ImageSettings{20.0, 4, 10.0}).ok());
  EXPECT_TRUE(view->Handle(SeekRequest{5}).ok()) << "there is nothing to move";
  pending.Provide(source);
  EXPECT_EQ(source.WaitForPage(0), early);
  EXPECT_EQ(ParseFrame(early->Next()->bytes, false).header["source"], "test");
  EXPECT_EQ(std::get<ImageSettings>(source.WaitForRequest(0)), (ImageSettings{20.0, 4, 10.0}));
  EXPECT_TRUE(view->Handle(SeekRequest{6}).ok());
  EXPECT_EQ(std::get<SeekRequest>(source.WaitForRequest(1)).t_us, 6);
  const std::unique_ptr<PageView> later = pending.Open(std::make_shared<PageOutbox>([] {}));
  source.WaitForViews(2);
}

TEST_F(PageServerTest, AddressesThatCannotBeUsedAreErrors) {
  EXPECT_EQ(PageServer::Listen({.listen = "127.0.0.1"}, kFiles).status().code(), absl::StatusCode::kInvalidArgument);
  Serve();
  const absl::Status status = PageServer::Listen({.listen = host_}, kFiles).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(status.message(), HasSubstr(host_));
}

}  // namespace
}  // namespace evpose::client
