// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/session_manager.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <future>
#include <new>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "core/base/poll_testing.h"
#include "core/base/trace_context.h"
#include "server/runtime/errors.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"
#include "server/stores/store_suite_testing.h"
#include "server/telemetry/log_testing.h"

namespace evpose::server {
namespace {

std::shared_ptr<const std::vector<uint8_t>> Bytes(const std::string& text) {
  return std::make_shared<const std::vector<uint8_t>>(text.begin(), text.end());
}

std::vector<std::string> NamesOf(const absl::StatusOr<std::vector<SessionInfo>>& sessions) {
  std::vector<std::string> names;
  for (const SessionInfo& session : sessions.value()) names.push_back(session.name);
  return names;
}

class SessionManagerTest : public testing::Test {
 protected:
  static ModelRegistry::Options SmallRegistry() {
    ModelRegistry::Options options;
    options.limits.max_model_bytes = 4096;
    options.limits.max_store_bytes = 60000;
    return options;
  }

  SessionManagerTest()
      : store_(MakeMemoryStore()),
        models_(ModelRegistry::Create(SmallRegistry(), *store_).value()),
        model_(models_->Upload("", {}, "", Bytes(kCubeObj)).value().name) {
    SessionManager::Options options;
    options.max_sessions = 2;
    options.limits.expiry = absl::Minutes(1);
    options.make_tracker = FakeTrackers();
    options.now = [this] { return now_; };
    sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
  }
  ~SessionManagerTest() override { pool_.Join(); }

  SessionConfig Config() const { return SomeConfig({"cube"}, model_); }
  void MaintainStore() {
    sessions_->MaintainStore();
    std::promise<void> done;
    pool_.slow().PostOwn([&done] { done.set_value(); });
    done.get_future().wait();
  }

  absl::Time now_ = absl::UnixEpoch();
  WorkerPool pool_{1};  // outlives the store: its thread may release the last reference to a session
  const std::unique_ptr<Store> store_;
  const std::unique_ptr<ModelRegistry> models_;
  const std::string model_;
  std::unique_ptr<SessionManager> sessions_;
};

TEST_F(SessionManagerTest, MakesFindsListsAndDeletes) {
  const auto a = sessions_->Create("", Config(), "").value();
  const auto b = sessions_->Create("", Config(), "").value();
  EXPECT_NE(a->name(), b->name());
  EXPECT_NE(a->resume_token(), b->resume_token());
  EXPECT_EQ(sessions_->Get("", a->name()).value(), a);
  const std::vector<std::string> all = NamesOf(sessions_->List("", "", 10));
  EXPECT_THAT(all, testing::UnorderedElementsAre(a->name(), b->name()));
  EXPECT_LT(all[0], all[1]);
  EXPECT_THAT(NamesOf(sessions_->List("", "", 1)), testing::ElementsAre(all[0]));
  EXPECT_THAT(NamesOf(sessions_->List("", all[0], 10)), testing::ElementsAre(all[1]));
  EXPECT_TRUE(sessions_->Delete("", a->name()).ok());
  EXPECT_EQ(GetErrorDetails(sessions_->Delete("", a->name())).reason, "SESSION_NOT_FOUND");
  EXPECT_EQ(GetErrorDetails(sessions_->Get("", a->name()).status()).reason, "SESSION_NOT_FOUND");
  EXPECT_EQ(GetErrorDetails(a->Watch().status).reason, "SESSION_DELETED");
  EXPECT_EQ(sessions_->num_sessions(), 1u);
}

TEST_F(SessionManagerTest, RefusesObjectsThatDoNotDetermineAPose) {
  // Models with two lines only; with two lines of which one consists of two pieces; with parallel lines.
  for (const char* obj :
       {"v 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nl 1 3\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nl 1 2\nl 1 3\nl 2 4\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0 0 1\nv 1 0 1\nl 1 2\nl 3 4\nl 5 6\n"}) {
    SessionConfig config = SomeConfig({"good", "bad"}, model_);
    config.objects[1].model = models_->Upload("", {}, "", Bytes(obj)).value().name;
    // They are refused also with a first pose: tracking would start, but the pose would drift.
    for (const bool has_pose : {true, false}) {
      if (!has_pose) config.objects[1].initial_camera_from_object.reset();
      const absl::Status status = sessions_->Create("", config, "").status();
      EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << obj;
      EXPECT_EQ(GetErrorDetails(status).field, "config.objects[1].model");
      EXPECT_THAT(std::string(status.message()), testing::HasSubstr("lines"));
    }
  }
  EXPECT_EQ(sessions_->num_sessions(), 0u);
}

TEST_F(SessionManagerTest, ARequestIdMakesOneSession) {
  const auto first = sessions_->Create("", Config(), "request").value();
  EXPECT_EQ(sessions_->Create("", Config(), "request").value(), first);
  SessionConfig other = Config();
  other.camera.fx_px = 301;
  SessionConfig turned = Config();
  turned.objects[0].reference_rotation = Eigen::Vector3d(1, -1, -1).asDiagonal();
  EXPECT_EQ(GetErrorDetails(sessions_->Create("", turned, "request").status()).reason, "REQUEST_ID_REUSED");
  const auto reused = sessions_->Create("", other, "request");
  EXPECT_EQ(reused.status().code(), absl::StatusCode::kAlreadyExists);
  EXPECT_EQ(GetErrorDetails(reused.status()).reason, "REQUEST_ID_REUSED");
  EXPECT_TRUE(sessions_->Delete("", first->name()).ok());
  EXPECT_NE(sessions_->Create("", other, "request").value(), first) << "the request_id can be used again";
}

TEST_F(SessionManagerTest, TheNumberOfSessionsIsLimited) {
  const auto first = sessions_->Create("", Config(), "").value();
  ASSERT_TRUE(sessions_->Create("", Config(), "").ok());
  const absl::Status full = sessions_->Create("", Config(), "").status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  const ErrorDetails details = GetErrorDetails(full);
  EXPECT_EQ(details.reason, "TOO_MANY_SESSIONS");
  EXPECT_EQ(details.quota_subject, "max_sessions");
  EXPECT_GT(details.retry_after, absl::ZeroDuration());
  EXPECT_TRUE(sessions_->Delete("", first->name()).ok());
  EXPECT_TRUE(sessions_->Create("", Config(), "").ok());
}

TEST_F(SessionManagerTest, AFailedCreationTakesNoSlot) {
  for (int i = 0; i < 5; ++i) {
    const absl::Status status = sessions_->Create("", SomeConfig({"cube"}, "models/none"), "").status();
    EXPECT_EQ(status.code(), absl::StatusCode::kNotFound);
    EXPECT_EQ(GetErrorDetails(status).reason, "MODEL_NOT_FOUND");
  }
  EXPECT_TRUE(sessions_->Create("", Config(), "").ok());
}

TEST_F(SessionManagerTest, NamesTheWrongFieldOfAConfiguration) {
  const auto field_of = [this](const SessionConfig& config) {
    return GetErrorDetails(sessions_->Create("", config, "").status()).field;
  };
  SessionConfig config = Config();
  config.camera.fx_px = 0;
  EXPECT_EQ(field_of(config), "config.camera");
  config = Config();
  config.objects.clear();
  EXPECT_EQ(field_of(config), "config.objects");
  config = SomeConfig({"a", "a"}, model_);
  EXPECT_EQ(field_of(config), "config.objects[1].object_id");
  config = SomeConfig({""}, model_);
  EXPECT_EQ(field_of(config), "config.objects[0].object_id");
  config = SomeConfig({"a"}, "");
  EXPECT_EQ(field_of(config), "config.objects[0].model");
}

TEST_F(SessionManagerTest, DeletesExpiredSessions) {
  const auto session = sessions_->Create("", Config(), "").value();
  const auto attached = sessions_->Create("", Config(), "").value();
  const auto listener = std::make_shared<WaitingListener>();
  ASSERT_TRUE(attached->Attach(attached->resume_token(), 0, listener).ok());
  now_ += absl::Seconds(59);
  EXPECT_TRUE(sessions_->Get("", session->name()).ok());
  now_ += absl::Seconds(2);
  captured_log.Take();
  EXPECT_FALSE(sessions_->Get("", session->name()).ok());
  EXPECT_TRUE(sessions_->Get("", attached->name()).ok());
  const std::string of_session =
      absl::StrCat(" session=", session->name(), " tenant=\"\" peer=\"\" trace_id=", TraceIdOf(session->name()), " ");
  std::vector<std::string> lines = absl::StrSplit(captured_log.Take(), '\n');
  std::erase_if(lines, [&](const std::string& line) { return !absl::StrContains(line, session->name()); });
  EXPECT_THAT(lines, testing::ElementsAre(testing::StartsWith("debug session_state" + of_session + "change=close "),
                                          testing::StartsWith("info session_expired" + of_session + "cause=expired ")));
  EXPECT_THAT(std::string(session->Watch().status.message()), testing::HasSubstr("expired"));
}

TEST_F(SessionManagerTest, MakesNothingWhileDraining) {
  EXPECT_TRUE(sessions_->CheckNotDraining().ok());
  sessions_->Drain();
  const absl::Status status = sessions_->Create("", Config(), "").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_EQ(GetErrorDetails(status).reason, "DRAINING");
}

TEST_F(SessionManagerTest, AModelInUseCannotBeDeleted) {
  const auto session = sessions_->Create("", Config(), "").value();
  const absl::Status status = models_->Delete("", model_);
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(GetErrorDetails(status).reason, "MODEL_IN_USE");
  EXPECT_TRUE(sessions_->Delete("", session->name()).ok());
  EXPECT_TRUE(models_->Delete("", model_).ok());
  EXPECT_EQ(GetErrorDetails(models_->Delete("", model_)).reason, "MODEL_NOT_FOUND");
  EXPECT_EQ(models_->Get("", model_).status().code(), absl::StatusCode::kNotFound);
}

TEST_F(SessionManagerTest, AnUnknownModelCannotBeDeleted) {
  const absl::Status status = models_->Delete("", "models/never");
  EXPECT_EQ(status.code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(GetErrorDetails(status).reason, "MODEL_NOT_FOUND");
  ASSERT_TRUE(store_->PutModel({.name = "models/broken", .bytes = Bytes("no model")}).ok());
  EXPECT_TRUE(models_->Delete("", "models/broken").ok()) << "a stored model can be deleted without being loaded";
  EXPECT_FALSE(store_->ReadModel("", "models/broken").ok());
}

TEST_F(SessionManagerTest, NoCallWaitsWhileTheStoreWrites) {
  class SlowStore : public FaultInjectingStore {
   public:
    using FaultInjectingStore::FaultInjectingStore;
    absl::Status PutModel(const ModelRecord& model) override {
      while_writing();
      return FaultInjectingStore::PutModel(model);
    }
    absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
      while_writing();
      return FaultInjectingStore::DeleteModel(tenant, name);
    }
    std::function<void()> while_writing;
  };
  const auto fault = std::make_shared<InjectedFault>();
  SlowStore store(MakeMemoryStore(), fault);
  const auto registry = ModelRegistry::Create({}, store).value();
  int num_calls = 0;
  store.while_writing = [&] {
    EXPECT_EQ(registry->List("", "", 10).size(), 0u);
    EXPECT_TRUE(registry->limits().BeginUpload("").ok());
    ++num_calls;
  };
  ASSERT_TRUE(registry->Upload("", {}, "", Bytes(kCubeObj)).ok());
  store.while_writing = [&] {
    EXPECT_TRUE(registry->Get("", model_).ok()) << "the model still exists";
    EXPECT_FALSE(registry->Use("", model_).ok()) << "no session may use a model that is being deleted";
    ++num_calls;
  };
  fault->Set(absl::UnavailableError("away"));
  EXPECT_EQ(GetErrorDetails(registry->Delete("", model_)).reason, "STORE_UNAVAILABLE");
  EXPECT_TRUE(registry->Use("", model_).ok()) << "the model is kept";
  fault->Set(absl::OkStatus());
  EXPECT_TRUE(registry->Delete("", model_).ok());
  EXPECT_FALSE(registry->Get("", model_).ok());
  EXPECT_EQ(num_calls, 2) << "an unreachable store is not written to";
}

TEST_F(SessionManagerTest, ModelsAreNamedByContentAndOptions) {
  const ModelInfo again = models_->Upload("", {}, "", Bytes(kCubeObj)).value();
  EXPECT_EQ(again.name, model_);
  EXPECT_EQ(again.num_lines, 12u);
  EXPECT_EQ(again.num_faces, 12u);
  const ModelInfo millimetres = models_->Upload("", {.metres_per_unit = 0.001}, "", Bytes(kCubeObj)).value();
  EXPECT_NE(millimetres.name, model_);
  EXPECT_EQ(millimetres.sha256_hex, again.sha256_hex);
  EXPECT_NEAR(millimetres.diameter_m, 0.001 * again.diameter_m, 1e-9);
  EXPECT_EQ(models_->List("", "", 10).size(), 2u);
}

TEST_F(SessionManagerTest, ModelsThatCannotBeLoadedAreRefused) {
  const auto field_of = [](const absl::StatusOr<ModelInfo>& model) { return GetErrorDetails(model.status()).field; };
  EXPECT_EQ(field_of(models_->Upload("", {}, "", Bytes("v 0 0 nan\n"))), "chunk");
  EXPECT_EQ(field_of(models_->Upload("", {}, std::string(64, '0'), Bytes(kCubeObj))), "header.sha256");
  EXPECT_EQ(field_of(models_->Upload("", {.metres_per_unit = -1}, "", Bytes(kCubeObj))), "header");
  EXPECT_EQ(models_->List("", "", 10).size(), 1u);
}

TEST_F(SessionManagerTest, ARegistryOverAStoreHasItsModels) {
  const auto second = ModelRegistry::Create({}, *store_).value();
  EXPECT_EQ(second->Get("", model_).value().sha256_hex, models_->Get("", model_).value().sha256_hex);
  ASSERT_TRUE(store_->PutModel({.name = "models/broken", .bytes = Bytes("no model")}).ok());
  EXPECT_TRUE(absl::IsDataLoss(ModelRegistry::Create({}, *store_).value()->UseStored("", "models/broken").status()));
}

TEST_F(SessionManagerTest, AStoredSessionIsRestoredWhenItIsNeeded) {
  SessionManager::Options options = sessions_->options();
  options.max_sessions = 3;
  sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
  const auto first = sessions_->Create("", Config(), "").value();
  const auto second = sessions_->Create("", Config(), "").value();
  const auto third = sessions_->Create("", Config(), "again").value();
  const std::string token = second->resume_token();
  sessions_->CloseAll(absl::CancelledError("killed"));
  sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
  ASSERT_TRUE(sessions_->FindStored().ok());
  EXPECT_EQ(sessions_->num_sessions(), 3u) << "a waiting session has its slot";
  EXPECT_EQ(sessions_->totals().detached, 3u);
  EXPECT_EQ(GetErrorDetails(sessions_->Create("", Config(), "").status()).reason, "TOO_MANY_SESSIONS");
  const std::vector<SessionInfo> listed = sessions_->List("", "", 10).value();
  ASSERT_EQ(listed.size(), 3u);
  for (const SessionInfo& info : listed) {
    EXPECT_EQ(info.snapshot.state, SessionState::kDetached);
    EXPECT_EQ(info.snapshot.expire_time, now_ + options.limits.expiry);
  }
  for (const auto& session : {first, second, third}) {
    EXPECT_FALSE(sessions_->Get("", session->name()).ok()) << "a list restores no session";
  }
  EXPECT_TRUE(sessions_->ResumeForAttach("", second->name(), token).ok());
  EXPECT_TRUE(sessions_->Mirror("", first->name()).ok()) << "a watcher needs it";
  EXPECT_TRUE(sessions_->Get("", first->name()).ok());
  EXPECT_EQ(sessions_->Create("", Config(), "again").value()->name(), third->name()) << "a repeated request";
  EXPECT_EQ(sessions_->num_sessions(), 3u);
}

TEST_F(SessionManagerTest, ABusyServerRefusesFurtherSessionsOfATenant) {
  LoadMonitor::Time now;
  LoadMonitor busy({.cpu = [&now] { return now.time_since_epoch(); }, .max_ratio = 0.5, .now = [&now] { return now; }});
  for (int i = 0; i < 60; ++i) {
    now += std::chrono::seconds(1);
    busy.Update();
  }
  SessionManager::Options options = sessions_->options();
  options.max_sessions = 4;
  options.load = &busy;
  sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
  const auto first = sessions_->Create("", Config(), "request");
  ASSERT_TRUE(first.ok()) << "the tenant has no session here: " << first.status();
  EXPECT_EQ(GetErrorDetails(sessions_->Create("", Config(), "another").status()).reason, "OVERLOADED");
  EXPECT_EQ(options.metrics->overload_refusals.value(), 1u);
  EXPECT_EQ(sessions_->Create("", Config(), "request").value(), *first) << "a repeated request";
  (void)models_->Upload("lab", {}, "", Bytes(kCubeObj)).value();
  EXPECT_TRUE(sessions_->Create("lab", Config(), "").ok()) << "another tenant's first session";
  EXPECT_EQ(sessions_->num_sessions(), 2u) << "the slots of refused sessions are free";
}

TEST_F(SessionManagerTest, AStoredSessionThatNobodyNeedsExpires) {
  SessionManager::Options options = sessions_->options();
  options.max_sessions = 1;
  sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
  const std::string name = sessions_->Create("", Config(), "").value()->name();
  sessions_->CloseAll(absl::CancelledError("killed"));
  sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
  ASSERT_TRUE(sessions_->FindStored().ok());
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(sessions_->num_sessions(), 1u);
    now_ += options.limits.expiry / 2;
    MaintainStore();
  }
  EXPECT_EQ(sessions_->num_sessions(), 1u) << "the time is measured from the first check on";
  now_ += options.limits.expiry / 2;
  MaintainStore();
  EXPECT_EQ(sessions_->num_sessions(), 0u);
  EXPECT_TRUE(store_->ListOwners()->empty());
  EXPECT_TRUE(sessions_->Create("", Config(), "").ok()) << "its slot is free";
}

TEST_F(SessionManagerTest, AWaitingSessionThatIsDeletedIsNotRestored) {
  const auto session = sessions_->Create("", Config(), "").value();
  sessions_->CloseAll(absl::CancelledError("killed"));
  SessionManager restarted(sessions_->options(), *store_, *models_, pool_);
  ASSERT_TRUE(restarted.FindStored().ok());
  EXPECT_TRUE(restarted.Delete("", session->name()).ok());
  EXPECT_EQ(restarted.num_sessions(), 0u);
}

TEST_F(SessionManagerTest, ATenantSeesItsOwnSessionsOnly) {
  const std::string model = models_->Upload("lab", {}, "", Bytes(kCubeObj)).value().name;
  EXPECT_EQ(model, model_) << "the name depends on the content, not on the tenant";
  const auto own = sessions_->Create("", Config(), "request").value();
  const auto theirs = sessions_->Create("lab", Config(), "request").value();
  EXPECT_NE(own, theirs) << "request_ids are unique within a tenant only";
  EXPECT_EQ(sessions_->Create("lab", Config(), "request").value(), theirs);
  EXPECT_THAT(NamesOf(sessions_->List("lab", "", 10)), testing::ElementsAre(theirs->name()));
  EXPECT_EQ(sessions_->num_sessions_of("lab"), 1u);
  EXPECT_EQ(sessions_->num_sessions_of("field"), 0u);

  std::string absent = own->name();
  absent.back() = absent.back() == '0' ? '1' : '0';
  const absl::Status unknown = sessions_->Get("lab", absent).status();
  const absl::Status foreign = sessions_->Get("lab", own->name()).status();
  const auto without_name = [](const absl::Status& status, const std::string& name) {
    return absl::StrReplaceAll(std::string(status.message()), {{name, "X"}});
  };
  EXPECT_EQ(without_name(foreign, own->name()), without_name(unknown, absent));
  EXPECT_EQ(GetErrorDetails(foreign).reason, GetErrorDetails(unknown).reason);
  EXPECT_EQ(GetErrorDetails(sessions_->Delete("lab", own->name())).reason, "SESSION_NOT_FOUND");
  EXPECT_EQ(sessions_->Get("", own->name()).value(), own);
}

TEST_F(SessionManagerTest, TheSessionsOfATenantAreLimited) {
  SessionManager::Options options = sessions_->options();
  options.max_tenant_sessions = 1;
  SessionManager sessions(options, *store_, *models_, pool_);
  models_->Upload("lab", {}, "", Bytes(kCubeObj)).value();
  const auto first = sessions.Create("", Config(), "").value();
  const absl::Status full = sessions.Create("", Config(), "").status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(full).reason, "TENANT_QUOTA");
  EXPECT_EQ(GetErrorDetails(full).quota_subject, "tenant_sessions");
  EXPECT_GT(GetErrorDetails(full).retry_after, absl::ZeroDuration());
  EXPECT_TRUE(sessions.Create("lab", Config(), "").ok());
  EXPECT_TRUE(sessions.Delete("", first->name()).ok());
  SessionConfig impossible = Config();
  impossible.objects[0].model = "models/none";
  EXPECT_EQ(sessions.Create("", impossible, "").status().code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(sessions.Create("", Config(), "").ok()) << "a failed creation releases its slot";
}

TEST_F(SessionManagerTest, SessionsAreChargedWithTheirMemoryUntilTheyAreDeleted) {
  SessionManager::Options options = sessions_->options();
  options.memory = MemoryBudget::Create({});
  uint64_t bytes = 0;
  {
    SessionManager sessions(options, *store_, *models_, pool_);
    const auto first = sessions.Create("", Config(), "").value();
    bytes = options.memory->charged_bytes();
    EXPECT_GT(bytes, options.limits.credit_bytes);
    ASSERT_TRUE(sessions.Delete("", first->name()).ok());
  }
  options.memory = MemoryBudget::Create({.max_bytes = bytes + bytes / 2});
  SessionManager sessions(options, *store_, *models_, pool_);
  auto first = sessions.Create("", Config(), "").value();
  EXPECT_EQ(options.memory->charged_bytes(), bytes);
  const absl::Status full = sessions.Create("", Config(), "").status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(full).reason, "SESSION_MEMORY");
  EXPECT_EQ(sessions.num_sessions(), 1u);
  ASSERT_TRUE(sessions.Delete("", first->name()).ok());
  first.reset();
  EXPECT_EQ(options.memory->charged_bytes(), 0u);
  EXPECT_TRUE(sessions.Create("", Config(), "").ok());
}

// A tracker whose first allocation fails.
class HungryTracker : public FakeTracker {
 public:
  using FakeTracker::FakeTracker;
  void AddEvents(absl::Span<const Event>, std::vector<PoseEstimate>&) override { throw std::bad_alloc(); }
};

TEST_F(SessionManagerTest, AFailedAllocationEndsTheOneSession) {
  SessionManager::Options options = sessions_->options();
  options.memory = MemoryBudget::Create({});
  options.make_tracker = [make = options.make_tracker](const SessionConfig& config,
                                                       const auto& models) -> absl::StatusOr<std::unique_ptr<Tracker>> {
    if (config.objects[0].object_id == "greedy") throw std::bad_alloc();
    if (config.objects[0].object_id == "cube") return make(config, models);
    return std::make_unique<HungryTracker>(std::make_shared<FakeTrackerGate>(), config);
  };
  SessionManager sessions(options, *store_, *models_, pool_);
  const absl::Status refused = sessions.Create("", SomeConfig({"greedy"}, model_), "").status();
  EXPECT_EQ(GetErrorDetails(refused).reason, "OUT_OF_MEMORY");
  EXPECT_EQ(options.memory->charged_bytes(), 0u);

  const auto listener = std::make_shared<WaitingListener>();
  const auto push = [&](const std::shared_ptr<Session>& session) {
    session->AddWatcher(listener);
    const uint64_t stream = session->Attach(session->resume_token(), 0, {})->stream;
    EXPECT_TRUE(session->PushEvents(stream, {.seq = 1, .payload = Flat64(SomeEvents(1, 11))}).ok());
  };
  const auto hungry = sessions.Create("", SomeConfig({"hungry"}, model_), "").value();
  const auto cube = sessions.Create("", Config(), "").value();
  const uint64_t charged_bytes = options.memory->charged_bytes();
  push(hungry);
  push(cube);
  listener->WaitUntil([&] { return !hungry->Watch().status.ok() && cube->Watch().last_pose_seq >= 9; });
  EXPECT_EQ(hungry->Watch().status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(hungry->Watch().status).reason, "OUT_OF_MEMORY");
  EXPECT_LT(options.memory->charged_bytes(), charged_bytes) << "its tracker was released";
  EXPECT_TRUE(cube->Watch().status.ok());
}

TEST_F(SessionManagerTest, ModelsOfTwoTenantsAreSeparate) {
  const absl::Status unknown = models_->Get("lab", model_).status();
  EXPECT_EQ(GetErrorDetails(unknown).reason, "MODEL_NOT_FOUND");
  EXPECT_EQ(models_->Use("lab", model_).status(), unknown);
  EXPECT_TRUE(models_->List("lab", "", 10).empty());
  EXPECT_EQ(GetErrorDetails(sessions_->Create("lab", Config(), "").status()).reason, "MODEL_NOT_FOUND");
  models_->Upload("lab", {}, "", Bytes(kCubeObj)).value();
  const auto session = sessions_->Create("lab", Config(), "").value();
  EXPECT_TRUE(models_->Delete("", model_).ok()) << "sessions of other tenants do not prevent the deletion";
  EXPECT_EQ(GetErrorDetails(models_->Delete("lab", model_)).reason, "MODEL_IN_USE");
  EXPECT_EQ(models_->List("lab", "", 10).size(), 1u);
  EXPECT_TRUE(models_->List("", "", 10).empty());
  const auto restarted = ModelRegistry::Create({}, *store_).value();
  EXPECT_TRUE(restarted->Get("lab", model_).ok());
  EXPECT_FALSE(restarted->Get("", model_).ok());
}

TEST_F(SessionManagerTest, AServerWhoseClockIsAheadKeepsTheEndedSessionsOfOthers) {
  const auto add = [this](const std::string& name, absl::Time ended_at) {
    const auto lease = store_->CreateSession({.name = name}, "").value();
    EXPECT_TRUE(CommitNow(*lease, {.ended_at = ended_at}).ok());
  };
  add("sessions/old", absl::Now() - absl::Hours(1));
  add("sessions/new", absl::Now());
  now_ = absl::Now() + absl::Hours(1);
  sessions_->DeleteEnded();
  ASSERT_TRUE(Poll([this] { return !store_->ReadSession("sessions/old").ok(); }));
  EXPECT_TRUE(store_->ReadSession("sessions/new").ok());
}

}  // namespace
}  // namespace evpose::server
