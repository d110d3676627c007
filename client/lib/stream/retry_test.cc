// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/retry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stop_token>
#include <string>
#include <utility>

#include "client/lib/fake_clock_testing.h"
#include "client/lib/messages/status_details.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

TEST(BackoffTest, DoublesUpToItsLimitAndRestarts) {
  RetryOptions options;
  options.first_delay = absl::Milliseconds(100);
  options.max_delay = absl::Milliseconds(700);
  options.random = [] { return 1.0; };
  Backoff backoff(options);
  for (const int expected_ms : {100, 200, 400, 700, 700}) {
    EXPECT_EQ(backoff.Next(), absl::Milliseconds(expected_ms));
  }
  backoff.Reset();
  EXPECT_EQ(backoff.Next(), absl::Milliseconds(100));
}

TEST(BackoffTest, JitterTakesUpToHalf) {
  RetryOptions options;
  double random = 0.0;
  options.random = [&random] { return random; };
  Backoff backoff(options);
  EXPECT_EQ(backoff.Next(), absl::Milliseconds(50));
  random = 0.5;
  EXPECT_EQ(backoff.Next(), absl::Milliseconds(150));
}

TEST(BackoffTest, SystemRandomnessStaysInItsRange) {
  Backoff backoff({});
  for (int i = 0; i < 100; ++i) {
    backoff.Reset();
    const absl::Duration delay = backoff.Next();
    EXPECT_GE(delay, absl::Milliseconds(50));
    EXPECT_LE(delay, absl::Milliseconds(100));
  }
}

TEST(RetryOptionsTest, ValidateNamesTheField) {
  RetryOptions options;
  EXPECT_TRUE(options.Validate().ok());
  options.max_outage = -absl::Seconds(1);
  EXPECT_THAT(options.Validate().message(), HasSubstr("max_outage"));
  options = {};
  options.first_delay = absl::ZeroDuration();
  EXPECT_THAT(options.Validate().message(), HasSubstr("first_delay"));
  options = {};
  options.max_delay = absl::Milliseconds(1);
  EXPECT_THAT(options.Validate().message(), HasSubstr("max_delay"));
}

struct Case {
  absl::StatusCode code;
  StatusDetails details;
  RetryAdvice advice;
};

TEST(AdviseOnTest, EveryStatusThatAStreamCanEndWith) {
  using Code = absl::StatusCode;
  for (const Case& each : {
           Case{Code::kUnavailable, {}, RetryAdvice::kTryAgain},  // the network
           Case{Code::kUnavailable, {"DRAINING"}, RetryAdvice::kTryAgain},
           Case{Code::kDeadlineExceeded, {}, RetryAdvice::kTryAgain},
           Case{Code::kCancelled, {}, RetryAdvice::kTryAgain},
           Case{Code::kUnknown, {}, RetryAdvice::kTryAgain},   // a proxy
           Case{Code::kInternal, {}, RetryAdvice::kTryAgain},  // the transport
           Case{Code::kInternal, {"STORE_FAILED"}, RetryAdvice::kGiveUp},
           Case{Code::kAborted, {"POSES_EXPIRED"}, RetryAdvice::kTryAgain},
           Case{Code::kAborted, {"FENCED"}, RetryAdvice::kGiveUp},
           Case{Code::kDataLoss, {"CRC_MISMATCH"}, RetryAdvice::kTryAgain},
           Case{Code::kDataLoss, {}, RetryAdvice::kGiveUp},
           Case{Code::kResourceExhausted, {"STORE_FULL"}, RetryAdvice::kGiveUp},
           Case{Code::kResourceExhausted, {"TOO_MANY", "", "", absl::Seconds(1)}, RetryAdvice::kTryAgain},
           Case{Code::kNotFound, {"SESSION_NOT_FOUND"}, RetryAdvice::kTryOtherServer},
           Case{Code::kNotFound, {"SESSION_DELETED"}, RetryAdvice::kGiveUp},
           Case{Code::kPermissionDenied, {"WRONG_TOKEN"}, RetryAdvice::kTryOtherToken},
           Case{Code::kPermissionDenied, {}, RetryAdvice::kGiveUp},
           Case{Code::kInvalidArgument, {"", "attach.last_pose_seq"}, RetryAdvice::kAttachFromFirstPose},
           Case{Code::kInvalidArgument, {"", "events.payload"}, RetryAdvice::kGiveUp},
           Case{Code::kFailedPrecondition, {"SEQ_GAP"}, RetryAdvice::kGiveUp},
           Case{Code::kUnauthenticated, {}, RetryAdvice::kTryOtherAuthToken},
           Case{Code::kUnauthenticated, {"BAD_TOKEN"}, RetryAdvice::kTryOtherAuthToken},
           Case{Code::kUnauthenticated, {"ACCESS_WITHDRAWN"}, RetryAdvice::kTryAgain},
           Case{Code::kUnimplemented, {}, RetryAdvice::kGiveUp},
       }) {
    absl::Status status(each.code, "what happened");
    SetDetails(status, each.details);
    EXPECT_EQ(AdviseOn(status), each.advice) << status << " " << each.details.reason;
  }
}

// Calls that fail four times with the same error.
class RepeatCallTest : public ::testing::Test {
 protected:
  absl::Status Repeat(absl::StatusCode code, const StatusDetails& details) {
    return RepeatCall(
        stop_.get_token(),
        [&] {
          absl::Status status(code, "what happened");
          SetDetails(status, details);
          return ++num_calls_ < 5 ? status : absl::OkStatus();
        },
        [&](const absl::Status&) { ++num_errors_; }, clock_);
  }

  std::stop_source stop_;
  FakeClock clock_;
  int num_calls_ = 0;
  int num_errors_ = 0;
};

TEST_F(RepeatCallTest, ErrorsThatMayPassAreRepeated) {
  using Code = absl::StatusCode;
  for (const auto& [code, reason] : {std::pair(Code::kUnavailable, ""), std::pair(Code::kUnavailable, "ROLLED_BACK"),
                                     std::pair(Code::kAborted, "POSES_EXPIRED"), std::pair(Code::kUnauthenticated, ""),
                                     std::pair(Code::kFailedPrecondition, "SESSION_NOT_TRACKED_HERE")}) {
    num_calls_ = num_errors_ = 0;
    EXPECT_TRUE(Repeat(code, {reason}).ok()) << reason;
    EXPECT_EQ(num_calls_, 5) << reason;
    EXPECT_EQ(num_errors_, 4) << reason;
  }
}

TEST_F(RepeatCallTest, ErrorsThatAreFinalAreReturned) {
  using Code = absl::StatusCode;
  for (const auto& [code, reason] :
       {std::pair(Code::kDataLoss, "ROLLED_BACK"), std::pair(Code::kFailedPrecondition, "EVENT_IMAGES_OFF"),
        std::pair(Code::kNotFound, "SESSION_NOT_FOUND"), std::pair(Code::kPermissionDenied, ""),
        std::pair(Code::kUnimplemented, ""), std::pair(Code::kInvalidArgument, "")}) {
    num_calls_ = num_errors_ = 0;
    EXPECT_EQ(Repeat(code, {reason}).code(), code) << reason;
    EXPECT_EQ(num_calls_, 1) << reason;
    EXPECT_EQ(num_errors_, 0) << reason;
  }
}

TEST_F(RepeatCallTest, WaitsForAsLongAsTheServerAsks) {
  const absl::Time begin = clock_.Now();
  EXPECT_TRUE(Repeat(absl::StatusCode::kResourceExhausted, {"TOO_MANY_STREAMS", "", "", absl::Seconds(5)}).ok());
  EXPECT_EQ(clock_.Now() - begin, absl::Seconds(4 * 5));
}

TEST_F(RepeatCallTest, ARequestToStopEndsIt) {
  stop_.request_stop();
  EXPECT_TRUE(absl::IsUnavailable(Repeat(absl::StatusCode::kUnavailable, {})));
  EXPECT_EQ(num_calls_, 1);
}

}  // namespace
}  // namespace evpose::client
