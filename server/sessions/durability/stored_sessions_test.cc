// SPDX-License-Identifier: Apache-2.0

// Stores of this version and of earlier ones, in tests/data/storage/: a server opens them, reads what their
// expected.txt says, and resumes their sessions. If the environment variable EVPOSE_WRITE_STORE names a new directory,
// the last test writes a store of this version there (tests/data/storage/SOURCE.txt says when):
//   EVPOSE_WRITE_STORE=$PWD/tests/data/storage/v5 build/release/server/sessions/sessions_test
//   --gtest_filter='*AStoreIsWritten'
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "core/base/byte_order.h"
#include "core/base/state_io.h"
#include "core/base/temporary_directory_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/numerics/hash.h"
#include "server/sessions/durability/session_codec.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/session_testing.h"
#include "server/sessions/tracker_factory.h"
#include "server/stores/sqlite/sqlite_store.h"
#include "server/stores/store_suite_testing.h"
#include "server/telemetry/log_testing.h"
#include "tests/data/test_data.h"

namespace evpose::server {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

// Contents of the store. The sessions are identified by their request_id: one with a readable tracker state, one with a
// tracker state of a version that no server writes, and one that has ended.
constexpr char kStoredTenant[] = "stored";
constexpr char kToken[] = "the token of the stored sessions";
constexpr const char* kRequests[] = {"tracked", "foreign", "ended"};
constexpr int64_t kChunkUs = 10'000;
constexpr uint64_t kNumChunks = 4;  // that have been persisted

RigidTransform PoseAt(double t_s) {
  return evpose::testing::MakePose({0.3 * t_s, 0.1 * t_s, 0.8}, {0.5 + 1.0 * t_s, 0.4 + 2.0 * t_s, 0.1});
}

std::string Chunk(uint64_t seq) {
  const SessionConfig config = SomeConfig();
  evpose::testing::IdealEventOptions options;
  options.t_begin_us = static_cast<int64_t>(seq - 1) * kChunkUs;
  options.duration_us = kChunkUs;
  options.clutter_per_s = 5'000;
  options.seed = seq;
  return Flat64(evpose::testing::MakeIdealEvents(*evpose::testing::MakeCube(0.2), config.camera, PoseAt, options));
}

// All numbers of a pose, to the bit.
void AppendPose(const StoredPose& pose, StateWriter& writer) {
  const PoseEstimate& estimate = pose.estimate;
  writer(pose.pose_seq, pose.object_index, estimate.t_us, estimate.camera_from_object, estimate.covariance,
         estimate.twist, static_cast<uint32_t>(estimate.state), estimate.num_events, estimate.explained_ratio,
         estimate.residual_rms_px, pose.latency_us);
}

// A line with what a reader must find in a stored session.
std::string Describe(const std::string& request_id, const Session& session) {
  const SessionConfig& config = session.config();
  const SensorProfile& sensor = config.sensor;
  StateWriter configuration;
  configuration(static_cast<uint32_t>(config.encoding), static_cast<uint32_t>(config.estimator), config.camera.width_px,
                config.camera.height_px, config.camera.fx_px, config.camera.fy_px, config.camera.cx_px,
                config.camera.cy_px, sensor.pixel_noise_px, sensor.blur_px, sensor.contrast_threshold,
                sensor.refractory_us, sensor.latency_us, static_cast<uint32_t>(config.overload_policy));
  for (const double coefficient : config.camera.Coefficients()) configuration(coefficient);
  for (const ObjectConfig& object : config.objects) {
    configuration.Bytes(object.object_id);
    configuration(object.initial_camera_from_object, object.reference_rotation);
  }
  StateWriter poses;
  for (const StoredPose& pose : session.ReadPoses(0, SIZE_MAX)) AppendPose(pose, poses);
  const auto digest = [](StateWriter& writer) {
    const std::string bytes = writer.Take();
    return Sha256Hex(AsBytes(bytes)).substr(0, 16);
  };
  const SessionHealth health = session.Snapshot().health;
  return absl::StrCat(request_id, " configuration ", digest(configuration), " poses ", health.poses, " ", digest(poses),
                      " events ", health.counts.cd_events, " bytes ", health.processed_bytes, " sensor_time_us ",
                      health.sensor_time_us, " t_us ", health.t_us, " state ",
                      static_cast<int>(health.objects.at(0).state), "\n");
}

class StoredSessionsTest : public ::testing::Test {
 protected:
  ~StoredSessionsTest() override {
    if (sessions_ != nullptr) sessions_->CloseAll(absl::CancelledError("the end of the test"));
    sessions_.reset();
    models_.reset();
    pool_.Join();
  }

  void Open(const std::string& data_dir) {
    store_ = OpenSqliteStore({.data_dir = data_dir}).value();
    ASSERT_TRUE(store_->damage().empty());
    models_ = ModelRegistry::Create({}, *store_).value();
    SessionManager::Options options;
    options.make_tracker = MakeTrackerFactory();
    options.now = [this] { return now_; };
    sessions_ = std::make_unique<SessionManager>(options, *store_, *models_, pool_);
    ASSERT_TRUE(sessions_->FindStored().ok());
    RestoreAll(*sessions_, *store_);
  }
  std::shared_ptr<Session> Find(const std::string& request_id) {
    const auto record = store_->FindRequest(kStoredTenant, request_id);
    return record.ok() ? sessions_->Get(kStoredTenant, record->name).value() : nullptr;
  }
  void Track(const std::shared_ptr<Session>& session, uint64_t stream, uint64_t seq) {
    ASSERT_TRUE(session->PushEvents(stream, {.seq = seq, .payload = Chunk(seq)}).ok());
    Until(session, [&] { return session->View(stream).ack.processed_seq == seq; });
    session->ReportSent(stream, session->Watch().last_pose_seq);
  }
  void ExpectPosesAreTrue(const std::shared_ptr<Session>& session, uint64_t first_pose_seq) {
    uint64_t expected = first_pose_seq;
    for (const StoredPose& pose : session->ReadPoses(first_pose_seq - 1, SIZE_MAX)) {
      EXPECT_EQ(pose.pose_seq, expected++);
      const RigidTransform truth = PoseAt(static_cast<double>(pose.estimate.t_us) * 1e-6);
      EXPECT_LT((pose.estimate.camera_from_object.translation_m - truth.translation_m).norm(), 0.05);
    }
    EXPECT_GT(expected, first_pose_seq);
  }

  absl::Time now_ = absl::FromUnixSeconds(1'000'000);
  WorkerPool pool_{2};
  std::unique_ptr<Store> store_;
  std::unique_ptr<ModelRegistry> models_;
  std::unique_ptr<SessionManager> sessions_;
  const std::shared_ptr<WaitingListener> listener_ = std::make_shared<WaitingListener>();
};

class EarlierStoreTest : public StoredSessionsTest, public ::testing::WithParamInterface<const char*> {
 protected:
  void SetUp() override {
    fs::copy(FindTestData(absl::StrCat("storage/", GetParam())), directory_.path(), fs::copy_options::recursive);
    for (const auto& entry : fs::recursive_directory_iterator(directory_.path())) {
      fs::permissions(entry.path(), fs::perms::owner_write, fs::perm_options::add);
    }
    captured_log.Take();
    ASSERT_NO_FATAL_FAILURE(Open(directory_.path()));
    log_ = captured_log.Take();
  }

  TemporaryDirectory directory_;
  std::string log_;
};
constexpr const char* kVersions[] = {"v1", "v2", "v3", "v4", "v5", "v6", "v7"};
INSTANTIATE_TEST_SUITE_P(Versions, EarlierStoreTest, ::testing::ValuesIn(kVersions));

TEST(EarlierStoresTest, EachIsRead) {
  size_t num_stores = 0;
  for (const auto& entry : fs::directory_iterator(FindTestData("storage"))) num_stores += entry.is_directory() ? 1 : 0;
  EXPECT_EQ(num_stores, std::size(kVersions)) << "a new folder of tests/data/storage must be in kVersions";
}

TEST_P(EarlierStoreTest, EverythingIsReadAsItWasWritten) {
  std::ifstream file(FindTestData(absl::StrCat("storage/", GetParam(), "/expected.txt")));
  const std::string expected((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  std::string found;
  for (const char* request_id : kRequests) {
    const auto session = Find(request_id);
    ASSERT_NE(session, nullptr);
    absl::StrAppend(&found, Describe(request_id, *session));
    const StoredSession stored = store_->ReadSession(session->name(), 0).value();
    const auto lifecycle = DecodeLifecycle(stored.lifecycle);
    ASSERT_TRUE(lifecycle.ok()) << lifecycle.status();
    EXPECT_EQ(lifecycle->token_digest, TokenDigest(kToken));
    EXPECT_EQ(lifecycle->num_attaches, 1u);
    EXPECT_EQ(lifecycle->detached_at, absl::FromUnixSeconds(1'000'000));
    const auto checkpoint = DecodeCheckpoint(stored.checkpoint, 1);
    ASSERT_TRUE(checkpoint.ok()) << checkpoint.status();
    EXPECT_EQ(checkpoint->has_ended, request_id == std::string("ended"));
    EXPECT_GE(checkpoint->processed_seq, kNumChunks);
    EXPECT_EQ(checkpoint->pipeline.has_value(), !checkpoint->has_ended);
    if (checkpoint->has_ended) continue;
    EXPECT_EQ(checkpoint->processed_seq, kNumChunks);
    EXPECT_GE(checkpoint->pipeline->position.first_t_us, 0);
    EXPECT_EQ(checkpoint->pipeline->position.now_us, checkpoint->health.t_us);
    EXPECT_LT(checkpoint->pipeline->position.now_us, static_cast<int64_t>(kNumChunks) * kChunkUs);
    EXPECT_FALSE(checkpoint->pipeline->tracker.bytes.empty());
  }
  EXPECT_EQ(found, expected);
}

TEST_P(EarlierStoreTest, ItsSessionsAreListedAndTheirPosesAreRead) {
  EXPECT_EQ(sessions_->List(kStoredTenant, "", 10)->size(), std::size(kRequests));
  EXPECT_THAT(log_, Not(HasSubstr("session_not_resumed")));
  for (const char* request_id : kRequests) {
    SCOPED_TRACE(request_id);
    const auto session = Find(request_id);
    ASSERT_NE(session, nullptr);
    EXPECT_EQ(session->Watch().has_ended, request_id == std::string("ended"));
    EXPECT_GT(session->Snapshot().health.counts.cd_events, 0u);
    EXPECT_EQ(session->pose_log().last_pose_seq(), session->Snapshot().health.poses);
    ExpectPosesAreTrue(session, 1);
  }
}

TEST_P(EarlierStoreTest, TrackingContinues) {
  int num_searched = 0;
  for (const char* request_id : {"tracked", "foreign"}) {
    SCOPED_TRACE(request_id);
    const auto session = Find(request_id);
    ASSERT_NE(session, nullptr);
    const SessionHealth before = session->Snapshot().health;
    const auto attachment = session->Attach(kToken, before.poses, listener_);
    ASSERT_TRUE(attachment.ok()) << attachment.status();
    ASSERT_EQ(attachment->next_seq, kNumChunks + 1);
    const bool is_searched = !session->TakeNotices(attachment->stream).empty();
    num_searched += is_searched ? 1 : 0;
    EXPECT_TRUE(is_searched || request_id != std::string("foreign"));
    uint64_t seq = kNumChunks;
    while (session->Snapshot().health.poses == before.poses && seq < 20 * kNumChunks) {
      Track(session, attachment->stream, ++seq);
    }
    ExpectPosesAreTrue(session, before.poses + 1);
    const SessionHealth after = session->Snapshot().health;
    EXPECT_GT(after.counts.cd_events, before.counts.cd_events);
    EXPECT_GT(after.processed_bytes, before.processed_bytes);
  }
  const std::vector<std::string> pieces = absl::StrSplit(log_, "tracker_state_unreadable");
  EXPECT_EQ(pieces.size(), 1u + num_searched) << log_;
}

TEST_F(StoredSessionsTest, AStoreIsWritten) {
  const char* directory = std::getenv("EVPOSE_WRITE_STORE");
  if (directory == nullptr) GTEST_SKIP() << "EVPOSE_WRITE_STORE names no directory";
  ASSERT_NO_FATAL_FAILURE(Open(directory));
  const auto cube = std::make_shared<const std::vector<uint8_t>>(kCubeObj, kCubeObj + sizeof(kCubeObj) - 1);
  SessionConfig config = SomeConfig({"cube"}, models_->Upload(kStoredTenant, {}, "", cube).value().name);
  config.sensor = evpose::testing::UnbiasedSensor();
  config.objects[0].initial_camera_from_object = PoseAt(0.0);
  std::string expected;
  for (const std::string request_id : kRequests) {
    const auto session = sessions_->Create(kStoredTenant, config, request_id).value();
    const uint64_t stream = session->Attach(session->resume_token(), 0, listener_)->stream;
    for (uint64_t seq = 1; seq <= kNumChunks; ++seq) Track(session, stream, seq);
    if (request_id == "ended") {
      ASSERT_TRUE(session->PushEnd(stream).ok());
      Until(session, [&] { return session->View(stream).has_ended; });
    }
    session->Detach(stream);
    session->Flush();
    Until(session, [&] { return session->IsFlushed(); });
    absl::StrAppend(&expected, Describe(request_id, *session));
  }
  sessions_->CloseAll(absl::CancelledError("written"));
  const SessionPage page = store_->ListSessions(kStoredTenant, "", SIZE_MAX >> 1).value();
  for (const SessionRecord& record : page.records) {
    auto acquired = store_->AcquireSession(record.name).value();
    SessionCheckpoint checkpoint = DecodeCheckpoint(acquired.session.checkpoint, 1).value();
    if (record.request_id == "foreign") checkpoint.pipeline->tracker.version = UINT32_MAX;
    const SessionLifecycle lifecycle = {.token_digest = TokenDigest(kToken), .num_attaches = 1, .detached_at = now_};
    ASSERT_TRUE(CommitNow(*acquired.lease,
                          {.checkpoint = EncodeCheckpoint(checkpoint), .lifecycle = EncodeLifecycle(lifecycle)})
                    .ok());
  }
  std::ofstream(fs::path(directory) / "expected.txt") << expected;
}

}  // namespace
}  // namespace evpose::server
