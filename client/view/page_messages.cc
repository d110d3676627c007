// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_messages.h"

#include <zlib.h>

#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/time/time.h"
#include "core/base/status_macros.h"
#include "core/base/version.h"

namespace evpose::client {
namespace {

using Json = nlohmann::ordered_json;

static_assert(std::endian::native == std::endian::little, "the sections of binary messages are little-endian");

// Integers up to here are exact as numbers of JavaScript.
constexpr int64_t kMaxExact = (int64_t{1} << 53) - 1;

std::string Dump(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

std::string LowerCase(std::string_view name) { return absl::AsciiStrToLower(std::string(name)); }

std::string StateName(TrackState state) { return LowerCase(TrackStateName(state)); }

Json Position(const Transform& transform) {
  const Eigen::Vector3d& t = transform.translation_m;
  return {t.x(), t.y(), t.z()};
}

Json Rotation(const Eigen::Quaterniond& q) { return {q.w(), q.x(), q.y(), q.z()}; }

Json PoseJson(const Pose& pose, const Eigen::Quaterniond& rotation) {
  Json json = {{"t_us", pose.t_us},
               {"seq", pose.seq},
               {"state", StateName(pose.state)},
               {"p", Position(pose.camera_from_object)},
               {"q", Rotation(rotation)}};
  if (pose.covariance.diagonal().maxCoeff() > 0.0) {
    Json& sigma = json["sigma"] = Json::array();
    for (int i = 0; i < 6; ++i) sigma.push_back(std::sqrt(std::max(0.0, pose.covariance(i, i))));
    Json& upper = json["cov3"] = Json::array();
    for (int row = 0; row < 3; ++row) {
      for (int column = row; column < 3; ++column) upper.push_back(pose.covariance(row, column));
    }
  }
  json["v"] = {pose.twist[0], pose.twist[1], pose.twist[2]};
  json["w"] = {pose.twist[3], pose.twist[4], pose.twist[5]};
  json["explained"] = pose.explained_ratio;
  Json& alternatives = json["alternatives"] = Json::array();
  for (const PoseAlternative& each : pose.alternatives) {
    alternatives.push_back({{"p", Position(each.camera_from_object)},
                            {"q", Rotation(each.camera_from_object.Quaternion())},
                            {"llr", each.log_likelihood_ratio}});
  }
  return json;
}

Json Milliseconds(const std::optional<absl::Duration>& duration) {
  return duration ? Json(absl::ToDoubleMilliseconds(*duration)) : Json(nullptr);
}

// Reads the fields of a request.
class Fields {
 public:
  explicit Fields(const Json& json) : json_(json) {}

  absl::StatusOr<std::string> Text(const char* name, size_t max_bytes) const {
    const auto found = json_.find(name);
    if (found == json_.end() || !found->is_string()) return Wrong(name, "is no text");
    std::string text = found->get<std::string>();
    if (text.size() > max_bytes) return Wrong(name, absl::StrCat("is longer than ", max_bytes, " bytes"));
    return text;
  }
  absl::StatusOr<double> Number(const char* name, double low, double high) const {
    const auto found = json_.find(name);
    if (found == json_.end() || !found->is_number()) return Wrong(name, "is no number");
    const double number = found->get<double>();
    if (!(number >= low && number <= high)) return Wrong(name, absl::StrCat("is not in [", low, ", ", high, "]"));
    return number;
  }
  absl::StatusOr<int64_t> Integer(const char* name, int64_t low, int64_t high) const {
    EVPOSE_ASSIGN_OR_RETURN(const double number, Number(name, static_cast<double>(low), static_cast<double>(high)));
    if (number != std::floor(number)) return Wrong(name, "is no integer");
    return static_cast<int64_t>(number);
  }
  static absl::Status Wrong(const char* name, const std::string& what) {
    return absl::InvalidArgumentError(absl::StrCat(name, " ", what));
  }

 private:
  const Json& json_;
};

constexpr size_t kMaxNameBytes = 256;  // names of sessions and models are shorter

absl::StatusOr<PageRequest> ParseSettings(const Fields& fields) {
  ImageSettings settings;
  EVPOSE_ASSIGN_OR_RETURN(settings.window_ms, fields.Number("window_ms", 0.1, 1000.0));
  EVPOSE_ASSIGN_OR_RETURN(settings.rate_hz, fields.Number("rate_hz", 1.0, 60.0));
  EVPOSE_ASSIGN_OR_RETURN(const int64_t cell_px, fields.Integer("cell_px", 1, 4));
  if (cell_px == 3) return Fields::Wrong("cell_px", "is not 1, 2 or 4");
  settings.cell_px = static_cast<int>(cell_px);
  return settings;
}

absl::StatusOr<PageRequest> ParseStep(const Fields& fields) {
  constexpr int kMaxSteps = 10'000;  // poses in one request; the page requests ten at most
  EVPOSE_ASSIGN_OR_RETURN(const int64_t count, fields.Integer("count", -kMaxSteps, kMaxSteps));
  if (count == 0) return Fields::Wrong("count", "is 0");
  return StepRequest{static_cast<int>(count)};
}

// Appends a section, padded to a multiple of 4 bytes.
void AppendSection(const void* bytes, size_t size, std::string& out) {
  out.append(static_cast<const char*>(bytes), size);
  out.append((4 - size % 4) % 4, '\0');
}

// Begins a binary message: the length of the header and the header.
std::string BeginBinary(const Json& header) {
  const std::string text = Dump(header);
  const auto length = static_cast<uint32_t>(text.size());
  std::string out;
  AppendSection(&length, sizeof(length), out);
  AppendSection(text.data(), text.size(), out);
  return out;
}

// Returns the cells in the format zlib; empty if that would not make them smaller.
std::vector<uint8_t> Compressed(const std::vector<uint8_t>& cells) {
  std::vector<uint8_t> compressed(cells.size());
  uLongf size = compressed.size();
  if (cells.empty() || compress2(compressed.data(), &size, cells.data(), cells.size(), Z_BEST_SPEED) != Z_OK) return {};
  compressed.resize(size);
  return compressed;
}

// The ends of the segments, and their kinds.
struct OutlineSections {
  std::vector<std::array<float, 4>> ends_px;
  std::vector<uint8_t> kinds;
};

Json FrameJson(const PoseFrame& frame) {
  Json json = {{"name", frame.name()},
               {"transform", frame.transform()},
               {"pose_of", frame.is_of_camera() ? "camera" : "object"},
               {"camera", nullptr}};
  const auto world = frame.world_from_camera();
  if (world) json["camera"] = {{"p", Position(world->second)}, {"q", Rotation(world->second.Quaternion())}};
  return json;
}

OutlineSections SectionsOf(const ObjectOutline& outline) {
  OutlineSections sections;
  for (const ObjectOutline::Segment& each : outline.segments) {
    if (each.kind == EdgeKind::kUnknown) continue;
    sections.ends_px.push_back({each.p1_px.x(), each.p1_px.y(), each.p2_px.x(), each.p2_px.y()});
    sections.kinds.push_back(static_cast<uint8_t>(each.kind));
  }
  return sections;
}

Json OutlineJson(const ObjectOutline& outline, size_t num_segments, bool is_truth) {
  return {{"object", outline.object_id},
          {"state", StateName(outline.state)},
          {"t_us", outline.t_us},
          {"segments", num_segments},
          {"truth", is_truth}};
}

}  // namespace

absl::StatusOr<PageRequest> ParsePageRequest(std::string_view text) {
  const Json json = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) return absl::InvalidArgumentError("the message is no JSON object");
  const Fields fields(json);
  EVPOSE_ASSIGN_OR_RETURN(const std::string type, fields.Text("type", kMaxNameBytes));
  if (type == "key") {
    EVPOSE_ASSIGN_OR_RETURN(std::string key, fields.Text("key", kMaxNameBytes));
    return KeyRequest{std::move(key)};
  }
  if (type == "list") return ListRequest{};
  if (type == "open") {
    EVPOSE_ASSIGN_OR_RETURN(std::string session, fields.Text("session", kMaxNameBytes));
    return OpenRequest{std::move(session)};
  }
  if (type == "settings") return ParseSettings(fields);
  if (type == "ack") {
    EVPOSE_ASSIGN_OR_RETURN(const int64_t number, fields.Integer("number", 0, kMaxExact));
    return AckRequest{static_cast<uint64_t>(number)};
  }
  if (type == "seek") {
    EVPOSE_ASSIGN_OR_RETURN(const int64_t t_us, fields.Integer("t_us", -kMaxExact, kMaxExact));
    return SeekRequest{t_us};
  }
  if (type == "play") {
    EVPOSE_ASSIGN_OR_RETURN(const double speed, fields.Number("speed", 0.001, 10.0));
    return PlayRequest{speed};
  }
  if (type == "pause") return PauseRequest{};
  if (type == "step") return ParseStep(fields);
  return absl::InvalidArgumentError("type is unknown (client/view/README.md, section 3)");
}

std::string ToText(const HelloMessage& hello) {
  const char* const mode = hello.is_recording ? "recording" : "live";
  return Dump({{"type", "hello"},
               {"mode", mode},
               {"title", absl::StrCat("evpose: ", hello.session.empty() ? hello.source : hello.session)},
               {"version", VersionLine("evpose")},
               {"source", hello.source},
               {"session", hello.session}});
}

std::string ToText(const PageScene& scene) {
  Json json = {{"type", "scene"},
               {"session", scene.session},
               {"frame", FrameJson(scene.frame)},
               {"camera",
                {{"width", scene.camera.width_px},
                 {"height", scene.camera.height_px},
                 {"fx_px", scene.camera.fx_px},
                 {"fy_px", scene.camera.fy_px},
                 {"cx_px", scene.camera.cx_px},
                 {"cy_px", scene.camera.cy_px}}},
               {"objects", Json::array()},
               {"recording", nullptr},
               {"has_truth", scene.has_truth}};
  for (const SceneObject& object : scene.objects) {
    json["objects"].push_back({{"id", object.id}, {"model", object.model}, {"diameter_m", object.diameter_m}});
  }
  if (scene.recording) json["recording"] = {{"from_us", scene.recording->from_us}, {"to_us", scene.recording->to_us}};
  return Dump(json);
}

std::string SessionsText(const std::vector<Session>& sessions) {
  Json list = Json::array();
  for (const Session& session : sessions) {
    Json objects = Json::array();
    for (const TrackedObject& object : session.config.objects) objects.push_back(object.object_id);
    list.push_back({{"name", session.name},
                    {"state", LowerCase(SessionStateName(session.state))},
                    {"objects", std::move(objects)},
                    {"create_time", absl::FormatTime(absl::RFC3339_sec, session.create_time, absl::UTCTimeZone())}});
  }
  return Dump({{"type", "sessions"}, {"sessions", std::move(list)}});
}

std::string PosesText(const std::string& object_id, absl::Span<const Pose> poses, bool is_truth,
                      absl::Span<const Eigen::Quaterniond> rotations) {
  Json list = Json::array();
  for (size_t i = 0; i < poses.size(); ++i) {
    list.push_back(PoseJson(poses[i], rotations.empty() ? poses[i].camera_from_object.Quaternion() : rotations[i]));
  }
  Json json = {{"type", "poses"}, {"object", object_id}, {"poses", std::move(list)}};
  if (is_truth) json["truth"] = true;
  return Dump(json);
}

std::string StateText(const std::string& object_id, int64_t t_us, TrackState state, const std::string& reason) {
  return Dump(
      {{"type", "state"}, {"object", object_id}, {"t_us", t_us}, {"state", StateName(state)}, {"reason", reason}});
}

std::string CauseText(LossCause cause) { return absl::StrReplaceAll(LowerCase(LossCauseName(cause)), {{"_", " "}}); }

std::string HealthText(const SessionHealth& health, const LinkCounts& link) {
  Json objects = Json::array();
  for (const ObjectHealth& object : health.objects) {
    objects.push_back({{"id", object.object_id},
                       {"state", StateName(object.state)},
                       {"detail", object.detail},
                       {"explained", object.explained_ratio},
                       {"losses", object.losses}});
  }
  return Dump({{"type", "health"},
               {"t_us", health.t_us},
               {"event_rate_hz", health.event_rate_hz},
               {"pose_rate_hz", health.pose_rate_hz},
               {"real_time_ratio", health.real_time_ratio},
               {"latency_ms", {{"p50", Milliseconds(health.latency_p50)}, {"p99", Milliseconds(health.latency_p99)}}},
               {"dropped", health.dropped_events},
               {"skipped", health.skipped_events},
               {"decode_faults", health.invalid_words},
               {"link",
                {{"images_sent", link.images_sent},
                 {"images_skipped", link.images_skipped},
                 {"unacknowledged", link.unacknowledged}}},
               {"objects", std::move(objects)}});
}

std::string PositionText(int64_t t_us, bool is_playing, double speed) {
  return Dump({{"type", "position"}, {"t_us", t_us}, {"playing", is_playing}, {"speed", speed}});
}

std::string RangeText(const TimeSpan& range, bool is_complete, const EventCounts& counts) {
  return Dump(
      {{"type", "range"},
       {"from_us", range.from_us},
       {"to_us", range.to_us},
       {"complete", is_complete},
       {"events", {{"from_us", counts.from_us()}, {"step_us", counts.step_us()}, {"counts", counts.counts()}}}});
}

std::string NoticeText(NoticeLevel level, const std::string& text) {
  return Dump({{"type", "notice"}, {"level", level == NoticeLevel::kError ? "error" : "info"}, {"text", text}});
}

std::string EndText(const std::string& reason) { return Dump({{"type", "end"}, {"reason", reason}}); }

std::string ToBinary(const PageImage& page_image, uint64_t number, uint64_t skipped) {
  const EventImage& image = page_image.image;
  const std::vector<uint8_t> compressed = Compressed(image.cells);
  const std::vector<uint8_t>& cells = compressed.empty() ? image.cells : compressed;
  Json outlines = Json::array();
  Json sizes = {cells.size()};
  std::vector<OutlineSections> sections;
  for (size_t i = 0; i < image.outlines.size(); ++i) {
    sections.push_back(SectionsOf(image.outlines[i]));
    const size_t num_segments = sections.back().kinds.size();
    outlines.push_back(
        OutlineJson(image.outlines[i], num_segments, i + page_image.num_truths >= image.outlines.size()));
    sizes.push_back(num_segments * sizeof(std::array<float, 4>));
    sizes.push_back(num_segments);
  }
  std::string out = BeginBinary({{"type", "image"},
                                 {"number", number},
                                 {"t_us", page_image.t_us},
                                 {"from_us", image.from_t_us},
                                 {"to_us", image.to_t_us},
                                 {"cell_px", image.cell_px},
                                 {"width", image.width},
                                 {"height", image.height},
                                 {"events", image.num_events},
                                 {"skipped", skipped},
                                 {"encoding", compressed.empty() ? "packed" : "zlib"},
                                 {"outlines", std::move(outlines)},
                                 {"sections", std::move(sizes)}});
  AppendSection(cells.data(), cells.size(), out);
  for (const OutlineSections& each : sections) {
    AppendSection(each.ends_px.data(), each.ends_px.size() * sizeof(each.ends_px[0]), out);
    AppendSection(each.kinds.data(), each.kinds.size(), out);
  }
  return out;
}

std::string ToBinary(const SceneObject& object, const ModelGeometry& geometry) {
  const size_t vertices = geometry.vertices_m.size() * sizeof(geometry.vertices_m[0]);
  const size_t faces = geometry.faces.size() * sizeof(geometry.faces[0]);
  const size_t edges = geometry.edges_m.size() * sizeof(geometry.edges_m[0]);
  std::string out = BeginBinary({{"type", "geometry"},
                                 {"object", object.id},
                                 {"diameter_m", object.diameter_m},
                                 {"sections", {vertices, faces, edges}}});
  AppendSection(geometry.vertices_m.data(), vertices, out);
  AppendSection(geometry.faces.data(), faces, out);
  AppendSection(geometry.edges_m.data(), edges, out);
  return out;
}

}  // namespace evpose::client
