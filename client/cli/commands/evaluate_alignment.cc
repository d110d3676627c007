// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/evaluate_alignment.h"

#include "absl/strings/str_format.h"
#include "client/cli/commands/calibrate_hand_eye.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

HandEyeMount MountOf(const std::string& truth_of) {
  if (truth_of == "object") return HandEyeMount::kBeside;
  return truth_of == "camera" ? HandEyeMount::kInHand : HandEyeMount::kAuto;
}

}  // namespace

void AlignmentArguments::AddTo(CLI::App& app) {
  app.option_defaults()->group("Comparison");
  CLI::Option* const rigid = AddOption(
      app, "--align", align,
      "rigid: the truth is in another frame. Two constant transforms are estimated, camera_from_object = A truth B, or "
      "A truth^-1 B if the truth is that of the camera",
      CLI::IsMember({"none", "rigid"}));
  AddOption(
      app, "--truth-of", truth_of,
      "Whose poses the truth contains, for --align rigid: those of the object or of the camera, in a frame at rest; "
      "auto: the choice with the smaller residuals",
      CLI::IsMember({"auto", "object", "camera"}))
      ->needs(rigid);
  app.add_option("--time-offset", time_offset,
                 "Clock of the truth minus that of the sensor; auto: estimated from the motion")
      ->type_name("auto|SECONDS")
      ->capture_default_str();
}

absl::StatusOr<std::optional<HandEye>> AlignmentArguments::Solve(const Trajectory& truth,
                                                                 const Trajectory& estimate) const {
  HandEyeOptions options;
  options.mount = MountOf(truth_of);
  options.has_same_frames = !is_rigid();
  options.min_second_axis_rad = 0.0;  // the product of the transforms is determined without a second axis
  EVPOSE_ASSIGN_OR_RETURN(options.time_offset_s, ParseTimeOffset(time_offset));
  if (options.has_same_frames && options.time_offset_s) {
    if (*options.time_offset_s == 0.0) return std::nullopt;
    return HandEye{.time_offset_s = *options.time_offset_s};
  }
  EVPOSE_ASSIGN_OR_RETURN(const HandEye alignment, SolveHandEye(estimate, truth, options));
  return alignment;
}

Json AlignmentJson(const AlignmentArguments& arguments, const std::optional<HandEye>& alignment) {
  if (!alignment) return nullptr;
  Json json = {
      {"align", arguments.align},
      {"time_offset_s", alignment->time_offset_s},
      {"time_offset_error_s", alignment->time_offset_error_s ? Json(*alignment->time_offset_error_s) : Json(nullptr)}};
  if (!arguments.is_rigid()) return json;
  json["truth_of"] = alignment->mount == HandEyeMount::kInHand ? "camera" : "object";
  json["left"] = TransformJson(alignment->left);
  json["right"] = TransformJson(alignment->right);
  json["outliers"] = alignment->num_outliers;
  json["warnings"] = alignment->warnings;
  return json;
}

void PrintAlignment(const AlignmentArguments& arguments, const std::string& name, const HandEye& alignment,
                    std::ostream& out) {
  out << absl::StrFormat("%s: clock of the truth - clock of the sensor %.6f s", name, alignment.time_offset_s);
  if (alignment.time_offset_error_s) {
    out << absl::StrFormat(" +- %.0f us, estimated: a constant latency is not in the errors",
                           1e6 * *alignment.time_offset_error_s);
  }
  out << "\n";
  if (!arguments.is_rigid()) return;
  const bool is_camera = alignment.mount == HandEyeMount::kInHand;
  out << absl::StrFormat(
      "%s: aligned with the truth of the %s by two constant transforms from %d poses, of which %d are outliers: "
      "constant errors of the pose are not in the errors above, only their changes\n",
      name, is_camera ? "camera" : "object", alignment.num_poses, alignment.num_outliers);
  for (const std::string& warning : alignment.warnings) out << name << ": " << warning << "\n";
}

}  // namespace evpose::client
