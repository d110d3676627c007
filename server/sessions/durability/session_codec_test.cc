// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/durability/session_codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "core/base/yields_testing.h"
#include "evpose/storage/v1/session.pb.h"
#include "server/sessions/durability/pose_codec.h"
#include "server/sessions/session_testing.h"

namespace evpose::server {
namespace {

SessionConfig AFullConfig() {
  SessionConfig config = SomeConfig({"cube", "box"});
  config.camera.distortion = {0.1, -0.2, 1e-300, -0.0, 3};
  config.objects[0].initial_camera_from_object->translation_m << 1.0 / 3, -2, 1e10;
  config.objects[1].initial_camera_from_object.reset();
  config.objects[1].reference_rotation = Eigen::Vector3d(1, -1, -1).asDiagonal();
  config.estimator = Estimator::kReleasedMm;
  config.sensor.name = "mine";
  config.sensor.blur_px = 0.1;
  config.pose_rate_hz = 2500.5;
  config.overload_policy = OverloadPolicy::kLatest;
  config.max_lag = absl::Microseconds(12'345);
  return config;
}

SessionLifecycle ALifecycle() {
  return {.token_digest = TokenDigest("new"),
          .previous_token_digest = TokenDigest("old"),
          .num_attaches = 7,
          .detached_at = absl::FromUnixNanos(1'700'000'000'123'456'789),
          .num_renewals = 5,
          .lost_from_seq = 6};
}

SessionCheckpoint ACheckpoint() {
  SessionCheckpoint checkpoint;
  checkpoint.processed_seq = 99;
  checkpoint.health.t_us = 123;
  checkpoint.health.processed_bytes = 456;
  checkpoint.health.counts.cd_events = 7;
  checkpoint.health.counts.clock_wraps = 8;
  checkpoint.health.poses = 9;
  checkpoint.health.processing_us = 10;
  checkpoint.health.skipped_events = 11;
  checkpoint.health.objects = {
      {TrackState::kLost, 3, 0.1f, {.status = InitializationStatus::kTooSmall, .attempts = 5, .num_lines = 6}},
      {TrackState::kAmbiguous, 1, 0.2f, {}}};
  checkpoint.health.objects[0].initialization.searches = {1, 2, 3, 4, 5, 6};
  checkpoint.health.objects[0].initialization.loss_cause = LossCause::kUnconfirmed;
  checkpoint.health.objects[0].initialization.lost_at_us = 77;
  for (int i = 0; i < 100; ++i) checkpoint.latencies.Add(1000);
  checkpoint.pipeline = {.position = {.decoder = std::string("a\0decoder", 9),
                                      .reported_states = {TrackState::kLost, TrackState::kAmbiguous},
                                      .first_t_us = 0,
                                      .now_us = 123,
                                      .slice_end_us = 1000},
                         .tracker = {.version = 3, .configuration = "digest", .bytes = std::string("a\0state", 7)}};
  return checkpoint;
}

std::vector<StoredPose> SomePoses() {
  std::vector<StoredPose> poses;
  for (uint32_t i = 0; i < 3; ++i) {
    StoredPose pose;
    pose.pose_seq = 40 + i;
    pose.object_index = pose.estimate.object_index = i % 2;
    pose.estimate.t_us = int64_t{1000} * i;
    pose.estimate.camera_from_object.translation_m << 0.1 * i, 1e-310, -0.0;
    pose.estimate.camera_from_object.rotation *= 1.0 + 1e-16 * i;
    pose.estimate.covariance.setRandom();
    pose.estimate.twist.setRandom();
    pose.estimate.state = TrackState::kDegraded;
    pose.estimate.num_events = 5;
    pose.estimate.explained_ratio = 0.3f;
    pose.estimate.residual_rms_px = 0.7f;
    pose.latency_us = 55;
    if (i > 0) pose.estimate.loss_cause = LossCause::kOutOfView;
    pose.estimate.lost_at_us = -int64_t{i};
    poses.push_back(pose);
  }
  return poses;
}

TEST(SessionCodecTest, ConfigurationRoundTrip) {
  const SessionConfig config = AFullConfig();
  const auto decoded = DecodeConfig(EncodeConfig(config));
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_TRUE(*decoded == config);
  EXPECT_EQ(EncodeConfig(*decoded), EncodeConfig(config)) << "bit for bit";
}

TEST(SessionCodecTest, LifecycleRoundTrip) {
  const SessionLifecycle lifecycle = DecodeLifecycle(EncodeLifecycle(ALifecycle())).value();
  EXPECT_EQ(lifecycle.token_digest, TokenDigest("new"));
  EXPECT_EQ(lifecycle.previous_token_digest, TokenDigest("old"));
  EXPECT_EQ(lifecycle.num_attaches, 7u);
  EXPECT_EQ(lifecycle.detached_at, ALifecycle().detached_at);
  EXPECT_EQ(lifecycle.num_renewals, 5u);
  EXPECT_EQ(lifecycle.lost_from_seq, 6u);
  SessionLifecycle attached = ALifecycle();
  attached.detached_at.reset();
  attached.previous_token_digest.clear();
  EXPECT_EQ(DecodeLifecycle(EncodeLifecycle(attached))->detached_at, std::nullopt);
  EXPECT_EQ(DecodeLifecycle(EncodeLifecycle(attached))->previous_token_digest, "");
}

TEST(SessionCodecTest, ALifecycleHoldsNoToken) {
  EXPECT_THAT(EncodeLifecycle({.token_digest = TokenDigest("0123456789abcdef")}),
              testing::Not(testing::HasSubstr("0123456789abcdef")));
}

TEST(SessionCodecTest, EveryLensComesBackToTheBit) {
  SessionConfig config = AFullConfig();
  storage::v1::SessionConfig stored;
  ASSERT_TRUE(stored.ParseFromString(EncodeConfig(config)));
  EXPECT_EQ(stored.camera().lens_model(), storage::v1::LENS_MODEL_UNSPECIFIED) << "as earlier servers wrote it";
  EXPECT_EQ(stored.camera().distortion_size(), 5);
  for (const LensModel lens_model : {LensModel::kBrown, LensModel::kRational, LensModel::kFisheye}) {
    config.camera.lens_model = lens_model;
    config.camera.distortion = {};
    for (int i = 0; i < NumCoefficients(lens_model); ++i) config.camera.distortion[i] = 1.0 / (3.0 + i);
    const auto decoded = DecodeConfig(EncodeConfig(config));
    ASSERT_TRUE(decoded.ok()) << decoded.status();
    EXPECT_EQ(decoded->camera, config.camera);
    // A server that does not know the lens finds a number of coefficients that its own does not have.
    ASSERT_TRUE(stored.ParseFromString(EncodeConfig(config)));
    stored.mutable_camera()->clear_lens_model();
    EXPECT_EQ(DecodeConfig(stored.SerializeAsString()).ok(), lens_model == LensModel::kBrown);
  }
}

TEST(SessionCodecTest, CheckpointRoundTrip) {
  const SessionCheckpoint checkpoint = DecodeCheckpoint(EncodeCheckpoint(ACheckpoint()), 2).value();
  EXPECT_EQ(EncodeCheckpoint(checkpoint), EncodeCheckpoint(ACheckpoint()));
  EXPECT_EQ(checkpoint.processed_seq, 99u);
  EXPECT_EQ(checkpoint.health.counts, ACheckpoint().health.counts);
  const InitializationReport& report = checkpoint.health.objects[0].initialization;
  EXPECT_EQ(report.status, InitializationStatus::kTooSmall);
  EXPECT_EQ(report.searches, (SearchCounts{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(report.loss_cause, LossCause::kUnconfirmed);
  EXPECT_EQ(report.lost_at_us, 77);
  EXPECT_EQ(checkpoint.health.objects[1].state, TrackState::kAmbiguous);
  EXPECT_EQ(checkpoint.health.objects[0].losses, 3u);
  EXPECT_EQ(checkpoint.health.skipped_events, 11u);
  EXPECT_EQ(checkpoint.latencies.Percentile(0.5), ACheckpoint().latencies.Percentile(0.5));
  EXPECT_EQ(checkpoint.pipeline, ACheckpoint().pipeline);
  SessionCheckpoint first = ACheckpoint();
  first.pipeline->position.first_t_us = first.pipeline->position.now_us = -1;
  EXPECT_EQ(DecodeCheckpoint(EncodeCheckpoint(first), 2)->pipeline, first.pipeline) << "no event time is known";
}

TEST(SessionCodecTest, ALargeCheckpointHasYieldPoints) {
  SessionCheckpoint large = ACheckpoint();
  large.pipeline->tracker.bytes.assign(size_t{1} << 20, 'x');
  std::string bytes;
  EXPECT_GE(CountYields([&] { bytes = EncodeCheckpoint(large); }), 16u);
  EXPECT_EQ(DecodeCheckpoint(bytes, 2)->pipeline, large.pipeline);
  storage::v1::Checkpoint stored;
  ASSERT_TRUE(stored.ParseFromString(bytes));
  EXPECT_TRUE(stored.SerializeAsString() == bytes);
}

// Rule 5 of proto/evpose/storage/README.md.
TEST(SessionCodecTest, EarlierServersReadLaterValuesAsTheNearestOnesThatTheyKnow) {
  storage::v1::Checkpoint checkpoint;
  ASSERT_TRUE(checkpoint.ParseFromString(EncodeCheckpoint(ACheckpoint())));
  EXPECT_EQ(checkpoint.health().objects(0).initialization(), storage::v1::INITIALIZATION_STATUS_TOO_FEW_LINES);
  EXPECT_EQ(checkpoint.health().objects(1).state(), storage::v1::TRACK_STATE_DEGRADED);
  EXPECT_THAT(checkpoint.position().reported_states(),
              testing::ElementsAre(storage::v1::TRACK_STATE_LOST, storage::v1::TRACK_STATE_DEGRADED));
  std::vector<StoredPose> poses = SomePoses();
  poses[0].estimate.state = TrackState::kAmbiguous;
  storage::v1::PoseSegment segment;
  ASSERT_TRUE(segment.ParseFromString(EncodePoses(poses).bytes));
  EXPECT_EQ(segment.poses(0).state(), storage::v1::TRACK_STATE_DEGRADED);
  EXPECT_EQ(segment.poses(0).later_state(), storage::v1::TRACK_STATE_AMBIGUOUS);
  EXPECT_EQ(segment.poses(1).later_state(), storage::v1::TRACK_STATE_UNSPECIFIED);
}

TEST(SessionCodecTest, AnAmbiguousPoseKeepsItsAlternatives) {
  std::vector<StoredPose> poses = SomePoses();
  PoseEstimate& estimate = poses[1].estimate;
  estimate.state = TrackState::kAmbiguous;
  estimate.alternatives.Add({poses[2].estimate.camera_from_object, -3.0});
  estimate.alternatives.Add({poses[0].estimate.camera_from_object, 0.1});
  const PoseSegment segment = EncodePoses(poses);
  const auto decoded = DecodePoses(segment, 2);
  ASSERT_TRUE(decoded.ok()) << decoded.status();
  EXPECT_EQ(EncodePoses(*decoded).bytes, segment.bytes);
  const PoseEstimate& read = (*decoded)[1].estimate;
  EXPECT_EQ(read.state, TrackState::kAmbiguous);
  ASSERT_EQ(read.alternatives.size(), 2u);
  EXPECT_EQ(read.alternatives[0].log_likelihood_ratio, 0.1);
  EXPECT_EQ(read.alternatives[1].log_likelihood_ratio, -3.0);
  EXPECT_EQ(read.alternatives[1].camera_from_object.translation_m, poses[2].estimate.camera_from_object.translation_m);

  storage::v1::PoseSegment stored;
  ASSERT_TRUE(stored.ParseFromString(segment.bytes));
  for (int i = 0; i < 4; ++i) *stored.mutable_poses(1)->add_alternatives() = stored.poses(1).alternatives(0);
  EXPECT_THAT(
      DecodePoses({segment.first_pose_seq, segment.last_pose_seq, stored.SerializeAsString()}, 2).status().message(),
      testing::HasSubstr("more alternatives"));
}

TEST(SessionCodecTest, PosesRoundTripToTheBit) {
  const PoseSegment segment = EncodePoses(SomePoses());
  EXPECT_EQ(segment.first_pose_seq, 40u);
  EXPECT_EQ(segment.last_pose_seq, 42u);
  const auto poses = DecodePoses(segment, 2);
  ASSERT_TRUE(poses.ok()) << poses.status();
  ASSERT_EQ(poses->size(), 3u);
  EXPECT_EQ(EncodePoses(*poses).bytes, segment.bytes);
  EXPECT_EQ((*poses)[2].object_index, 0u);
  EXPECT_EQ((*poses)[2].estimate.camera_from_object.translation_m.x(), 0.2);
}

struct RecordCase {
  std::string bytes;
  std::function<absl::Status(absl::string_view)> decode;
};

std::vector<RecordCase> RecordCases() {
  return {
      {EncodeConfig(AFullConfig()), [](absl::string_view bytes) { return DecodeConfig(bytes).status(); }},
      {EncodeLifecycle(ALifecycle()), [](absl::string_view bytes) { return DecodeLifecycle(bytes).status(); }},
      {EncodeCheckpoint(ACheckpoint()), [](absl::string_view bytes) { return DecodeCheckpoint(bytes, 2).status(); }},
      {EncodePoses(SomePoses()).bytes,
       [](absl::string_view bytes) {
         return DecodePoses({40, 42, std::string(bytes)}, 2).status();
       }},
  };
}

// The checksum of a record detects damage; the decoder must be safe without it.
TEST(SessionCodecTest, DamagedBytesAreReadOrRefusedWithAMessage) {
  for (const auto& [bytes, decode] : RecordCases()) {
    ASSERT_TRUE(decode(bytes).ok());
    EXPECT_EQ(decode("").code(), absl::StatusCode::kDataLoss);
    EXPECT_EQ(decode(bytes + "x").code(), absl::StatusCode::kDataLoss);
    int num_refused = 0;
    for (size_t size = 0; size < bytes.size(); ++size) {
      const absl::Status status = decode(bytes.substr(0, size));
      ASSERT_TRUE(status.ok() || absl::IsDataLoss(status)) << size;
      num_refused += !status.ok();
    }
    EXPECT_GT(num_refused, static_cast<int>(bytes.size()) / 2);
    std::string changed = bytes;
    for (size_t i = 0; i < bytes.size(); ++i) {  // any result is permitted, but no crash
      changed[i] = static_cast<char>(changed[i] ^ 0xff);
      (void)decode(changed);
      changed[i] = bytes[i];
    }
  }
}

TEST(SessionCodecTest, FieldsOfALaterVersionAreIgnored) {
  for (const auto& [bytes, decode] : RecordCases()) {
    const std::string later = bytes + std::string("\xf2\x3f\x03new", 6);  // field 1022, 3 bytes
    EXPECT_EQ(decode(later), absl::OkStatus());
  }
}

TEST(SessionCodecTest, FieldsOfALaterVersionThatAreAbsentHaveDefaults) {
  storage::v1::SessionConfig stored;
  ASSERT_TRUE(stored.ParseFromString(EncodeConfig(AFullConfig())));
  stored.mutable_sensor()->clear_latency_us();
  stored.mutable_objects(0)->clear_reference_rotation();
  const auto config = DecodeConfig(stored.SerializeAsString());
  ASSERT_TRUE(config.ok()) << config.status();
  EXPECT_EQ(config->sensor.latency_us, SensorProfile().latency_us);
  EXPECT_EQ(config->objects[0].reference_rotation, ObjectConfig().reference_rotation);
}

TEST(SessionCodecTest, AChoiceOfALaterVersionIsRefused) {
  storage::v1::SessionConfig stored;
  ASSERT_TRUE(stored.ParseFromString(EncodeConfig(AFullConfig())));
  stored.set_estimator("later");
  EXPECT_THAT(DecodeConfig(stored.SerializeAsString()).status().ToString(),
              testing::HasSubstr("an estimator that this version does not know"));
  for (const int unknown : {99, std::numeric_limits<int>::min()}) {
    ASSERT_TRUE(stored.ParseFromString(EncodeConfig(AFullConfig())));
    stored.set_encoding(static_cast<storage::v1::Encoding>(unknown));
    EXPECT_THAT(DecodeConfig(stored.SerializeAsString()).status().ToString(),
                testing::HasSubstr("a choice that this version does not know"));
  }
}

TEST(SessionCodecTest, RefusesRecordsThatContradictTheSession) {
  EXPECT_FALSE(DecodeCheckpoint(EncodeCheckpoint(ACheckpoint()), 1).ok()) << "another number of objects";
  EXPECT_FALSE(DecodePoses(EncodePoses(SomePoses()), 1).ok()) << "a pose of an object that does not exist";
  PoseSegment segment = EncodePoses(SomePoses());
  segment.last_pose_seq = 43;
  EXPECT_FALSE(DecodePoses(segment, 2).ok());
  segment = EncodePoses(SomePoses());
  segment.first_pose_seq = 39;
  EXPECT_FALSE(DecodePoses(segment, 2).ok());
  SessionConfig config = AFullConfig();
  config.camera.fx_px = 0;
  EXPECT_EQ(DecodeConfig(EncodeConfig(config)).status().code(), absl::StatusCode::kDataLoss);
}

}  // namespace
}  // namespace evpose::server
