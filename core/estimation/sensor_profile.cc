// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/sensor_profile.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <exception>
#include <new>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "core/base/check_range.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

constexpr size_t kMaxFileBytes = 64 << 10;  // bytes; a profile has about 1000, and a larger file is something else
constexpr char kNameKey[] = "name";

// A number of the profile: its key in the file, its member and its valid range.
struct NumberField {
  const char* key;
  double SensorProfile::*value;
  double low;
  double high;
};
constexpr std::array<NumberField, 6> kNumbers = {{
    {"pixel_noise_px", &SensorProfile::pixel_noise_px, 0.05, 10.0},
    {"blur_px", &SensorProfile::blur_px, 0.0, 5.0},
    {"contrast_threshold", &SensorProfile::contrast_threshold, 0.01, 2.0},
    {"refractory_us", &SensorProfile::refractory_us, 0.0, 10'000.0},
    {"latency_us", &SensorProfile::latency_us, -10'000.0, 10'000.0},
    {"uncertainty", &SensorProfile::uncertainty, 0.0, 10.0},
}};

// The name as it is written to a file, in quotes and escaped. It reads back unchanged if it is UTF-8.
std::string QuotedName(const std::string& name) {
  YAML::Emitter out;
  out << YAML::DoubleQuoted << name;
  return out.c_str();
}

bool IsText(const std::string& name) {
  const bool is_plain = std::all_of(name.begin(), name.end(), [](char c) { return c >= ' ' && c <= '~'; });
  // The round trip takes about as long as the creation of a session; it is therefore skipped for printable ASCII names.
  return is_plain || YAML::Load(QuotedName(name)).Scalar() == name;
}

std::string KnownKeys() {
  return absl::StrCat(kNameKey, ", ", absl::StrJoin(kNumbers, ", ", [](std::string* out, const NumberField& field) {
                        absl::StrAppend(out, field.key);
                      }));
}

absl::Status FieldError(const std::string& file, const std::string& key, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(file, ": ", key, ": ", what));
}

absl::Status ReadField(const std::string& file, const std::string& key, const YAML::Node& node,
                       SensorProfile& profile) {
  if (key == kNameKey) {
    if (!node.IsScalar()) return FieldError(file, key, "must be a YAML scalar");
    profile.name = node.Scalar();
    return absl::OkStatus();
  }
  for (const NumberField& field : kNumbers) {
    if (key != field.key) continue;
    double value = 0.0;
    if (!node.IsScalar() || !YAML::convert<double>::decode(node, value))
      return FieldError(file, key, "is not a number");
    profile.*field.value = value;
    return absl::OkStatus();
  }
  return FieldError(file, key, absl::StrCat("is not a field of a sensor profile; the fields are ", KnownKeys()));
}

absl::StatusOr<SensorProfile> ReadProfile(const YAML::Node& root, const std::string& file) {
  if (!root.IsMap()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": not a sensor profile; YAML with these keys is expected: ", KnownKeys()));
  }
  SensorProfile profile;
  for (const auto& entry : root) {
    if (!entry.first.IsScalar()) return absl::InvalidArgumentError(absl::StrCat(file, ": a key must be a YAML scalar"));
    EVPOSE_RETURN_IF_ERROR(ReadField(file, entry.first.Scalar(), entry.second, profile));
  }
  if (const absl::Status status = profile.Validate(); !status.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": ", status.message()));
  }
  return profile;
}

}  // namespace

absl::Status SensorProfile::Validate() const {
  if (!IsText(name)) return absl::InvalidArgumentError(absl::StrCat(kNameKey, " must be text in UTF-8"));
  for (const NumberField& field : kNumbers) {
    EVPOSE_RETURN_IF_ERROR(CheckRange(field.key, this->*field.value, field.low, field.high));
  }
  return absl::OkStatus();
}

absl::StatusOr<SensorProfile> LoadSensorProfile(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string yaml, ReadFile(path, kMaxFileBytes));
  return ParseSensorProfile(yaml, path);
}

absl::StatusOr<SensorProfile> ParseSensorProfile(const std::string& yaml, const std::string& name_for_errors) {
  if (yaml.size() > kMaxFileBytes) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s: larger than %d bytes; not a sensor profile", name_for_errors, kMaxFileBytes));
  }
  try {
    return ReadProfile(YAML::Load(yaml), name_for_errors);
  } catch (const YAML::Exception& e) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s: line %d: not YAML: %s", name_for_errors, e.mark.line + 1, e.msg));
  } catch (const std::bad_alloc&) {
    throw;  // memory is exhausted: no fault of the file
  } catch (const std::exception& e) {
    return absl::InvalidArgumentError(absl::StrCat(name_for_errors, ": not a sensor profile: ", e.what()));
  }
}

std::string SensorProfileToYaml(const SensorProfile& profile) {
  YAML::Emitter out;
  out << YAML::BeginMap << YAML::Key << kNameKey << YAML::Value << YAML::DoubleQuoted << profile.name;
  for (const NumberField& field : kNumbers) {
    // 17 significant digits always give the same bits back; 6 are written where they suffice.
    const double number = profile.*field.value;
    std::string digits = absl::StrFormat("%.6g", number);
    if (std::stod(digits) != number) digits = absl::StrFormat("%.17g", number);
    out << YAML::Key << field.key << YAML::Value << digits;
  }
  out << YAML::EndMap;
  return absl::StrCat(out.c_str(), "\n");
}

}  // namespace evpose
