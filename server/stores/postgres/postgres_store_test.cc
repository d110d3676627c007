// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "server/stores/open_store.h"
#include "server/stores/postgres/postgres_testing.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {
namespace {

TEST(PostgresAddressTest, ReadsAllParts) {
  EXPECT_EQ(ParsePostgresAddress("postgresql://me:p%40ss@host:6000/db")->Get("password"), "p@ss");
}

}  // namespace
}  // namespace evpose::server
