// SPDX-License-Identifier: Apache-2.0
#include "server/sessions/types/session_config.h"

#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "core/base/status_macros.h"
#include "server/runtime/client_text.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr size_t kMaxObjects = 16;        // limits in the API: memory and time grow with the number of objects
constexpr size_t kMaxObjectIdBytes = 64;  // each line of the log contains it
// With a shorter lag all events would be dropped, because clients collect a chunk for a millisecond.
constexpr absl::Duration kMinMaxLag = absl::Milliseconds(1);
constexpr absl::Duration kMaxMaxLag = absl::Seconds(10);

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
  if (!(pose_rate_hz >= kMinPoseRateHz && pose_rate_hz <= kMaxPoseRateHz)) {
    return InvalidField("config.tracker.pose_rate_hz",
                        absl::StrCat("is ", pose_rate_hz, "; ", kMinPoseRateHz, " to ", kMaxPoseRateHz));
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
    if (!ids.insert(id).second)
      return InvalidField(field + "object_id", absl::StrCat("\"", Shortened(id), "\" is used twice"));
    if (objects[i].model.empty()) return InvalidField(field + "model", "is missing: upload a model and give its name");
  }
  return absl::OkStatus();
}

}  // namespace evpose::server
