// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/tenant_quotas.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "server/runtime/errors.h"
#include "server/runtime/failing_allocations_testing.h"

namespace evpose::server {
namespace {

class TenantQuotasTest : public testing::Test {
 protected:
  TenantQuotas::Options Options() {
    TenantQuotas::Options options;
    options.max_streams = 1;
    options.max_watchers = 2;
    options.max_health_per_s = 100;
    options.max_bytes_per_s = 1000;
    options.burst_bytes = 500;
    options.now = [this] { return now_; };
    return options;
  }
  absl::Time now_ = absl::UnixEpoch();
};

TEST_F(TenantQuotasTest, WatchersOfEachTenant) {
  TenantQuotas quotas(Options());
  auto first = quotas.AddWatcher("lab").value();
  const auto second = quotas.AddWatcher("lab").value();
  const absl::Status full = quotas.AddWatcher("lab").status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(full).reason, "TENANT_QUOTA");
  EXPECT_EQ(GetErrorDetails(full).quota_subject, "tenant_watchers");
  EXPECT_GT(GetErrorDetails(full).retry_after, absl::ZeroDuration());
  EXPECT_TRUE(quotas.AddWatcher("field").ok());
  first.reset();
  EXPECT_TRUE(quotas.AddWatcher("lab").ok());
}

TEST_F(TenantQuotasTest, StreamsOfEachTenant) {
  TenantQuotas quotas(Options());
  auto first = quotas.AddStream("lab").value();
  EXPECT_EQ(GetErrorDetails(quotas.AddStream("lab").status()).quota_subject, "tenant_streams");
  EXPECT_TRUE(quotas.AddWatcher("lab").ok()) << "watchers have a limit of their own";
  EXPECT_TRUE(quotas.AddStream("field").ok());
  first.reset();
  EXPECT_TRUE(quotas.AddStream("lab").ok());
}

TEST_F(TenantQuotasTest, StreamsOfTheServer) {
  TenantQuotas::Options options = Options();
  options.max_streams_of_server = 2;
  TenantQuotas quotas(options);
  auto first = quotas.AddStream("lab").value();
  EXPECT_EQ(GetErrorDetails(quotas.AddStream("lab").status()).reason, "TENANT_QUOTA");
  const auto second = quotas.AddStream("field");
  ASSERT_TRUE(second.ok()) << "a stream that was refused for the quota of its tenant does not count";
  const absl::Status full = quotas.AddStream("hall").status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(full).reason, "TOO_MANY_STREAMS");
  EXPECT_EQ(GetErrorDetails(full).quota_subject, "max_streams");
  EXPECT_GT(GetErrorDetails(full).retry_after, absl::ZeroDuration());
  EXPECT_EQ(options.metrics->quota_refusals[QuotaLimit::kMaxStreams].value(), 1u);
  first.reset();
  EXPECT_TRUE(quotas.AddStream("hall").ok());
}

TEST_F(TenantQuotasTest, BytesOfResponses) {
  TenantQuotas::Options options = Options();
  options.max_response_bytes = 100u << 20;
  TenantQuotas quotas(options);
  const auto large = quotas.AddResponse("lab", 200u << 20);
  ASSERT_TRUE(large.ok()) << "the only response of a tenant is never refused";
  const absl::Status full = quotas.AddResponse("lab", 1).status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(full).reason, "TENANT_QUOTA");
  EXPECT_EQ(GetErrorDetails(full).quota_subject, "tenant_responses");
  EXPECT_GT(GetErrorDetails(full).retry_after, absl::ZeroDuration());
  EXPECT_EQ(options.metrics->quota_refusals[QuotaLimit::kTenantResponses].value(), 1u);
}

TEST_F(TenantQuotasTest, ResponsesOfOtherTenantsLeaveRoomForSmallOnes) {
  TenantQuotas::Options options = Options();
  options.max_response_bytes = 100u << 20;
  TenantQuotas quotas(options);
  auto of_lab = quotas.AddResponse("lab", 100u << 20);
  auto of_field = quotas.AddResponse("field", 99u << 20);
  ASSERT_TRUE(of_lab.ok() && of_field.ok());
  const auto small = quotas.AddResponse("hall", 1u << 20);
  const auto second = quotas.AddResponse("hall", 1u << 20);
  EXPECT_TRUE(small.ok() && second.ok());
  EXPECT_FALSE(quotas.AddResponse("hall", 10u << 20).ok()) << "the server has no more";
  of_lab->reset();
  EXPECT_TRUE(quotas.AddResponse("hall", 10u << 20).ok());
  EXPECT_FALSE(quotas.AddResponse("field", 2u << 20).ok()) << "the tenant has no more";
}

// Whichever allocation fails, the call ends, and nothing stays counted.
TEST_F(TenantQuotasTest, WithoutMemoryNothingIsCounted) {
  TenantQuotas quotas(Options());
  const std::string tenant = "a name that does not fit into the string itself";
  const int num_failed = FailEachAllocation([&] { quotas.AddStream(tenant).IgnoreError(); },
                                            [&](int number) { EXPECT_TRUE(quotas.AddStream(tenant).ok()) << number; });
  EXPECT_GT(num_failed, 1);
}

TEST_F(TenantQuotasTest, ManyWatchersReceiveHealthLessOften) {
  TenantQuotas quotas(Options());
  EXPECT_EQ(quotas.HealthPeriod("lab", absl::Milliseconds(10)), absl::Milliseconds(10));
  std::vector<std::shared_ptr<const void>> watchers;
  for (int i = 0; i < 50; ++i) watchers.push_back(quotas.AddHealthWatcher("lab"));
  EXPECT_EQ(quotas.HealthPeriod("lab", absl::Milliseconds(10)), absl::Milliseconds(500)) << "50 of 100 per second";
  EXPECT_EQ(quotas.HealthPeriod("lab", absl::Seconds(1)), absl::Seconds(1));
  EXPECT_EQ(quotas.HealthPeriod("field", absl::Milliseconds(10)), absl::Milliseconds(10));
  watchers.clear();
  EXPECT_EQ(quotas.HealthPeriod("lab", absl::Milliseconds(10)), absl::Milliseconds(10));
  TenantQuotas::Options options = Options();
  options.max_health_per_s = 0;
  TenantQuotas unlimited(options);
  for (int i = 0; i < 50; ++i) watchers.push_back(unlimited.AddHealthWatcher("lab"));
  EXPECT_EQ(unlimited.HealthPeriod("lab", absl::Milliseconds(10)), absl::Milliseconds(10));
  watchers.clear();
}

TEST_F(TenantQuotasTest, BytesBeyondTheRateMustWait) {
  TenantQuotas quotas(Options());
  EXPECT_EQ(quotas.ChargeBytes("lab", 500), absl::ZeroDuration()) << "the burst";
  EXPECT_EQ(quotas.ChargeBytes("lab", 100), absl::Milliseconds(100));
  EXPECT_EQ(quotas.ChargeBytes("lab", 100), absl::Milliseconds(200)) << "another stream waits behind it";
  EXPECT_EQ(quotas.ChargeBytes("field", 500), absl::ZeroDuration());
  now_ += absl::Milliseconds(200);
  EXPECT_EQ(quotas.ChargeBytes("lab", 0), absl::ZeroDuration());
  now_ += absl::Hours(1);
  EXPECT_EQ(quotas.ChargeBytes("lab", 501), absl::Milliseconds(1)) << "no more than the burst is saved";
  now_ -= absl::Hours(2);
  EXPECT_EQ(quotas.ChargeBytes("lab", 1), absl::Milliseconds(2)) << "the clock was set back";
}

TEST_F(TenantQuotasTest, AStreamThatWaitsStaysWithinTheLimit) {
  TenantQuotas quotas(Options());
  uint64_t bytes = 0;
  while (now_ < absl::UnixEpoch() + absl::Seconds(100)) {
    now_ += quotas.ChargeBytes("lab", 64) + absl::Microseconds(1);
    bytes += 64;
  }
  EXPECT_LE(bytes, 100'000u + 500u + 64u);
  EXPECT_GE(bytes, 99'000u);
}

TEST_F(TenantQuotasTest, WithoutALimitNothingWaits) {
  TenantQuotas::Options options = Options();
  options.max_bytes_per_s = 0;
  TenantQuotas quotas(options);
  EXPECT_EQ(quotas.ChargeBytes("lab", uint64_t{1} << 60), absl::ZeroDuration());
}

}  // namespace
}  // namespace evpose::server
