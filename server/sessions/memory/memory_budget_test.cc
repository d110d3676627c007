// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/memory/memory_budget.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <vector>

#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

using ::testing::HasSubstr;

constexpr SessionMemory kSession = {.tracking_bytes = 300'000'000, .other_bytes = 100'000'000};

TEST(MemoryBudget, RefusesASessionBeyondTheLimitWithAllNumbers) {
  const auto metrics = std::make_shared<ServerMetrics>();
  const auto budget = MemoryBudget::Create({.max_bytes = 700'000'000, .metrics = metrics});
  const auto first = budget->Charge("a", kSession);
  ASSERT_TRUE(first.ok());
  EXPECT_EQ(budget->charged_bytes(), 400'000'000u);

  const absl::Status refused = budget->Charge("b", kSession).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kResourceExhausted);
  const ErrorDetails details = GetErrorDetails(refused);
  EXPECT_EQ(details.reason, "SESSION_MEMORY");
  EXPECT_EQ(details.quota_subject, "session_memory");
  EXPECT_EQ(details.retry_after, kRetryDelay);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("400000000 bytes"));
  EXPECT_THAT(std::string(refused.message()), HasSubstr("400 of 700 MB"));
  EXPECT_THAT(std::string(refused.message()), HasSubstr("delete a session"));
  EXPECT_EQ(metrics->quota_refusals[QuotaLimit::kSessionMemory].value(), 1u);
  EXPECT_EQ(budget->charged_bytes(), 400'000'000u);
}

TEST(MemoryBudget, ASessionThatCanNeverFitIsNotToldToWait) {
  const auto budget = MemoryBudget::Create({.max_bytes = 1'000'000});
  const absl::Status refused = budget->Charge("a", kSession).status();
  EXPECT_EQ(GetErrorDetails(refused).retry_after, absl::ZeroDuration());
  EXPECT_THAT(std::string(refused.message()), HasSubstr("fewer objects"));
}

TEST(MemoryBudget, EachPartIsReleasedWithItsLastCopy) {
  const auto budget = MemoryBudget::Create({.max_bytes = 400'000'000});
  std::optional<MemoryCharge> charge = *budget->Charge("a", kSession);
  std::optional<MemoryCharge> copy = charge;
  charge->tracking.reset();
  EXPECT_EQ(budget->charged_bytes(), 400'000'000u);
  copy->tracking.reset();  // the session has ended
  EXPECT_EQ(budget->charged_bytes(), 100'000'000u);
  charge.reset();
  copy.reset();
  EXPECT_EQ(budget->charged_bytes(), 0u);
  EXPECT_TRUE(budget->Charge("b", kSession).ok());
}

TEST(MemoryBudget, TenantsHaveALimitOfTheirOwn) {
  const auto metrics = std::make_shared<ServerMetrics>();
  const auto budget =
      MemoryBudget::Create({.max_bytes = 1'000'000'000, .max_tenant_bytes = 500'000'000, .metrics = metrics});
  const auto first = budget->Charge("a", kSession);
  const absl::Status refused = budget->Charge("a", kSession).status();
  EXPECT_EQ(GetErrorDetails(refused).quota_subject, "tenant_session_memory");
  EXPECT_EQ(metrics->quota_refusals[QuotaLimit::kTenantSessionMemory].value(), 1u);
  EXPECT_TRUE(budget->Charge("b", kSession).ok());
}

TEST(MemoryBudget, AModelIsChargedOnceForTheSessionsOfATenant) {
  const auto budget = MemoryBudget::Create({.max_bytes = 1'500'000'000});
  auto model = std::make_shared<const ObjectModel>();
  const std::vector<ModelMemory> models = {{model, 200'000'000}};
  std::optional<MemoryCharge> first = *budget->Charge("a", kSession, models);
  EXPECT_EQ(budget->charged_bytes(), 600'000'000u);
  std::optional<MemoryCharge> second = *budget->Charge("a", kSession, models);
  EXPECT_EQ(budget->charged_bytes(), 1'000'000'000u);
  const absl::Status refused = budget->Charge("b", kSession, models).status();
  EXPECT_THAT(std::string(refused.message()), HasSubstr("600000000 bytes")) << "tenants share no models";
  first.reset();
  EXPECT_EQ(budget->charged_bytes(), 600'000'000u) << "the second session has the model";
  second->tracking.reset();
  EXPECT_EQ(budget->charged_bytes(), 100'000'000u);
  second.reset();
  EXPECT_EQ(budget->charged_bytes(), 0u);
  EXPECT_EQ(model.use_count(), 2) << "of this test";
  EXPECT_TRUE(budget->Charge("b", kSession, models).ok());
}

TEST(MemoryBudget, AnExistingSessionIsChargedBeyondTheLimit) {
  const auto budget = MemoryBudget::Create({.max_bytes = 500'000'000});
  const auto first = budget->ChargeBeyondLimit("a", kSession);
  const auto second = budget->ChargeBeyondLimit("a", kSession);
  EXPECT_EQ(budget->charged_bytes(), 800'000'000u);
  EXPECT_FALSE(budget->Charge("b", {.tracking_bytes = 1}).ok());
}

}  // namespace
}  // namespace evpose::server
