// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/bundle.h"

#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/types/span.h"
#include "client/diagnosis/tar_file.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

// The number of the format in bundle.json. It is raised when earlier programs cannot read the archive any more.
constexpr int kBundleFormat = 1;
constexpr size_t kMaxBundleBytes = size_t{256} << 20;  // bounds memory: an archive is read as a whole
constexpr char kFolder[] = "evpose-bundle/";
constexpr char kFacts[] = "bundle.json";
constexpr char kRecording[] = "recording.raw";
constexpr char kCamera[] = "camera.yaml";
constexpr char kSensor[] = "sensor.yaml";
constexpr char kPoses[] = "poses.jsonl";
constexpr char kReport[] = "report.json";
constexpr char kReadme[] = "README";
constexpr char kSums[] = "SHA256SUMS";
constexpr char kReadmeText[] =
    "A bundle of evpose doctor. evpose doctor --replay ARCHIVE computes the poses again from the archive and compares\n"
    "them with poses.jsonl; sha256sum -c SHA256SUMS checks the files. recording.raw is the part of the recording,\n"
    "bundle.json has the version of the program and the options, report.json what evpose doctor found.\n";

constexpr std::array<std::pair<ModelFormat, const char*>, 4> kModelNames = {{{ModelFormat::kObj, "model.obj"},
                                                                             {ModelFormat::kPly, "model.ply"},
                                                                             {ModelFormat::kStl, "model.stl"},
                                                                             {ModelFormat::kMesh, "model.mesh"}}};
constexpr char kSmoothSurface[] = "smooth";
constexpr char kSurfaceAsIs[] = "as-is";

using Files = std::map<std::string, std::string>;  // contents by name, without the folder

std::string Digest(std::string_view bytes) { return Sha256Hex(AsBytes(bytes)); }

// Returns the text of SHA256SUMS, in the format that `sha256sum -c` checks.
std::string SumsOf(const Files& files) {
  std::string sums;
  for (const auto& [name, contents] : files) {
    if (name != kSums) absl::StrAppend(&sums, Digest(contents), "  ", name, "\n");
  }
  return sums;
}

std::string FactsOf(const Bundle& bundle, const std::string& model_name) {
  const nlohmann::ordered_json facts = {
      {"format", kBundleFormat},
      {"version", bundle.version.version},
      {"commit", bundle.version.commit},
      {"model",
       {{"file", model_name},
        {"metres_per_unit", bundle.upload.metres_per_unit},
        {"crease_angle_deg", bundle.upload.crease_angle_deg},
        {"surface", bundle.upload.surface == ModelSurface::kSmooth ? kSmoothSurface : kSurfaceAsIs}}},
      {"initial_pose", bundle.initial_pose}};
  return facts.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

absl::StatusOr<std::string> Take(Files& files, const std::string& name) {
  const auto found = files.find(name);
  if (found == files.end()) return absl::InvalidArgumentError(absl::StrCat("has no ", kFolder, name));
  return std::move(found->second);
}

absl::StatusOr<Files> WithoutFolder(Files&& archive) {
  Files files;
  for (auto& [name, contents] : archive) {
    if (!name.starts_with(kFolder)) {
      return absl::InvalidArgumentError(absl::StrCat("has ", name, " beside ", kFolder, ": it is not a bundle"));
    }
    files.emplace(name.substr(sizeof(kFolder) - 1), std::move(contents));
  }
  return files;
}

absl::Status CheckSums(const Files& files) {
  const auto sums = files.find(kSums);
  if (sums == files.end()) return absl::InvalidArgumentError(absl::StrCat("has no ", kFolder, kSums));
  std::map<std::string, std::string> expected;
  for (const absl::string_view line : absl::StrSplit(sums->second, '\n', absl::SkipEmpty())) {
    const std::pair<std::string, std::string> sum_and_name = absl::StrSplit(line, absl::MaxSplits("  ", 1));
    expected[sum_and_name.second] = sum_and_name.first;
  }
  for (const auto& [name, contents] : files) {
    if (name == kSums || expected[name] == Digest(contents)) continue;
    return absl::DataLossError(absl::StrCat(name,
                                            " differs from its SHA-256: the bundle was changed or damaged; copy "
                                            "it again, or make a new one"));
  }
  return absl::OkStatus();
}

absl::Status WrongFact(const std::string& name) {
  return absl::InvalidArgumentError(absl::StrCat(kFacts, ": ", name, " is missing or wrong"));
}

// Returns a text field, which must consist of printable characters because it is shown to a person.
absl::StatusOr<std::string> TextFact(const nlohmann::json& json, const std::string& name) {
  const auto found = json.find(name);
  if (found == json.end() || !found->is_string()) return WrongFact(name);
  auto text = found->get<std::string>();
  for (const char c : text) {
    if (c < ' ' || c > '~') return WrongFact(name);
  }
  return text;
}

absl::StatusOr<double> NumberFact(const nlohmann::json& json, const std::string& name) {
  const auto found = json.find(name);
  if (found == json.end() || !found->is_number()) return WrongFact(name);
  return found->get<double>();
}

absl::Status ReadModelFacts(const nlohmann::json& model, Files& files, Bundle& bundle) {
  if (!model.is_object()) return WrongFact("model");
  EVPOSE_ASSIGN_OR_RETURN(const std::string file, TextFact(model, "file"));
  const auto* known = kModelNames.begin();
  while (known != kModelNames.end() && file != known->second) ++known;
  if (known == kModelNames.end()) return WrongFact("model.file");
  bundle.upload.format = known->first;
  EVPOSE_ASSIGN_OR_RETURN(bundle.model, Take(files, file));
  EVPOSE_ASSIGN_OR_RETURN(bundle.upload.metres_per_unit, NumberFact(model, "metres_per_unit"));
  EVPOSE_ASSIGN_OR_RETURN(bundle.upload.crease_angle_deg, NumberFact(model, "crease_angle_deg"));
  EVPOSE_ASSIGN_OR_RETURN(const std::string surface, TextFact(model, "surface"));
  if (surface != kSmoothSurface && surface != kSurfaceAsIs) return WrongFact("model.surface");
  bundle.upload.surface = surface == kSmoothSurface ? ModelSurface::kSmooth : ModelSurface::kAsIs;
  return absl::OkStatus();
}

absl::StatusOr<Bundle> BundleOf(Files files) {
  EVPOSE_ASSIGN_OR_RETURN(files, WithoutFolder(std::move(files)));
  EVPOSE_RETURN_IF_ERROR(CheckSums(files));
  Bundle bundle;
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, Take(files, kFacts));
  const auto facts = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!facts.is_object()) return absl::InvalidArgumentError(absl::StrCat(kFacts, " is no JSON object"));
  EVPOSE_ASSIGN_OR_RETURN(const double format, NumberFact(facts, "format"));
  if (format != kBundleFormat) {
    return absl::InvalidArgumentError(absl::StrCat("is of format ", format, "; this program reads format ",
                                                   kBundleFormat, ": install the version that made it"));
  }
  EVPOSE_ASSIGN_OR_RETURN(bundle.version.version, TextFact(facts, "version"));
  EVPOSE_ASSIGN_OR_RETURN(bundle.version.commit, TextFact(facts, "commit"));
  EVPOSE_ASSIGN_OR_RETURN(bundle.initial_pose, TextFact(facts, "initial_pose"));
  EVPOSE_RETURN_IF_ERROR(ReadModelFacts(facts.value("model", nlohmann::json()), files, bundle));
  EVPOSE_ASSIGN_OR_RETURN(bundle.recording, Take(files, kRecording));
  EVPOSE_ASSIGN_OR_RETURN(const std::string camera, Take(files, kCamera));
  EVPOSE_ASSIGN_OR_RETURN(bundle.camera, ParseCameraModel(camera, kCamera));
  EVPOSE_ASSIGN_OR_RETURN(const std::string sensor, Take(files, kSensor));
  EVPOSE_ASSIGN_OR_RETURN(bundle.sensor, ParseSensorProfile(sensor, kSensor));
  EVPOSE_ASSIGN_OR_RETURN(bundle.poses, Take(files, kPoses));
  EVPOSE_ASSIGN_OR_RETURN(bundle.report, Take(files, kReport));
  return bundle;
}

}  // namespace

// A larger archive could not be read again.
absl::Status CheckSize(const std::string& path, const Files& files) {
  constexpr size_t kHeaderBytes = 1024;  // of a file, with its padding
  size_t bytes = 4 * kHeaderBytes;       // the sums and the end of the archive
  for (const auto& [name, contents] : files) bytes += kHeaderBytes + contents.size();
  if (bytes <= kMaxBundleBytes) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("%s: the bundle would have %d MiB, and at most %d MiB can be read again: give a shorter "
                      "--duration, or a simpler model",
                      path, bytes >> 20, kMaxBundleBytes >> 20));
}

absl::Status WriteBundle(const std::string& path, const Bundle& bundle) {
  std::string model_name;
  for (const auto& [format, name] : kModelNames) {
    if (format == bundle.upload.format) model_name = name;
  }
  Files files = {{kReadme, kReadmeText},
                 {kFacts, FactsOf(bundle, model_name)},
                 {kRecording, bundle.recording},
                 {model_name, bundle.model},
                 {kCamera, CameraModelToYaml(bundle.camera)},
                 {kSensor, SensorProfileToYaml(bundle.sensor)},
                 {kPoses, bundle.poses},
                 {kReport, bundle.report}};
  EVPOSE_RETURN_IF_ERROR(CheckSize(path, files));
  files[kSums] = SumsOf(files);
  EVPOSE_ASSIGN_OR_RETURN(TarWriter writer, TarWriter::Create(path));
  for (const auto& [name, contents] : files) writer.Add(kFolder + name, contents);
  return writer.Commit();
}

absl::StatusOr<Bundle> ReadBundle(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(Files files, ReadTar(path, kMaxBundleBytes));
  absl::StatusOr<Bundle> bundle = BundleOf(std::move(files));
  if (bundle.ok()) return bundle;
  return absl::Status(bundle.status().code(), absl::StrCat(path, ": ", bundle.status().message()));
}

}  // namespace evpose::client
