// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/enum_number.h"

#include <gtest/gtest.h>

#include "core/events/decoder.h"
#include "core/geometry/lens_models.h"
#include "core/models/object_model.h"
#include "core/tracking/object/pose_estimate.h"
#include "evpose/storage/v1/session.pb.h"
#include "evpose/storage/v1/store.pb.h"
#include "evpose/v1/admin_service.pb.h"
#include "evpose/v1/geometry.pb.h"
#include "evpose/v1/model_service.pb.h"
#include "evpose/v1/session.pb.h"
#include "evpose/v1/track.pb.h"
#include "server/sessions/types/overload.h"
#include "server/sessions/types/session_config.h"
#include "server/sessions/types/session_state.h"
#include "server/stores/common/store.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

struct Numbers {
  int number;  // EnumNumber()
  int api;
  int stored;
};

TEST(EnumNumberTest, TheApiAndTheStoreHaveTheSameNumbers) {
  namespace pb = storage::v1;
  const Numbers values[] = {
      {EnumNumber(Encoding::kEvt3), v1::EVENT_ENCODING_EVT3, pb::ENCODING_EVT3},
      {EnumNumber(Encoding::kEvt21), v1::EVENT_ENCODING_EVT21, pb::ENCODING_EVT21},
      {EnumNumber(Encoding::kEvt2), v1::EVENT_ENCODING_EVT2, pb::ENCODING_EVT2},
      {EnumNumber(Encoding::kDat), v1::EVENT_ENCODING_DAT, pb::ENCODING_DAT},
      {EnumNumber(Encoding::kFlat64), v1::EVENT_ENCODING_FLAT64, pb::ENCODING_FLAT64},
      {EnumNumber(LensModel::kBrown), v1::LENS_MODEL_BROWN, pb::LENS_MODEL_BROWN},
      {EnumNumber(LensModel::kRational), v1::LENS_MODEL_RATIONAL, pb::LENS_MODEL_RATIONAL},
      {EnumNumber(LensModel::kFisheye), v1::LENS_MODEL_FISHEYE, pb::LENS_MODEL_FISHEYE},
      {EnumNumber(OverloadPolicy::kBlock), v1::OVERLOAD_POLICY_BLOCK, pb::OVERLOAD_POLICY_BLOCK},
      {EnumNumber(OverloadPolicy::kLatest), v1::OVERLOAD_POLICY_LATEST, pb::OVERLOAD_POLICY_LATEST},
      {EnumNumber(TrackState::kInitializing), v1::TRACK_STATE_INITIALIZING, pb::TRACK_STATE_INITIALIZING},
      {EnumNumber(TrackState::kTracking), v1::TRACK_STATE_TRACKING, pb::TRACK_STATE_TRACKING},
      {EnumNumber(TrackState::kDegraded), v1::TRACK_STATE_DEGRADED, pb::TRACK_STATE_DEGRADED},
      {EnumNumber(TrackState::kLost), v1::TRACK_STATE_LOST, pb::TRACK_STATE_LOST},
      {EnumNumber(TrackState::kAmbiguous), v1::TRACK_STATE_AMBIGUOUS, pb::TRACK_STATE_AMBIGUOUS},
      {EnumNumber(InitializationStatus::kNotNeeded), v1::INITIALIZATION_STATUS_NOT_NEEDED,
       pb::INITIALIZATION_STATUS_NOT_NEEDED},
      {EnumNumber(InitializationStatus::kWaitingForEvents), v1::INITIALIZATION_STATUS_WAITING_FOR_EVENTS,
       pb::INITIALIZATION_STATUS_WAITING_FOR_EVENTS},
      {EnumNumber(InitializationStatus::kTooFewLines), v1::INITIALIZATION_STATUS_TOO_FEW_LINES,
       pb::INITIALIZATION_STATUS_TOO_FEW_LINES},
      {EnumNumber(InitializationStatus::kNoPoseFits), v1::INITIALIZATION_STATUS_NO_POSE_FITS,
       pb::INITIALIZATION_STATUS_NO_POSE_FITS},
      {EnumNumber(InitializationStatus::kVerifying), v1::INITIALIZATION_STATUS_VERIFYING,
       pb::INITIALIZATION_STATUS_VERIFYING},
      {EnumNumber(InitializationStatus::kAmbiguous), v1::INITIALIZATION_STATUS_AMBIGUOUS,
       pb::INITIALIZATION_STATUS_AMBIGUOUS},
      {EnumNumber(InitializationStatus::kNotSearchable), v1::INITIALIZATION_STATUS_NOT_SEARCHABLE,
       pb::INITIALIZATION_STATUS_NOT_SEARCHABLE},
      {EnumNumber(InitializationStatus::kNotEnoughMotion), v1::INITIALIZATION_STATUS_NOT_ENOUGH_MOTION,
       pb::INITIALIZATION_STATUS_NOT_ENOUGH_MOTION},
      {EnumNumber(InitializationStatus::kTooSmall), v1::INITIALIZATION_STATUS_TOO_SMALL,
       pb::INITIALIZATION_STATUS_TOO_SMALL},
      {EnumNumber(InitializationStatus::kNotSupported), v1::INITIALIZATION_STATUS_NOT_SUPPORTED,
       pb::INITIALIZATION_STATUS_NOT_SUPPORTED},
      {static_cast<int>(LossCause::kContradicted), v1::LOSS_CAUSE_CONTRADICTED, pb::LOSS_CAUSE_CONTRADICTED},
      {static_cast<int>(LossCause::kUncertain), v1::LOSS_CAUSE_UNCERTAIN, pb::LOSS_CAUSE_UNCERTAIN},
      {static_cast<int>(LossCause::kOutOfView), v1::LOSS_CAUSE_OUT_OF_VIEW, pb::LOSS_CAUSE_OUT_OF_VIEW},
      {static_cast<int>(LossCause::kBetterPose), v1::LOSS_CAUSE_BETTER_POSE, pb::LOSS_CAUSE_BETTER_POSE},
      {static_cast<int>(LossCause::kOccupied), v1::LOSS_CAUSE_OCCUPIED, pb::LOSS_CAUSE_OCCUPIED},
      {static_cast<int>(LossCause::kUnconfirmed), v1::LOSS_CAUSE_UNCONFIRMED, pb::LOSS_CAUSE_UNCONFIRMED},
      {EnumNumber(ModelFormat::kObj), v1::MODEL_FORMAT_OBJ, pb::MODEL_FORMAT_OBJ},
      {EnumNumber(ModelFormat::kPly), v1::MODEL_FORMAT_PLY, pb::MODEL_FORMAT_PLY},
      {EnumNumber(ModelFormat::kStl), v1::MODEL_FORMAT_STL, pb::MODEL_FORMAT_STL},
      {EnumNumber(ModelFormat::kMesh), v1::MODEL_FORMAT_MESH, pb::MODEL_FORMAT_MESH},
  };
  for (const auto& [number, api, stored] : values) {
    EXPECT_EQ(number, api);
    EXPECT_EQ(number, stored);
  }
}

TEST(EnumNumberTest, TheApiHasTheSameNumbers) {
  EXPECT_EQ(EnumNumber(DropReason::kLag), v1::DROP_REASON_LAG);
  EXPECT_EQ(EnumNumber(DropReason::kMemory), v1::DROP_REASON_MEMORY);
  EXPECT_EQ(EnumNumber(DropReason::kReader), v1::DROP_REASON_READER);
  EXPECT_EQ(EnumNumber(SessionState::kDetached), v1::SESSION_STATE_DETACHED);
  EXPECT_EQ(EnumNumber(SessionState::kAttached), v1::SESSION_STATE_ATTACHED);
  EXPECT_EQ(EnumNumber(SessionState::kEnded), v1::SESSION_STATE_ENDED);
  EXPECT_EQ(EnumNumber(StoreKind::kMemory), v1::STORE_KIND_MEMORY);
  EXPECT_EQ(EnumNumber(StoreKind::kSqlite), v1::STORE_KIND_SQLITE);
  EXPECT_EQ(EnumNumber(StoreKind::kRedis), v1::STORE_KIND_REDIS);
  EXPECT_EQ(EnumNumber(StoreKind::kPostgresql), v1::STORE_KIND_POSTGRESQL);
  EXPECT_EQ(EnumNumber(LogLevel::kDebug), v1::LOG_LEVEL_DEBUG);
  EXPECT_EQ(EnumNumber(LogLevel::kInfo), v1::LOG_LEVEL_INFO);
  EXPECT_EQ(EnumNumber(LogLevel::kWarning), v1::LOG_LEVEL_WARNING);
  EXPECT_EQ(EnumNumber(LogLevel::kError), v1::LOG_LEVEL_ERROR);
  EXPECT_EQ(EnumNumber(LogLevel::kOff), v1::LOG_LEVEL_OFF);
}

TEST(EnumNumberTest, TheValueIsTheReverseOfTheNumber) {
  EXPECT_EQ(EnumValue<TrackState>(EnumNumber(TrackState::kDegraded)), TrackState::kDegraded);
}

}  // namespace
}  // namespace evpose::server
