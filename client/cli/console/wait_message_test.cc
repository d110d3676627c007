// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/wait_message.h"

#include <gtest/gtest.h>

#include <future>
#include <sstream>

namespace evpose::client {
namespace {

// Collects what is printed, and reports the first flush.
class FlushedBuffer : public std::stringbuf {
 public:
  std::future<void> flushed() { return flushed_.get_future(); }

 protected:
  int sync() override {
    if (!is_flushed_) flushed_.set_value();
    is_flushed_ = true;
    return 0;
  }

 private:
  std::promise<void> flushed_;
  bool is_flushed_ = false;
};

TEST(WaitMessageTest, NamesWhatIsWaitedFor) {
  FlushedBuffer buffer;
  std::ostream err(&buffer);
  std::ostringstream out;
  const CliContext context{out, err};
  std::future<void> flushed = buffer.flushed();
  {
    const WaitMessage wait(context, "a server at localhost:1");
    flushed.wait();
  }
  EXPECT_EQ(buffer.str(), "waiting for a server at localhost:1 ...\n");
  EXPECT_EQ(out.str(), "");
}

TEST(WaitMessageTest, NamesTheWork) {
  FlushedBuffer buffer;
  std::ostream err(&buffer);
  std::ostringstream out;
  const CliContext context{out, err};
  std::future<void> flushed = buffer.flushed();
  {
    const WaitMessage message = WaitMessage::ForWork(context, "reading part.step");
    flushed.wait();
  }
  EXPECT_EQ(buffer.str(), "reading part.step ...\n");
}

TEST(WaitMessageTest, IsSilentAfterAShortWait) {
  std::ostringstream out, err;
  const CliContext context{out, err};
  { const WaitMessage wait(context, "a server"); }
  EXPECT_EQ(err.str(), "");
}

TEST(WaitMessageTest, WaitsForPipesOnly) {
  std::ostringstream out, err;
  const CliContext context{out, err};
  EXPECT_TRUE(WaitForRecording(context, "-").has_value());
  EXPECT_FALSE(WaitForRecording(context, "/dev/null").has_value());
  EXPECT_FALSE(WaitForRecording(context, "no such file").has_value());
}

}  // namespace
}  // namespace evpose::client
