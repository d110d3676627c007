// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_outbox.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "client/view/page_client_testing.h"
#include "client/view/shared_frames.h"

namespace evpose::client {
namespace {

using ::testing::ElementsAre;

using Latest = PageOutbox::Latest;

class PageOutboxTest : public ::testing::Test {
 protected:
  // All frames that can be sent, by type.
  std::vector<ReceivedMessage> TakeAll() {
    std::vector<ReceivedMessage> messages;
    while (auto frame = outbox_.Next()) messages.push_back(ParseFrame(frame->bytes, frame->is_binary));
    return messages;
  }
  std::vector<std::string> TakeTypes() {
    std::vector<std::string> types;
    for (const ReceivedMessage& message : TakeAll()) types.push_back(message.type());
    return types;
  }
  static Pose PoseAt(int64_t t_us, const std::string& id = "cube") {
    Pose pose;
    pose.t_us = t_us;
    pose.object_id = id;
    return pose;
  }
  static PageImage ImageOf(std::vector<uint8_t> cells, int64_t from_us, int64_t to_us, bool is_continuation) {
    PageImage image;
    image.image = {.from_t_us = from_us, .to_t_us = to_us, .cell_px = 2, .num_events = 10};
    image.image.cells = std::move(cells);
    image.t_us = to_us;
    image.is_continuation = is_continuation;
    return image;
  }

  int calls_ = 0;
  PageOutbox outbox_{[this] { ++calls_; }};
};

TEST(SharedFramesTest, EachPageGetsAllFramesInTheirOrder) {
  SharedFrames frames;
  const auto text = [](const std::string& name) {
    return std::make_shared<const PageOutbox::Prepared>(PageOutbox::Prepared{{name}});
  };
  const auto take = [](PageOutbox& outbox) {
    std::vector<std::string> texts;
    while (const auto frame = outbox.Next()) texts.push_back(frame->bytes);
    return texts;
  };
  int calls = 0;
  const auto early = std::make_shared<PageOutbox>([&] { ++calls; });
  frames.SendTo(early);
  frames.SendTo(std::make_shared<PageOutbox>([] {}));  // has left
  EXPECT_EQ(calls, 0);
  frames.Add(text("a"));
  EXPECT_EQ(calls, 1);
  EXPECT_THAT(take(*early), ElementsAre("a"));
  const auto late = std::make_shared<PageOutbox>([] {});
  frames.SendTo(late);
  frames.Add(text("b"));
  EXPECT_THAT(take(*early), ElementsAre("b"));
  EXPECT_THAT(take(*late), ElementsAre("a", "b"));
}

TEST_F(PageOutboxTest, TheSceneIsBeforeAllThatBelongsToIt) {
  outbox_.SetHealth({});
  outbox_.AddPoses({PoseAt(1)});
  outbox_.SetImage(ImageOf({0}, 0, 1, false));
  outbox_.StartScene({});
  outbox_.Set(Latest::kEnd, EndText("end"));
  outbox_.AddPoses({PoseAt(2)});
  outbox_.SetHealth({});
  outbox_.SetImage(ImageOf({0}, 1, 2, false));
  outbox_.AddNote(NoticeText(NoticeLevel::kInfo, "note"));
  outbox_.Set(Latest::kPosition, PositionText(1, false, 1.0));
  outbox_.Set(Latest::kHello, ToText(HelloMessage{}));
  EXPECT_EQ(calls_, 11);
  EXPECT_THAT(TakeTypes(), ElementsAre("hello", "scene", "position", "notice", "image", "poses", "health", "end"));
  EXPECT_FALSE(outbox_.Next());
}

TEST_F(PageOutboxTest, TheEndOfTheFormerSceneIsNotSent) {
  outbox_.StartScene({});
  outbox_.Set(Latest::kEnd, EndText("the former session has ended"));
  outbox_.StartScene({});
  EXPECT_THAT(TakeTypes(), ElementsAre("scene"));
}

TEST_F(PageOutboxTest, TheNewestOfAKindReplacesTheOthers) {
  for (int i = 0; i < 1000; ++i) outbox_.Set(Latest::kPosition, PositionText(i, true, 1.0));
  const std::vector<ReceivedMessage> messages = TakeAll();
  ASSERT_EQ(messages.size(), 1u);
  EXPECT_EQ(messages[0].header["t_us"], 999);
}

TEST_F(PageOutboxTest, PosesOfAPageThatDoesNotReadAreThinned) {
  constexpr int kPoses = 100'000;
  for (int i = 0; i < kPoses; ++i) outbox_.AddPoses({PoseAt(i), PoseAt(i, "book")});
  std::map<std::string, std::vector<int64_t>> times;
  for (const ReceivedMessage& message : TakeAll()) {
    for (const auto& pose : message.header["poses"]) times[message.header["object"]].push_back(pose["t_us"]);
  }
  for (const char* const id : {"cube", "book"}) {
    EXPECT_LE(times[id].size(), PageOutbox::kMaxPoses);
    EXPECT_GE(times[id].size(), PageOutbox::kMaxPoses / 2);
    EXPECT_EQ(times[id].back(), kPoses - 1) << "the last one stays";
    EXPECT_TRUE(std::is_sorted(times[id].begin(), times[id].end()));
  }
}

TEST_F(PageOutboxTest, OldNotesAreRemoved) {
  for (size_t i = 0; i < 3 * PageOutbox::kMaxNotes; ++i) {
    outbox_.AddNote(NoticeText(NoticeLevel::kInfo, std::to_string(i)));
  }
  const std::vector<ReceivedMessage> messages = TakeAll();
  ASSERT_EQ(messages.size(), PageOutbox::kMaxNotes);
  EXPECT_EQ(messages.back().header["text"], std::to_string(3 * PageOutbox::kMaxNotes - 1));
}

TEST_F(PageOutboxTest, ALiveImageHasTheEventsOfThoseThatItReplaces) {
  outbox_.SetImage(ImageOf({1, 0, 2}, 0, 10, true));
  outbox_.SetImage(ImageOf({0, 4, 1}, 10, 20, true));
  const std::vector<ReceivedMessage> messages = TakeAll();
  ASSERT_EQ(messages.size(), 1u);
  EXPECT_EQ(messages[0].sections[0], "\1\4\3");
  EXPECT_EQ(messages[0].header["from_us"], 0);
  EXPECT_EQ(messages[0].header["to_us"], 20);
  EXPECT_EQ(messages[0].header["events"], 20);
  EXPECT_EQ(messages[0].header["skipped"], 1);
}

TEST_F(PageOutboxTest, AnImageOfARecordingIsThatOfItsInstantAlone) {
  outbox_.SetImage(ImageOf({1}, 0, 10, false));
  outbox_.SetImage(ImageOf({4}, 100, 110, false));
  EXPECT_EQ(TakeAll().at(0).sections[0], "\4");
}

TEST_F(PageOutboxTest, HealthCountsTheImages) {
  for (int i = 0; i < 5; ++i) outbox_.SetImage(ImageOf({1}, 0, i, false));
  EXPECT_TRUE(outbox_.Next());
  outbox_.SetHealth({});
  const nlohmann::json link = TakeAll().at(0).header["link"];
  EXPECT_EQ(link["images_sent"], 1);
  EXPECT_EQ(link["images_skipped"], 4);
  EXPECT_EQ(link["unacknowledged"], 1);
}

TEST_F(PageOutboxTest, NothingIsStoredForAPageThatHasLeft) {
  outbox_.Close();
  outbox_.AddNote("x");
  outbox_.SetImage(ImageOf({1}, 0, 1, false));
  EXPECT_EQ(calls_, 0);
  EXPECT_FALSE(outbox_.Next());
}

}  // namespace
}  // namespace evpose::client
