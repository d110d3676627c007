// SPDX-License-Identifier: Apache-2.0
#include "server/program/tenant_limits.h"

#include <gtest/gtest.h>

namespace evpose::server {
namespace {

ServerOptions SmallServer() {
  ServerOptions options;
  options.max_sessions = 13;
  options.max_streams = 100;
  options.max_model_bytes = 600;
  options.max_model_store_bytes = 1000;
  return options;
}

TEST(TenantLimitsTest, WithoutTenantsOnlyTheServersLimitsApply) {
  const ServerOptions::TenantLimits limits = EffectiveTenantLimits(SmallServer());
  EXPECT_EQ(limits.max_sessions.value_or(0), 0u);
  EXPECT_EQ(limits.max_streams.value_or(0), 0u);
}

TEST(TenantLimitsTest, ATenantHasAtMostHalfOfTheServer) {
  ServerOptions with_tokens = SmallServer();
  with_tokens.token_file = "tokens";
  ServerOptions with_certificates = SmallServer();
  with_certificates.tls = {.certificate = "server.crt", .key = "server.key", .client_ca = "ca.crt"};
  for (const ServerOptions& options : {with_tokens, with_certificates}) {
    const ServerOptions::TenantLimits limits = EffectiveTenantLimits(options);
    EXPECT_EQ(limits.max_sessions, 6u);
    EXPECT_EQ(limits.max_streams, 50u);
    EXPECT_EQ(limits.max_watchers, 50u);
    EXPECT_EQ(limits.max_uploads, 32u);
    EXPECT_EQ(limits.max_session_memory, options.max_session_memory / 2);
    EXPECT_EQ(limits.max_model_bytes, 600u) << "one model of the largest size fits";
    EXPECT_EQ(limits.max_bytes_per_s, 0u);
    ServerOptions effective = options;
    effective.tenant = limits;
    EXPECT_TRUE(effective.Validate().ok()) << effective.Validate();
  }
}

TEST(TenantLimitsTest, GivenLimitsAreKept) {
  ServerOptions options = SmallServer();
  options.token_file = "tokens";
  options.tenant.max_sessions = 0;
  options.tenant.max_watchers = 7;
  options.max_streams = 1;
  const ServerOptions::TenantLimits limits = EffectiveTenantLimits(options);
  EXPECT_EQ(limits.max_sessions, 0u) << "no own limit";
  EXPECT_EQ(limits.max_watchers, 7u);
  EXPECT_EQ(limits.max_streams, 1u);
}

}  // namespace
}  // namespace evpose::server
