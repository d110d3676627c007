// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/session_observer.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <mutex>
#include <semaphore>
#include <string>
#include <vector>

#include "client/lib/interrupted_server_testing.h"
#include "client/mcap/mcap_testing.h"
#include "client/mcap/pose_recorder.h"
#include "core/base/temporary_directory_testing.h"

namespace evpose::client {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

class SessionObserverTest : public ::testing::Test {
 protected:
  // Records a session of the server until Finish() has returned, which is called after the first failure of a call.
  void Record(int num_failures) {
    std::counting_semaphore<> failures(0);
    InterruptedServer server({.num_failures = num_failures, .on_failure = [&failures] { failures.release(); }});
    auto recorder = PoseRecorder::Open(path_, {.object_ids = {"cube"}, .epoch_ns = 0});
    ASSERT_TRUE(recorder.ok()) << recorder.status();
    SessionObserverOptions options;
    options.camera = {.width_px = 4, .height_px = 2};
    options.print = [this](const std::string& text) {
      const std::lock_guard lock(mutex_);
      printed_.push_back(text);
    };
    SessionObserver observer(server.client(), "sessions/1", {recorder->get()}, options);
    failures.acquire();
    observer.Finish();
    (*recorder)->Add(SessionHealth{.t_us = 5, .decoded_events = 1}, "sessions/1");  // gives the scene its time
    ASSERT_TRUE((*recorder)->Commit().ok());
  }

  bool HasModel() const {
    const std::vector<TestMessage> messages = ReadMessages(path_);
    return std::any_of(messages.begin(), messages.end(),
                       [](const TestMessage& message) { return message.topic == "/evpose/cube/model"; });
  }

  const TemporaryDirectory directory_;
  const std::string path_ = directory_.path() + "/poses.mcap";
  std::mutex mutex_;
  std::vector<std::string> printed_;
};

TEST_F(SessionObserverTest, TheCallForAModelIsRepeatedAtTheEndOfTheSession) {
  Record(/*num_failures=*/1);
  EXPECT_TRUE(HasModel());
  EXPECT_THAT(printed_, Not(Contains(HasSubstr("model"))));
}

TEST_F(SessionObserverTest, AServerThatRemainsUnreachableDoesNotHoldUpTheEnd) {
  Record(/*num_failures=*/std::numeric_limits<int>::max());
  EXPECT_FALSE(HasModel());
  EXPECT_THAT(printed_, Contains("the .mcap file does not have the model of cube: test server: interrupted"));
}

}  // namespace
}  // namespace evpose::client
