// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/pose_records.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <type_traits>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "client/cli/common/pose_columns.h"
#include "client/cli/common/pose_format.h"
#include "client/lib/messages/core_types.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/geometry/trajectory.h"

namespace evpose::client {
namespace {

using Fields = std::vector<absl::string_view>;
using Index = std::optional<size_t>;

constexpr size_t kMaxPoseFileBytes = size_t{4} << 30;  // more than an hour of poses at 1 kHz with covariances
constexpr size_t kUpperNumbers = 21;                   // of the upper triangle of a covariance of 6 x 6

TrackState StateOfName(absl::string_view name) {
  for (const TrackState state : {TrackState::kInitializing, TrackState::kTracking, TrackState::kDegraded,
                                 TrackState::kLost, TrackState::kAmbiguous}) {
    if (name == std::string(TrackStateName(state))) return state;
  }
  return TrackState::kUnknown;
}

LossCause CauseOfName(absl::string_view name) {
  for (const LossCause cause : {LossCause::kContradicted, LossCause::kUncertain, LossCause::kOutOfView,
                                LossCause::kBetterPose, LossCause::kOccupied, LossCause::kUnconfirmed}) {
    if (name == std::string(LossCauseName(cause))) return cause;
  }
  return LossCause::kUnknown;
}

// Translation and quaternion x y z w.
using PoseNumbers = std::array<double, 7>;

Eigen::Quaterniond StatedQuaternion(const PoseNumbers& v) { return {v[6], v[3], v[4], v[5]}; }

absl::StatusOr<Transform> TransformOf(const PoseNumbers& v) {
  EVPOSE_ASSIGN_OR_RETURN(const RigidTransform transform, MakeRigidTransform({v[0], v[1], v[2]}, StatedQuaternion(v)));
  return FromCore(transform);
}

absl::Status SetTransform(const PoseNumbers& v, FilePose& pose) {
  EVPOSE_ASSIGN_OR_RETURN(pose.camera_from_object, TransformOf(v));
  const Eigen::Quaterniond stated = StatedQuaternion(v);
  const bool is_unit = std::abs(stated.norm() - 1.0) <= 1e-9;
  pose.quaternion = is_unit ? stated : pose.camera_from_object.Quaternion();
  return absl::OkStatus();
}

// The nearest number that a float can hold.
float ToFloat(double value) {
  constexpr double kMax = std::numeric_limits<float>::max();
  return static_cast<float>(std::clamp(value, -kMax, kMax));
}

// Sets the covariance from its upper triangle, row by row.
template <typename Number>
absl::Status SetCovariance(const Number& number, Pose& pose) {
  size_t next = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) {
      EVPOSE_ASSIGN_OR_RETURN(const double value, number(next++));
      pose.covariance(row, column) = pose.covariance(column, row) = value;
    }
  }
  return absl::OkStatus();
}

// The columns of a CSV file.
class PoseTable {
 public:
  static absl::StatusOr<PoseTable> Make(const Fields& header);
  bool has_covariances() const { return covariance_.size() == kUpperNumbers; }
  bool has_losses() const { return lost_at_ && loss_cause_; }
  absl::StatusOr<FilePose> Read(const Fields& fields) const;
  std::string TransformName(const Fields& fields) const {
    return transform_ && fields.size() == count_ ? std::string(fields[*transform_]) : kCameraFromObject;
  }

 private:
  static absl::StatusOr<double> Number(absl::string_view text) {
    double value = 0.0;
    if (absl::SimpleAtod(text, &value)) return value;
    return absl::InvalidArgumentError(absl::StrCat("\"", text, "\" is not a number"));
  }
  absl::Status ReadAlternatives(const Fields& fields, Pose& pose) const;
  absl::Status ReadLoss(const Fields& fields, Pose& pose) const;

  size_t count_ = 0;
  size_t t_us_ = 0;
  std::array<size_t, 7> pose_ = {};
  std::vector<size_t> covariance_;  // upper triangle row by row
  std::vector<size_t> twist_;       // 6, or fewer if a column is missing
  std::array<std::vector<size_t>, kAlternativesInCsv> alternatives_;
  Index object_id_, seq_, state_, explained_, lost_at_, loss_cause_, transform_;
};

Index FindColumn(const Fields& header, absl::string_view name) {
  const auto found = std::find(header.begin(), header.end(), name);
  if (found == header.end()) return std::nullopt;
  return static_cast<size_t>(found - header.begin());
}

absl::StatusOr<PoseTable> PoseTable::Make(const Fields& header) {
  const auto needed = [&](absl::string_view name) -> absl::StatusOr<size_t> {
    if (const Index found = FindColumn(header, name)) return *found;
    return absl::InvalidArgumentError(
        absl::StrCat("has no column ", name, "; evpose replay --out writes a CSV that has"));
  };
  const auto add = [&](const std::string& name, std::vector<size_t>& columns) {
    if (const Index found = FindColumn(header, name)) columns.push_back(*found);
  };
  PoseTable table;
  table.count_ = header.size();
  EVPOSE_ASSIGN_OR_RETURN(table.t_us_, needed("t_us"));
  for (size_t i = 0; i < kPoseColumns.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(table.pose_[i], needed(kPoseColumns[i]));
  }
  table.object_id_ = FindColumn(header, "object_id");
  table.seq_ = FindColumn(header, "pose_seq");
  table.state_ = FindColumn(header, "state");
  table.explained_ = FindColumn(header, "explained_ratio");
  table.lost_at_ = FindColumn(header, kLossTimeColumn);
  table.loss_cause_ = FindColumn(header, kLossCauseColumn);
  table.transform_ = FindColumn(header, kTransformKey);
  for (const char* const name : kTwistColumns) add(name, table.twist_);
  for (size_t row = 0; row < kCovarianceAxes.size(); ++row) {
    for (size_t column = row; column < kCovarianceAxes.size(); ++column) {
      add(absl::StrCat("cov_", kCovarianceAxes[row], "_", kCovarianceAxes[column]), table.covariance_);
    }
  }
  for (size_t i = 0; i < kAlternativesInCsv; ++i) {
    for (const char* const name : kPoseColumns) add(absl::StrCat("alt", i + 1, "_", name), table.alternatives_[i]);
    add(absl::StrCat("alt", i + 1, "_", kLikelihoodColumn), table.alternatives_[i]);
  }
  return table;
}

absl::Status PoseTable::ReadAlternatives(const Fields& fields, Pose& pose) const {
  constexpr size_t kNumbers = kPoseColumns.size() + 1;
  for (const std::vector<size_t>& columns : alternatives_) {
    if (columns.size() != kNumbers || fields[columns[0]].empty()) continue;
    PoseNumbers v = {};
    for (size_t i = 0; i < v.size(); ++i) {
      EVPOSE_ASSIGN_OR_RETURN(v[i], Number(fields[columns[i]]));
    }
    PoseAlternative alternative;
    EVPOSE_ASSIGN_OR_RETURN(alternative.camera_from_object, TransformOf(v));
    EVPOSE_ASSIGN_OR_RETURN(alternative.log_likelihood_ratio, Number(fields[columns.back()]));
    pose.alternatives.push_back(alternative);
  }
  return absl::OkStatus();
}

absl::Status PoseTable::ReadLoss(const Fields& fields, Pose& pose) const {
  if (!has_losses() || fields[*lost_at_].empty()) return absl::OkStatus();
  Loss loss = {.cause = CauseOfName(fields[*loss_cause_])};
  if (!absl::SimpleAtoi(fields[*lost_at_], &loss.t_us)) {
    return absl::InvalidArgumentError(
        absl::StrCat(kLossTimeColumn, ": \"", fields[*lost_at_], "\" is not a time in microseconds"));
  }
  pose.latest_loss = loss;
  return absl::OkStatus();
}

absl::StatusOr<FilePose> PoseTable::Read(const Fields& fields) const {
  if (fields.size() != count_) {
    return absl::InvalidArgumentError(absl::StrCat("has ", fields.size(), " fields and not ", count_));
  }
  FilePose pose;
  pose.state = state_ ? StateOfName(fields[*state_]) : TrackState::kTracking;
  if (object_id_) pose.object_id = std::string(fields[*object_id_]);
  if (!absl::SimpleAtoi(fields[t_us_], &pose.t_us)) {
    return absl::InvalidArgumentError(absl::StrCat("\"", fields[t_us_], "\" is not a time in microseconds"));
  }
  if (seq_ && !absl::SimpleAtoi(fields[*seq_], &pose.seq)) {
    return absl::InvalidArgumentError(absl::StrCat("\"", fields[*seq_], "\" is not the number of a pose"));
  }
  PoseNumbers v = {};
  for (size_t i = 0; i < v.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(v[i], Number(fields[pose_[i]]));
  }
  EVPOSE_RETURN_IF_ERROR(SetTransform(v, pose));
  if (explained_) {
    EVPOSE_ASSIGN_OR_RETURN(const double explained, Number(fields[*explained_]));
    pose.explained_ratio = ToFloat(explained);
  }
  for (size_t i = 0; twist_.size() == kTwistColumns.size() && i < twist_.size(); ++i) {
    EVPOSE_ASSIGN_OR_RETURN(pose.twist[static_cast<int>(i)], Number(fields[twist_[i]]));
  }
  EVPOSE_RETURN_IF_ERROR(ReadAlternatives(fields, pose));
  EVPOSE_RETURN_IF_ERROR(ReadLoss(fields, pose));
  if (!has_covariances()) return pose;
  EVPOSE_RETURN_IF_ERROR(SetCovariance([&](size_t i) { return Number(fields[covariance_[i]]); }, pose));
  return pose;
}

// The value of a number if it is an integer that Value can hold.
template <typename Value>
std::optional<Value> IntegerOf(const nlohmann::json& json) {
  if (json.is_number_unsigned()) {
    const auto integer = json.get<uint64_t>();
    return std::in_range<Value>(integer) ? std::optional<Value>(static_cast<Value>(integer)) : std::nullopt;
  }
  if (json.is_number_integer()) {
    const auto integer = json.get<int64_t>();
    return std::in_range<Value>(integer) ? std::optional<Value>(static_cast<Value>(integer)) : std::nullopt;
  }
  const double number = json.get<double>();
  // The largest Value is no double; the next number is.
  const double end = std::ldexp(1.0, std::numeric_limits<Value>::digits);
  const bool is_inside = number >= (std::is_signed_v<Value> ? -end : 0.0) && number < end;
  return is_inside && number == std::trunc(number) ? std::optional<Value>(static_cast<Value>(number)) : std::nullopt;
}

// Reads the fields of a JSON line; a field that is absent keeps its value.
class JsonFields {
 public:
  explicit JsonFields(const nlohmann::json& json) : json_(json) {}

  // `count` numbers. Error: INVALID_ARGUMENT for a field that is present and has another form.
  absl::StatusOr<std::vector<double>> Numbers(const char* name, size_t count) const {
    const auto found = json_.find(name);
    if (found == json_.end()) return std::vector<double>();
    bool is_right = found->is_array() && found->size() == count;
    for (size_t i = 0; is_right && i < count; ++i) is_right = (*found)[i].is_number();
    if (is_right) return found->get<std::vector<double>>();
    return absl::InvalidArgumentError(absl::StrCat(name, " is not a list of ", count, " numbers"));
  }
  absl::Status Number(const char* name, double& value) const {
    const auto found = json_.find(name);
    if (found == json_.end()) return absl::OkStatus();
    if (!found->is_number()) return absl::InvalidArgumentError(absl::StrCat(name, " is not a number"));
    value = found->get<double>();
    return absl::OkStatus();
  }
  // An integer, which may be written as 16e6. Error also for a number that Value cannot hold.
  template <typename Value>
  absl::Status Integer(const char* name, Value& value) const {
    const auto found = json_.find(name);
    if (found == json_.end()) return absl::OkStatus();
    if (!found->is_number()) return absl::InvalidArgumentError(absl::StrCat(name, " is not a number"));
    if (const std::optional<Value> integer = IntegerOf<Value>(*found)) {
      value = *integer;
      return absl::OkStatus();
    }
    const char* const range = std::is_signed_v<Value> ? "-2^63 to 2^63 - 1" : "0 to 2^64 - 1";
    return absl::InvalidArgumentError(
        absl::StrCat(name, " is ", found->dump(), "; it must be an integer from ", range));
  }
  absl::Status Text(const char* name, std::string& text) const {
    const auto found = json_.find(name);
    if (found == json_.end()) return absl::OkStatus();
    if (!found->is_string()) return absl::InvalidArgumentError(absl::StrCat(name, " is not a string"));
    text = found->get<std::string>();
    return absl::OkStatus();
  }
  absl::StatusOr<PoseNumbers> RigidMotion() const {
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> t, Numbers("translation_m", 3));
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> q, Numbers("quaternion_xyzw", 4));
    if (t.empty() || q.empty()) return absl::InvalidArgumentError("has no translation_m and quaternion_xyzw");
    return PoseNumbers{t[0], t[1], t[2], q[0], q[1], q[2], q[3]};
  }

 private:
  const nlohmann::json& json_;
};

absl::Status ReadJsonAlternatives(const nlohmann::json& json, Pose& pose) {
  const auto list = json.find("alternatives");
  if (list == json.end()) return absl::OkStatus();
  if (!list->is_array()) return absl::InvalidArgumentError("alternatives is not a list");
  for (const nlohmann::json& item : *list) {
    const JsonFields fields(item);
    PoseAlternative alternative;
    EVPOSE_ASSIGN_OR_RETURN(const PoseNumbers v, fields.RigidMotion());
    EVPOSE_ASSIGN_OR_RETURN(alternative.camera_from_object, TransformOf(v));
    EVPOSE_RETURN_IF_ERROR(fields.Number("log_likelihood_ratio", alternative.log_likelihood_ratio));
    pose.alternatives.push_back(alternative);
  }
  return absl::OkStatus();
}

absl::Status ReadJsonLoss(const nlohmann::json& json, Pose& pose, PoseFileFacts& facts) {
  const auto time = json.find(kLossTimeColumn);
  if (time == json.end()) return absl::OkStatus();
  facts.has_losses = true;
  if (time->is_null()) return absl::OkStatus();
  const JsonFields fields(json);
  Loss loss;
  EVPOSE_RETURN_IF_ERROR(fields.Integer(kLossTimeColumn, loss.t_us));
  std::string cause;
  EVPOSE_RETURN_IF_ERROR(fields.Text(kLossCauseColumn, cause));
  loss.cause = CauseOfName(cause);
  pose.latest_loss = loss;
  return absl::OkStatus();
}

absl::StatusOr<FilePose> ReadJsonPose(absl::string_view line, PoseFileFacts& facts) {
  const nlohmann::json json = nlohmann::json::parse(line.begin(), line.end(), nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) return absl::InvalidArgumentError("is no JSON object");
  const JsonFields fields(json);
  FilePose pose;
  if (!json.contains("t_us")) return absl::InvalidArgumentError("has no t_us");
  EVPOSE_RETURN_IF_ERROR(fields.Integer("t_us", pose.t_us));
  EVPOSE_RETURN_IF_ERROR(fields.Integer("pose_seq", pose.seq));
  EVPOSE_RETURN_IF_ERROR(fields.Text("object_id", pose.object_id));
  EVPOSE_RETURN_IF_ERROR(fields.Text(kTransformKey, facts.transform));
  EVPOSE_ASSIGN_OR_RETURN(const PoseNumbers v, fields.RigidMotion());
  EVPOSE_RETURN_IF_ERROR(SetTransform(v, pose));
  std::string state(TrackStateName(TrackState::kTracking));
  EVPOSE_RETURN_IF_ERROR(fields.Text("state", state));
  pose.state = StateOfName(state);
  double explained_ratio = 0.0;
  EVPOSE_RETURN_IF_ERROR(fields.Number("explained_ratio", explained_ratio));
  pose.explained_ratio = ToFloat(explained_ratio);
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> twist, fields.Numbers("twist", 6));
  for (size_t i = 0; i < twist.size(); ++i) pose.twist[static_cast<int>(i)] = twist[i];
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<double> upper, fields.Numbers("covariance_upper", kUpperNumbers));
  facts.has_covariances = facts.has_covariances || !upper.empty();
  if (!upper.empty()) {
    EVPOSE_RETURN_IF_ERROR(SetCovariance([&](size_t i) { return absl::StatusOr<double>(upper[i]); }, pose));
  }
  EVPOSE_RETURN_IF_ERROR(ReadJsonAlternatives(json, pose));
  EVPOSE_RETURN_IF_ERROR(ReadJsonLoss(json, pose, facts));
  return pose;
}

// Calls `visit` for each line that is not empty; its errors get the line's place.
absl::Status VisitLines(absl::string_view text, const std::string& name,
                        absl::FunctionRef<absl::Status(absl::string_view)> visit) {
  int line_number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++line_number;
    line = absl::StripSuffix(line, "\r");
    if (line.empty()) continue;
    if (const absl::Status status = visit(line); !status.ok()) {
      return absl::Status(status.code(), absl::StrCat(name, ":", line_number, ": ", status.message()));
    }
  }
  return absl::OkStatus();
}

// The transform that the first line of a TUM file states; camera_from_object for a file without such a line.
std::string TransformOfTum(absl::string_view text) {
  const absl::string_view line = text.substr(0, text.find('\n'));
  const size_t comma = line.find(',');
  if (!absl::StartsWith(line, "# ") || comma == absl::string_view::npos) return kCameraFromObject;
  const absl::string_view name = line.substr(2, comma - 2);
  const bool is_transform = absl::StrContains(name, "_from_") && !absl::StrContains(name, ' ');
  return std::string(is_transform ? name : absl::string_view(kCameraFromObject));
}

}  // namespace

absl::StatusOr<PoseFileFacts> VisitCsvPoses(absl::string_view text, const std::string& name_for_errors,
                                            PoseVisitor visit) {
  PoseFileFacts facts{kCameraFromObject};
  std::optional<PoseTable> table;
  EVPOSE_RETURN_IF_ERROR(VisitLines(text, name_for_errors, [&](absl::string_view line) -> absl::Status {
    const Fields fields = absl::StrSplit(line, ',');
    if (!table) {
      EVPOSE_ASSIGN_OR_RETURN(table, PoseTable::Make(fields));
      facts.has_covariances = table->has_covariances();
      facts.has_losses = table->has_losses();
      return absl::OkStatus();
    }
    EVPOSE_ASSIGN_OR_RETURN(FilePose pose, table->Read(fields));
    facts.transform = table->TransformName(fields);
    return visit(std::move(pose));
  }));
  return facts;
}

absl::StatusOr<PoseFileFacts> VisitJsonPoses(absl::string_view text, const std::string& name_for_errors,
                                             PoseVisitor visit) {
  PoseFileFacts facts{kCameraFromObject};
  EVPOSE_RETURN_IF_ERROR(VisitLines(text, name_for_errors, [&](absl::string_view line) -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(FilePose pose, ReadJsonPose(line, facts));
    return visit(std::move(pose));
  }));
  return facts;
}

absl::Status RefuseMcap(const std::string& path, const std::string& formats) {
  if (!absl::EndsWith(path, ".mcap")) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(path, ": poses are not read from .mcap files, but from ", formats,
                                                 ": run evpose replay again with the name of such a file as --out"));
}

absl::StatusOr<PoseFileFacts> VisitPoses(const std::string& path, PoseVisitor visit) {
  EVPOSE_RETURN_IF_ERROR(RefuseMcap(path));
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadFile(path, kMaxPoseFileBytes));
  if (absl::EndsWith(path, ".csv")) return VisitCsvPoses(text, path, visit);
  if (absl::EndsWith(path, ".jsonl")) return VisitJsonPoses(text, path, visit);
  EVPOSE_ASSIGN_OR_RETURN(const Trajectory trajectory, ParseTumTrajectory(text, path));
  for (const StampedPose& each : trajectory) {
    FilePose pose;
    pose.t_us = each.t_us;
    pose.camera_from_object = FromCore(each.camera_from_object);
    pose.quaternion = pose.camera_from_object.Quaternion();
    pose.state = TrackState::kTracking;
    if (const absl::Status status = visit(std::move(pose)); !status.ok()) {
      return absl::Status(status.code(), absl::StrCat(path, ": ", status.message()));
    }
  }
  return PoseFileFacts{TransformOfTum(text)};
}

absl::StatusOr<PoseFrame> FrameToCamera(const std::string& transform, const PoseFrame& frame, const std::string& path) {
  if (transform == kCameraFromObject) return PoseFrame();
  if (transform == kObjectFromCamera) return PoseFrame::ObjectFromCamera().ToCamera();
  if (transform == frame.transform()) return frame.ToCamera();
  const std::string given = frame.world_from_camera() ? absl::StrCat(", and not ", frame.transform()) : "";
  return absl::InvalidArgumentError(absl::StrCat(
      path, ": its poses are ", transform, given,
      "; give poses of a run without --world-from-camera, or the file of that option with which they were written"));
}

}  // namespace evpose::client
