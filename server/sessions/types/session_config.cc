// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/session_config.h"

#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "core/base/status_macros.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr size_t kMaxObjects = 16;        // limits in the API: memory and time grow with the number of objects
constexpr size_t kMaxObjectIdBytes = 64;  // each line of the log contains it
// With less, all events would be dropped: clients collect a chunk for a millisecond.
constexpr absl::Duration kMinMaxLag = absl::Milliseconds(1);
constexpr absl::Duration kMaxMaxLag = absl::Seconds(10);

bool SamePose(const std::optional<RigidTransform>& a, const std::optional<RigidTransform>& b) {
  if (a.has_value() != b.has_value()) return false;
  return !a.has_value() || (a->rotation == b->rotation && a->translation_m == b->translation_m);
}

bool SameObject(const ObjectConfig& a, const ObjectConfig& b) {
  return a.object_id == b.object_id && a.model == b.model && a.reference_rotation == b.reference_rotation &&
         SamePose(a.initial_camera_from_object, b.initial_camera_from_object);
}

bool SameCamera(const CameraModel& a, const CameraModel& b) {
  return a.width_px == b.width_px && a.height_px == b.height_px && a.fx_px == b.fx_px && a.fy_px == b.fy_px &&
         a.cx_px == b.cx_px && a.cy_px == b.cy_px && a.distortion == b.distortion;
}

absl::Status ValidateMaxLag(OverloadPolicy policy, const std::optional<absl::Duration>& max_lag) {
  constexpr char kField[] = "config.max_lag";
  if (policy == OverloadPolicy::kBlock) {
    if (!max_lag.has_value()) return absl::OkStatus();
    return InvalidField(kField, "is for overload_policy LATEST: with BLOCK nothing is dropped");
  }
  if (!max_lag.has_value()) return InvalidField(kField, "is missing");
  if (*max_lag >= kMinMaxLag && *max_lag <= kMaxMaxLag) return absl::OkStatus();
  return InvalidField(kField, absl::StrCat("is ", absl::FormatDuration(*max_lag), "; ",
                                           absl::FormatDuration(kMinMaxLag), " to ", absl::FormatDuration(kMaxMaxLag)));
}

}  // namespace

absl::Status SessionConfig::Validate() const {
  if (const absl::Status status = camera.Validate(); !status.ok()) {
    return InvalidField("config.camera", status.message());
  }
  if (const absl::Status status = sensor.Validate(); !status.ok()) {
    return InvalidField("config.tracker.sensor", status.message());
  }
  EVPOSE_RETURN_IF_ERROR(ValidateMaxLag(overload_policy, max_lag));
  if (objects.empty() || objects.size() > kMaxObjects) {
    return InvalidField("config.objects",
                        absl::StrCat("a session tracks 1 to ", kMaxObjects, " objects, not ", objects.size()));
  }
  std::set<absl::string_view> ids;
  for (size_t i = 0; i < objects.size(); ++i) {
    const std::string field = absl::StrCat("config.objects[", i, "].");
    const std::string& id = objects[i].object_id;
    if (id.empty() || id.size() > kMaxObjectIdBytes) {
      return InvalidField(field + "object_id",
                          absl::StrCat("must have 1 to ", kMaxObjectIdBytes, " bytes, has ", id.size()));
    }
    if (!ids.insert(id).second) return InvalidField(field + "object_id", absl::StrCat("\"", id, "\" is used twice"));
    if (objects[i].model.empty()) return InvalidField(field + "model", "is missing: upload a model and give its name");
  }
  return absl::OkStatus();
}

bool operator==(const SessionConfig& a, const SessionConfig& b) {
  if (a.encoding != b.encoding || a.estimator != b.estimator || !SameCamera(a.camera, b.camera)) return false;
  if (a.sensor != b.sensor || a.overload_policy != b.overload_policy || a.max_lag != b.max_lag) return false;
  if (a.objects.size() != b.objects.size()) return false;
  for (size_t i = 0; i < a.objects.size(); ++i) {
    if (!SameObject(a.objects[i], b.objects[i])) return false;
  }
  return true;
}

}  // namespace evpose::server
