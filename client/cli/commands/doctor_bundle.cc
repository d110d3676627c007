// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/doctor_bundle.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/pose_format.h"
#include "client/cli/common/pose_records.h"
#include "client/cli/console/progress.h"
#include "client/diagnosis/recording_slice.h"
#include "client/lib/client_access.h"
#include "client/lib/messages/core_types.h"
#include "core/base/counted.h"
#include "core/base/status_macros.h"
#include "core/geometry/trajectory.h"
#include "core/recordings/chunker.h"
#include "server/rpc/server.h"

namespace evpose::client {
namespace {

// Creates the session of a bundle on a server.
absl::StatusOr<Session> BeginBundle(const Bundle& bundle, const RecordingHeader& header, const std::string& name,
                                    const CliContext& context, Client& client) {
  EVPOSE_RETURN_IF_ERROR(CheckCameraMatches(bundle.camera, "its camera", header, "its recording"));
  SessionConfig config = {.encoding = FromCore(header.encoding), .camera = FromCore(bundle.camera)};
  config.sensor = FromCore(bundle.sensor);
  TrackedObject object;
  EVPOSE_ASSIGN_OR_RETURN(const ModelInfo model, UploadModel(context, client, absl::StrCat("the model of ", name),
                                                             {bundle.model, bundle.upload, {}}));
  object.model = model.name;
  if (!bundle.initial_pose.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(const RigidTransform pose, ParsePose(bundle.initial_pose));
    object.initial_camera_from_object = FromCore(pose);
  }
  config.objects.push_back(std::move(object));
  return client.CreateSession(config, /*request_id=*/"", /*max_wait=*/absl::ZeroDuration());
}

absl::StatusOr<std::string> TrackParts(const Bundle& bundle, const std::string& name, const CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader, OpenSlice(bundle.recording));
  server::ServerOptions options;
  options.listen_address.clear();
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<server::Server> server, server::Server::Start(options));
  const std::unique_ptr<Client> client =
      ClientAccess::OverChannel(server->InProcessChannel(), "server in this process");
  EVPOSE_ASSIGN_OR_RETURN(const Session session, BeginBundle(bundle, reader->header(), name, context, *client));
  Chunker chunker(*reader, {});
  std::string lines;
  ProgressLine progress(context);
  TrackCallbacks callbacks;
  callbacks.on_pose = [&lines](const Pose& pose) { lines += PoseLine(PoseFormat::kJsonLines, pose); };
  callbacks.on_progress = [&](const TrackProgress& value) {
    const double share = static_cast<double>(value.sent_bytes) / static_cast<double>(bundle.recording.size());
    progress.Show(share, absl::StrCat("tracking ", name, ", ", Counted(value.poses, "pose")));
  };
  TrackOptions track;
  track.retry.max_outage = absl::ZeroDuration();
  const auto next = [&]() -> absl::StatusOr<EventChunk> {
    if (context.IsInterrupted()) return absl::CancelledError("interrupted before all poses were computed");
    return FromCore(chunker.Next());
  };
  EVPOSE_RETURN_IF_ERROR(client->Track(session, next, callbacks, track).status());
  return lines;
}

std::string NumberText(const nlohmann::json& value) {
  return value.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

// Describes the difference of a field: "t_us 16000123 instead of 16000124", "twist by at most 1e-9".
std::string DescribeField(const std::string& key, const nlohmann::json& expected, const nlohmann::json& found) {
  const auto is_number = [](const nlohmann::json& each) { return each.is_number(); };
  const bool are_lists = expected.is_array() && found.is_array() && expected.size() == found.size() &&
                         std::all_of(expected.begin(), expected.end(), is_number) &&
                         std::all_of(found.begin(), found.end(), is_number);
  if (!are_lists) return absl::StrCat(key, " ", NumberText(found), " instead of ", NumberText(expected));
  double largest = 0.0;
  for (size_t i = 0; i < expected.size(); ++i) {
    largest = std::max(largest, std::abs(found[i].get<double>() - expected[i].get<double>()));
  }
  return absl::StrFormat("%s by at most %.3g", key, largest);
}

// Describes the differences between two lines.
std::string DescribeLines(const std::string& expected_line, const std::string& found_line) {
  const auto expected = nlohmann::json::parse(expected_line, nullptr, /*allow_exceptions=*/false);
  const auto found = nlohmann::json::parse(found_line, nullptr, /*allow_exceptions=*/false);
  if (!expected.is_object() || !found.is_object()) return "a line that is not a pose";
  std::vector<std::string> texts;
  for (const auto& [key, value] : expected.items()) {
    const nlohmann::json other = found.value(key, nlohmann::json());
    if (other != value) texts.push_back(DescribeField(key, value, other));
  }
  return texts.empty() ? "the same numbers in another notation" : absl::StrJoin(texts, ", ");
}

// Poses and the lines that state them.
struct PoseLines {
  std::vector<Pose> poses;
  std::vector<std::string> lines;
};

absl::StatusOr<PoseLines> PoseLinesOf(const std::string& text, const std::string& name) {
  PoseLines list;
  list.lines = absl::StrSplit(text, '\n', absl::SkipEmpty());
  const auto add = [&list](Pose pose) {
    list.poses.push_back(std::move(pose));
    return absl::OkStatus();
  };
  EVPOSE_RETURN_IF_ERROR(VisitJsonPoses(text, name, add).status());
  if (list.poses.size() == list.lines.size()) return list;
  return absl::InvalidArgumentError(absl::StrCat(name, ": has lines without a pose"));
}

}  // namespace

absl::StatusOr<std::string> TrackBundle(const Bundle& bundle, const std::string& name, const CliContext& context) {
  absl::StatusOr<std::string> poses = TrackParts(bundle, name, context);
  if (poses.ok()) return poses;
  return absl::Status(poses.status().code(), absl::StrCat(name, ": ", poses.status().message()));
}

Json PoseComparison::ToJson() const {
  return {{"identical", is_identical()},
          {"expected_poses", num_expected},
          {"poses", num_found},
          {"different_poses", num_different},
          {"first_difference", first_difference},
          {"largest_distance_m", largest_distance_m},
          {"largest_angle_rad", largest_angle_rad}};
}

absl::StatusOr<PoseComparison> ComparePoses(const std::string& expected, const std::string& found,
                                            const std::string& name) {
  EVPOSE_ASSIGN_OR_RETURN(const PoseLines expected_list, PoseLinesOf(expected, name));
  EVPOSE_ASSIGN_OR_RETURN(const PoseLines found_list, PoseLinesOf(found, "this program"));
  const auto& [expected_poses, expected_lines] = expected_list;
  const auto& [found_poses, found_lines] = found_list;
  PoseComparison comparison;
  comparison.num_expected = expected_poses.size();
  comparison.num_found = found_poses.size();
  const size_t num_common = std::min(expected_poses.size(), found_poses.size());
  for (size_t i = 0; i < num_common; ++i) {
    if (expected_lines[i] == found_lines[i]) continue;
    if (comparison.num_different++ == 0) {
      comparison.first_difference =
          absl::StrFormat("pose %d, at %.6f s: %s", i + 1, 1e-6 * static_cast<double>(expected_poses[i].t_us),
                          DescribeLines(expected_lines[i], found_lines[i]));
    }
    const Transform& a = expected_poses[i].camera_from_object;
    const Transform& b = found_poses[i].camera_from_object;
    const double angle_rad = a.Quaternion().angularDistance(b.Quaternion());
    comparison.largest_distance_m = std::max(comparison.largest_distance_m, (a.translation_m - b.translation_m).norm());
    comparison.largest_angle_rad = std::max(comparison.largest_angle_rad, angle_rad);
  }
  if (comparison.is_identical() && comparison.num_expected != comparison.num_found) {
    const bool has_more = comparison.num_found > comparison.num_expected;
    const Pose& pose = (has_more ? found_poses : expected_poses)[num_common];
    comparison.first_difference =
        absl::StrFormat("pose %d, at %.6f s: %s", num_common + 1, 1e-6 * static_cast<double>(pose.t_us),
                        has_more ? "is not in the bundle" : "is in the bundle alone");
  }
  return comparison;
}

absl::Status ReplayBundle(const std::string& path, bool is_json, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const Bundle bundle, ReadBundle(path));
  EVPOSE_ASSIGN_OR_RETURN(const std::string poses, TrackBundle(bundle, path, context));
  EVPOSE_ASSIGN_OR_RETURN(const PoseComparison comparison,
                          ComparePoses(bundle.poses, poses, absl::StrCat(path, ": poses.jsonl")));
  const BuildVersion own = ThisBuild();
  const auto name = [](const BuildVersion& build) {
    return absl::StrCat("evpose ", build.version, " (", build.commit, ")");
  };
  Json json = {{"bundle", path}, {"bundle_version", name(bundle.version)}, {"version", name(own)}};
  json.update(comparison.ToJson());
  EVPOSE_RETURN_IF_ERROR(PrintResult(context, is_json, json, [&](std::ostream& out) {
    out << path << ": " << Counted(comparison.num_expected, "pose") << ", computed by " << name(bundle.version) << "\n";
    out << name(own) << " computes " << Counted(comparison.num_found, "pose");
    if (comparison.is_identical()) {
      out << ": identical to the bit\n";
      return;
    }
    out << absl::StrFormat(", of which %d differ, by at most %.3g m and %.3g rad\n", comparison.num_different,
                           comparison.largest_distance_m, comparison.largest_angle_rad);
    out << "first difference: " << comparison.first_difference << "\n";
  }));
  if (comparison.is_identical()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(
      path, ": the poses differ from those of ", name(bundle.version),
      own.version == bundle.version.version && own.commit == bundle.version.commit
          ? ": the bundle's poses were changed, or one of the machines computes wrongly"
          : ", another version: compare with that version on this machine to tell the version from the machine"));
}

}  // namespace evpose::client
