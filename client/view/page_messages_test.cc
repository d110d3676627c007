// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_messages.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <cstring>
#include <string>
#include <vector>

#include "client/view/page_client_testing.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST(PageRequestTest, EachTypeIsRead) {
  EXPECT_EQ(std::get<KeyRequest>(*ParsePageRequest(R"({"type":"key","key":"k"})")).key, "k");
  EXPECT_TRUE(std::holds_alternative<ListRequest>(*ParsePageRequest(R"({"type":"list","more":1})")));
  EXPECT_EQ(std::get<OpenRequest>(*ParsePageRequest(R"({"type":"open","session":"sessions/1"})")).session,
            "sessions/1");
  EXPECT_EQ(std::get<AckRequest>(*ParsePageRequest(R"({"type":"ack","number":7})")).number, 7u);
  EXPECT_EQ(std::get<SeekRequest>(*ParsePageRequest(R"({"type":"seek","t_us":-5})")).t_us, -5);
  EXPECT_EQ(std::get<PlayRequest>(*ParsePageRequest(R"({"type":"play","speed":0.001})")).speed, 0.001);
  EXPECT_TRUE(std::holds_alternative<PauseRequest>(*ParsePageRequest(R"({"type":"pause"})")));
  EXPECT_EQ(std::get<StepRequest>(*ParsePageRequest(R"({"type":"step","count":-3})")).count, -3);
  EXPECT_EQ(
      std::get<ImageSettings>(*ParsePageRequest(R"({"type":"settings","window_ms":0.5,"cell_px":1,"rate_hz":12.5})")),
      (ImageSettings{0.5, 1, 12.5}));
}

TEST(PageRequestTest, ErrorsNameTheField) {
  const auto error = [](const std::string& text) {
    const absl::Status status = ParsePageRequest(text).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << text;
    return std::string(status.message());
  };
  EXPECT_EQ(error(""), "the message is no JSON object");
  EXPECT_EQ(error("[1"), "the message is no JSON object");
  EXPECT_EQ(error(std::string(4000, '[')), "the message is no JSON object");
  EXPECT_EQ(error("{}"), "type is no text");
  EXPECT_EQ(error(R"({"type":"other"})"), "type is unknown (client/view/README.md, section 3)");
  EXPECT_EQ(error(R"({"type":"key"})"), "key is no text");
  EXPECT_EQ(error(R"({"type":"open","session":")" + std::string(300, 's') + R"("})"),
            "session is longer than 256 bytes");
  EXPECT_EQ(error(R"({"type":"seek","t_us":1.5})"), "t_us is no integer");
  EXPECT_THAT(error(R"({"type":"seek","t_us":1e300})"), HasSubstr("t_us is not in ["));
  EXPECT_EQ(error(R"({"type":"seek","t_us":"1"})"), "t_us is no number");
  EXPECT_EQ(error(R"({"type":"play","speed":11})"), "speed is not in [0.001, 10]");
  EXPECT_EQ(error(R"({"type":"step","count":0})"), "count is 0");
  EXPECT_EQ(error(R"({"type":"settings","window_ms":10,"cell_px":3,"rate_hz":30})"), "cell_px is not 1, 2 or 4");
  EXPECT_EQ(error(R"({"type":"settings","window_ms":10,"cell_px":2,"rate_hz":61})"), "rate_hz is not in [1, 60]");
}

ObjectOutline SomeOutline(const std::string& id) {
  ObjectOutline outline;
  outline.object_id = id;
  outline.state = TrackState::kDegraded;
  outline.t_us = 42;
  outline.segments = {{{1.5f, 2.5f}, {3.5f, 4.5f}, EdgeKind::kOccludingContour},
                      {{0.0f, 0.0f}, {9.0f, 9.0f}, EdgeKind::kUnknown},  // of a later server
                      {{5.0f, 6.0f}, {7.0f, 8.0f}, EdgeKind::kBoundary}};
  return outline;
}

TEST(PageMessagesTest, ASceneNamesTheFrameOfThePoses) {
  const auto frame = [](const PoseFrame& of_poses) {
    return nlohmann::json::parse(ToText(PageScene{.frame = of_poses}))["frame"];
  };
  EXPECT_EQ(frame({}), nlohmann::json::parse(R"({"name":"camera","transform":"camera_from_object","pose_of":"object",)"
                                             R"("camera":null})"));
  EXPECT_EQ(frame(PoseFrame::ObjectFromCamera()),
            nlohmann::json::parse(R"({"name":"object","transform":"object_from_camera","pose_of":"camera",)"
                                  R"("camera":null})"));
  EXPECT_EQ(frame(PoseFrame::WorldFromObject({.translation_m = {1, 2, 3}}, "base")),
            nlohmann::json::parse(R"({"name":"base","transform":"base_from_object","pose_of":"object",)"
                                  R"("camera":{"p":[1.0,2.0,3.0],"q":[1.0,0.0,0.0,0.0]}})"));
}

TEST(PageMessagesTest, AnImageHasItsCellsAndOutlines) {
  PageImage page_image;
  EventImage& image = page_image.image;
  image = {.from_t_us = 100, .to_t_us = 200, .cell_px = 2, .width = 1000, .height = 500, .num_events = 77};
  image.cells.assign(125'000, 0);
  image.cells[3] = 0xe4;
  image.outlines = {SomeOutline("cube"), SomeOutline("cube")};
  page_image.t_us = 150;
  page_image.num_truths = 1;
  const ReceivedMessage message = ParseFrame(ToBinary(page_image, 5, 6), true);
  const nlohmann::json& header = message.header;
  EXPECT_EQ(header["type"], "image");
  EXPECT_EQ(header["number"], 5);
  EXPECT_EQ(header["skipped"], 6);
  EXPECT_EQ(header["t_us"], 150);
  EXPECT_EQ(header["from_us"], 100);
  EXPECT_EQ(header["to_us"], 200);
  EXPECT_EQ(header["width"], 1000);
  EXPECT_EQ(header["height"], 500);
  EXPECT_EQ(header["events"], 77);
  ASSERT_EQ(message.sections.size(), 5u);
  ASSERT_EQ(header["encoding"], "zlib");
  EXPECT_LT(message.sections[0].size(), 1000u);
  std::vector<uint8_t> cells(image.cells.size() + 1);
  uLongf size = cells.size();
  ASSERT_EQ(uncompress(cells.data(), &size, reinterpret_cast<const Bytef*>(message.sections[0].data()),
                       message.sections[0].size()),
            Z_OK);
  cells.resize(size);
  EXPECT_EQ(cells, image.cells);
  EXPECT_THAT(Floats(message.sections[1]), ElementsAre(1.5f, 2.5f, 3.5f, 4.5f, 5.0f, 6.0f, 7.0f, 8.0f));
  EXPECT_EQ(message.sections[2], std::string("\3\1", 2));
  const nlohmann::json& outline = header["outlines"][0];
  EXPECT_EQ(outline["object"], "cube");
  EXPECT_EQ(outline["state"], "degraded");
  EXPECT_EQ(outline["segments"], 2);
  EXPECT_EQ(outline["truth"], false);
  EXPECT_EQ(header["outlines"][1]["truth"], true);
}

TEST(PageMessagesTest, CellsThatDoNotShrinkAreSentAsTheyAre) {
  PageImage page_image;
  page_image.image.cells = {1, 2, 3};
  const ReceivedMessage message = ParseFrame(ToBinary(page_image, 1, 0), true);
  EXPECT_EQ(message.header["encoding"], "packed");
  EXPECT_EQ(message.sections.at(0), "\1\2\3");
}

TEST(PageMessagesTest, AGeometryHasVerticesFacesAndEdges) {
  ModelGeometry geometry;
  geometry.vertices_m = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  geometry.faces = {{0, 1, 2}};
  geometry.edges_m = {{Eigen::Vector3f(0, 0, 0), Eigen::Vector3f(1, 0, 0.5f)}};
  const ReceivedMessage message = ParseFrame(ToBinary(SceneObject{"cube", "cube.obj", 1.25}, geometry), true);
  EXPECT_EQ(message.header["type"], "geometry");
  EXPECT_EQ(message.header["object"], "cube");
  EXPECT_EQ(message.header["diameter_m"], 1.25);
  ASSERT_EQ(message.sections.size(), 3u);
  EXPECT_THAT(Floats(message.sections[0]), ElementsAre(0, 0, 0, 1, 0, 0, 0, 1, 0));
  EXPECT_EQ(message.sections[1], std::string("\0\0\0\0\1\0\0\0\2\0\0\0", 12));
  EXPECT_THAT(Floats(message.sections[2]), ElementsAre(0, 0, 0, 1, 0, 0.5f));
}

TEST(PageMessagesTest, APoseHasItsDeviationsIfTheyAreKnown) {
  Pose pose;
  pose.object_id = "cube";
  pose.t_us = 5;
  pose.seq = 9;
  pose.state = TrackState::kAmbiguous;
  pose.twist << 1, 2, 3, 4, 5, 6;
  pose.alternatives = {{pose.camera_from_object, -0.5}};
  const nlohmann::json without = nlohmann::json::parse(PosesText("cube", {pose}, true));
  EXPECT_EQ(without["truth"], true);
  EXPECT_FALSE(without["poses"][0].contains("sigma"));
  pose.covariance.diagonal() << 1, 4, 9, 16, 25, 36;
  pose.covariance(0, 1) = pose.covariance(1, 0) = 0.5;
  const nlohmann::json message = nlohmann::json::parse(PosesText("cube", {pose}, false));
  EXPECT_EQ(message["object"], "cube");
  EXPECT_FALSE(message.contains("truth"));
  const nlohmann::json& sent = message["poses"][0];
  EXPECT_EQ(sent["sigma"], nlohmann::json({1.0, 2.0, 3.0, 4.0, 5.0, 6.0}));
  EXPECT_EQ(sent["cov3"], nlohmann::json({1.0, 0.5, 0.0, 4.0, 0.0, 9.0}));
  EXPECT_EQ(sent["state"], "ambiguous");
  EXPECT_EQ(sent["v"], nlohmann::json({1.0, 2.0, 3.0}));
  EXPECT_EQ(sent["w"], nlohmann::json({4.0, 5.0, 6.0}));
  EXPECT_EQ(sent["alternatives"][0]["llr"], -0.5);
}

TEST(PageMessagesTest, NamesThatAreNoUtf8AreReplaced) {
  const nlohmann::json message = nlohmann::json::parse(StateText("a\xff", 1, TrackState::kLost, "b\xff"));
  EXPECT_EQ(message["object"], "a\xef\xbf\xbd");
  EXPECT_EQ(message["state"], "lost");
}

}  // namespace
}  // namespace evpose::client
