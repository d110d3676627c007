// SPDX-License-Identifier: Apache-2.0

// The kinds of stores that the suite tests.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/open_store.h"
#include "server/stores/postgres/postgres_store.h"
#include "server/stores/postgres/postgres_testing.h"
#include "server/stores/redis/redis_keys.h"
#include "server/stores/redis/redis_store.h"
#include "server/stores/redis/redis_testing.h"
#include "server/stores/sqlite/sqlite_database.h"
#include "server/stores/sqlite/sqlite_store.h"
#include "server/stores/store_suite_testing.h"

namespace evpose::server {

class MemoryFixture : public StoreFixture {
 public:
  absl::StatusOr<std::unique_ptr<Store>> Open() override { return OpenSmall(UINT64_MAX); }
  absl::StatusOr<std::unique_ptr<Store>> OpenSmall(uint64_t max_bytes) override {
    sessions_ = std::make_shared<MemorySessions>(max_bytes);
    return MakeMemoryStore(sessions_);
  }
  void RepeatLastNumber() override {
    MemorySessions::Contents contents = sessions_->Copy();
    --contents.last_fencing_number;
    sessions_->Replace(std::move(contents));
  }
  std::function<void()> Snapshot() override {
    return [sessions = sessions_, contents = sessions_->Copy()] { sessions->Replace(contents); };
  }
  bool keeps() const override { return false; }

 private:
  std::shared_ptr<MemorySessions> sessions_;
};

class SqliteFixture : public StoreFixture {
 public:
  absl::StatusOr<std::unique_ptr<Store>> Open() override {
    return OpenSqliteStore({.data_dir = directory_.path() + "/data"});
  }
  absl::StatusOr<std::unique_ptr<Store>> OpenSmall(uint64_t max_bytes) override {
    return OpenSqliteStore({.data_dir = directory_.path() + "/data", .max_bytes = max_bytes});
  }
  void RepeatLastNumber() override {
    const auto database = SqliteDatabase::Open(directory_.path() + "/data/evpose.db").value();
    ASSERT_TRUE(database->Execute("UPDATE fencing SET last = last - 1").ok());
  }

 private:
  const TemporaryDirectory directory_;
};

// Gives Redis memory for about `max_bytes` more than it uses.
inline void LimitMemory(const RedisServer& redis, uint64_t max_bytes) {
  const std::string memory = redis.Text({"INFO", "memory"});
  const size_t used = memory.find("used_memory:") + sizeof("used_memory:") - 1;
  // Redis counts the buffers of commands in transit as used memory, several times.
  const uint64_t limit = std::stoull(memory.substr(used)) + max_bytes + (8u << 20);
  redis.Run({"CONFIG", "SET", "maxmemory", std::to_string(limit)});
}

inline void RepeatNumberOn(const RedisServer& redis) {
  redis.Run({"HINCRBY", RedisBucketKey(RedisBucketOf("sessions/a")), "fencing", "-1"});
}

class RedisFixture : public StoreFixture {
 public:
  absl::StatusOr<std::unique_ptr<Store>> Open() override {
    RedisStoreOptions options;
    options.client.address = ParseRedisAddress(redis_.url()).value();
    options.client.timeout = absl::Seconds(120);  // a busy machine must not be taken for a lost server
    return OpenRedisStore(options);
  }
  absl::StatusOr<std::unique_ptr<Store>> OpenSmall(uint64_t max_bytes) override {
    LimitMemory(redis_, max_bytes);
    return Open();
  }
  void RepeatLastNumber() override { RepeatNumberOn(redis_); }
  std::function<void()> Snapshot() override {
    return [this, contents = redis_.Contents()] { redis_.Replace(contents); };
  }

 private:
  RedisServer redis_;
};

// Two Redis groups without replicas.
class RedisGroupsFixture : public StoreFixture {
 public:
  absl::StatusOr<std::unique_ptr<Store>> Open() override {
    RedisStoreOptions options;
    for (const auto& [name, redis] : Servers()) {
      RedisClientOptions client;
      client.address = ParseRedisAddress(redis->url()).value();
      client.timeout = absl::Seconds(120);  // a busy machine must not be taken for a lost server
      options.groups.push_back({.name = name, .client = client});
    }
    return OpenRedisStore(options);
  }
  absl::StatusOr<std::unique_ptr<Store>> OpenSmall(uint64_t max_bytes) override {
    for (const auto& [name, redis] : Servers()) LimitMemory(*redis, max_bytes);
    return Open();
  }
  void RepeatLastNumber() override { RepeatNumberOn(*PlaceOf("sessions/a")); }
  bool AreTogether(const std::string& session, const std::string& other) const override {
    return PlaceOf(session) == PlaceOf(other);
  }
  std::function<void()> Snapshot() override {
    std::vector<std::function<void()>> replace;
    for (const auto& [name, redis] : Servers()) {
      replace.push_back([redis = redis, contents = redis->Contents()] { redis->Replace(contents); });
    }
    return [replace] {
      for (const auto& one : replace) one();
    };
  }

 private:
  std::vector<std::pair<std::string, const RedisServer*>> Servers() const { return {{"a", &a_}, {"b", &b_}}; }
  const RedisServer* PlaceOf(const std::string& session) const {
    return Servers()[static_cast<size_t>(RedisBucketOf(session) % 2)].second;
  }

  RedisServer a_;
  RedisServer b_;
};

class SentinelFixture : public StoreFixture {
 public:
  absl::StatusOr<std::unique_ptr<Store>> Open() override {
    RedisStoreOptions options;
    options.client.address = ParseRedisAddress(group_.url()).value();
    // A busy machine must not be taken for a lost master or replica.
    options.client.timeout = absl::Seconds(120);
    options.client.replica_timeout = absl::Seconds(60);
    return OpenRedisStore(options);
  }
  absl::StatusOr<std::unique_ptr<Store>> OpenSmall(uint64_t max_bytes) override {
    LimitMemory(group_.master(), max_bytes);
    return Open();
  }
  void RepeatLastNumber() override { RepeatNumberOn(group_.master()); }
  std::function<void()> Snapshot() override {
    return [this, contents = group_.master().Contents()] { group_.master().Replace(contents); };
  }

 private:
  RedisGroup group_{{.password = "", .down_after = absl::Minutes(5)}};
};

class PostgresFixture : public StoreFixture {
 public:
  absl::StatusOr<std::unique_ptr<Store>> Open() override { return OpenSmall(UINT64_MAX); }
  absl::StatusOr<std::unique_ptr<Store>> OpenSmall(uint64_t max_bytes) override {
    PostgresStoreOptions options;
    options.client.address = ParsePostgresAddress(postgres_.url()).value();
    options.client.timeout = absl::Seconds(120);  // a busy machine must not be taken for a lost server
    options.client.max_bytes = max_bytes;
    return OpenPostgresStore(options);
  }
  void RepeatLastNumber() override {
    postgres_.Run("SELECT setval('evpose.fencing', last_value, false) FROM evpose.fencing");
  }
  std::function<void()> Snapshot() override {
    std::string copy = "BEGIN; ";
    std::string restore = "BEGIN; ";
    for (const char* const table : {"sessions", "leases", "poses"}) {
      absl::StrAppend(&copy, "CREATE TABLE public.", table, " AS TABLE evpose.", table, "; ");
      absl::StrAppend(&restore, "DELETE FROM evpose.", table, "; INSERT INTO evpose.", table, " TABLE public.", table,
                      "; ");
    }
    const std::string last = postgres_.Run("SELECT last_value FROM evpose.fencing");
    postgres_.Run(copy + "COMMIT");
    absl::StrAppend(&restore, "SELECT setval('evpose.fencing', ", last, "); COMMIT");
    return [this, restore] { postgres_.Run(restore); };
  }

 private:
  PostgresServer postgres_;
};

class StoreSuite : public testing::TestWithParam<TestedStore> {
 protected:
  void SetUp() override {
    fixture_ = GetParam().build();
    store_ = fixture_->Open().value();
  }
  void Reopen() {
    store_.reset();
    store_ = fixture_->Open().value();
  }

  std::unique_ptr<StoreFixture> fixture_;
  std::unique_ptr<Store> store_;
};

inline const auto kTestedStores =
    testing::Values(TestedStore{"Memory", [] { return std::make_unique<MemoryFixture>(); }},
                    TestedStore{"Sqlite", [] { return std::make_unique<SqliteFixture>(); }},
                    TestedStore{"Redis", [] { return std::make_unique<RedisFixture>(); }},
                    TestedStore{"RedisGroups", [] { return std::make_unique<RedisGroupsFixture>(); }},
                    TestedStore{"Sentinel", [] { return std::make_unique<SentinelFixture>(); }},
                    TestedStore{"Postgres", [] { return std::make_unique<PostgresFixture>(); }});
inline std::string NameOfTestedStore(const testing::TestParamInfo<TestedStore>& tested) { return tested.param.name; }

}  // namespace evpose::server
