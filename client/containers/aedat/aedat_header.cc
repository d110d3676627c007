// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/aedat_header.h"

#include <algorithm>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr absl::string_view kMark = "#!AER-DAT";
constexpr absl::string_view kEndOfHeader31 = "#!END-HEADER";

struct Sensor {
  absl::string_view name;  // beginning of the name of the class or device, in lower case
  SensorGeometry geometry;
  Aedat2Layout layout;  // kUnknown: not known for AEDAT 2.0
};

// The names of jAER's classes (AEDAT 2.0) and of cAER's devices (AEDAT 3.1). Tmpdiff128 is the former name of DVS128.
constexpr Sensor kSensors[] = {
    {"dvs128", {128, 128}, Aedat2Layout::kDvs128},    {"tmpdiff128", {128, 128}, Aedat2Layout::kDvs128},
    {"davis128", {128, 128}, Aedat2Layout::kUnknown}, {"davis208", {208, 192}, Aedat2Layout::kUnknown},
    {"davis240", {240, 180}, Aedat2Layout::kDavis},   {"davis346", {346, 260}, Aedat2Layout::kDavis},
    {"davis640", {640, 480}, Aedat2Layout::kDavis},   {"edvs", {128, 128}, Aedat2Layout::kUnknown},
    {"dvxplorer", {640, 480}, Aedat2Layout::kUnknown}};

const Sensor* FindSensor(absl::string_view name) {
  const std::string lower = absl::AsciiStrToLower(name.substr(name.rfind('.') + 1));  // npos + 1 is 0
  const auto* const found = std::find_if(std::begin(kSensors), std::end(kSensors),
                                         [&](const Sensor& sensor) { return absl::StartsWith(lower, sensor.name); });
  return found == std::end(kSensors) ? nullptr : found;
}

enum class LineKind { kHeader, kData, kIncomplete };

// A line of the header consists of '#', then text without control characters. A record of AEDAT 2.0 may also begin with
// the byte of '#', but has such characters: zeros at least, in its time.
LineKind KindOfLine(absl::string_view rest, bool is_whole_file, size_t& line_bytes) {
  if (rest.empty()) return is_whole_file ? LineKind::kData : LineKind::kIncomplete;
  if (rest.front() != '#') return LineKind::kData;
  const auto* const end =
      std::find_if(rest.begin(), rest.end(), [](char c) { return absl::ascii_iscntrl(c) && c != '\t'; });
  if (end == rest.end()) return is_whole_file ? LineKind::kData : LineKind::kIncomplete;
  line_bytes = static_cast<size_t>(end - rest.begin()) + 1;
  if (*end == '\n') return LineKind::kHeader;
  if (*end != '\r') return LineKind::kData;
  if (end + 1 == rest.end()) return is_whole_file ? LineKind::kData : LineKind::kIncomplete;
  ++line_bytes;
  return end[1] == '\n' ? LineKind::kHeader : LineKind::kData;
}

// The value of a line such as "# AEChip: DVS128".
bool ConsumeKey(absl::string_view line, absl::string_view key, absl::string_view& value) {
  line.remove_prefix(1);
  line = absl::StripLeadingAsciiWhitespace(line);
  if (!absl::ConsumePrefix(&line, key)) return false;
  value = absl::StripAsciiWhitespace(line);
  return true;
}

absl::StatusOr<AedatVersion> VersionOf(absl::string_view line) {
  line.remove_prefix(kMark.size());
  if (line == "2.0") return AedatVersion::k2;
  if (line == "3.1") return AedatVersion::k31;
  if (line == "4.0") return AedatVersion::k4;
  return absl::InvalidArgumentError(
      absl::StrCat("AEDAT version ", line.substr(0, 8),
                   " cannot be read, only 2.0, 3.1 and 4.0: convert the recording to 4.0 with DV"));
}

// A line after the first.
absl::Status ReadLine(absl::string_view line, AedatHeader& header) {
  absl::string_view value;
  if (header.version == AedatVersion::k2) {
    if (ConsumeKey(line, "AEChip:", value)) header.sensor = std::string(value.substr(value.rfind('.') + 1));
    return absl::OkStatus();
  }
  if (ConsumeKey(line, "Format:", value) && value != "RAW") {
    return absl::InvalidArgumentError(
        absl::StrCat("AEDAT 3.1 in the format ", value, " cannot be read, only RAW: convert it to AEDAT 4.0 with DV"));
  }
  // "#Source 1: DVS128"; lines of earlier sources begin with "#-Source".
  if (header.sensor.empty() && ConsumeKey(line, "Source ", value) && value.find(':') != absl::string_view::npos) {
    header.sensor = std::string(absl::StripAsciiWhitespace(value.substr(value.find(':') + 1)));
  }
  return absl::OkStatus();
}

absl::Status ApplySensor(AedatHeader& header) {
  const Sensor* const sensor = FindSensor(header.sensor);
  if (sensor != nullptr) {
    header.geometry = sensor->geometry;
    header.layout = sensor->layout;
  }
  if (header.version == AedatVersion::k2 && !header.sensor.empty() && header.layout == Aedat2Layout::kUnknown) {
    return absl::InvalidArgumentError(absl::StrCat("AEDAT 2.0 of the sensor ", header.sensor,
                                                   " cannot be read, only of DVS128, DAVIS240, DAVIS346 and Davis640: "
                                                   "convert the recording to AEDAT 4.0 with DV"));
  }
  return absl::OkStatus();
}

absl::Status Incomplete(absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("the header of the AEDAT recording ", what));
}

}  // namespace

bool IsAedat(absl::string_view prefix) { return absl::StartsWith(prefix, kMark); }

absl::StatusOr<std::optional<AedatHeader>> ParseAedatHeader(absl::string_view prefix, bool is_whole_file) {
  AedatHeader header;
  for (bool is_first = true;; is_first = false) {
    const absl::string_view rest = prefix.substr(header.size_bytes);
    size_t line_bytes = 0;
    const LineKind kind = KindOfLine(rest, is_whole_file, line_bytes);
    if (kind == LineKind::kIncomplete && prefix.size() <= kMaxAedatHeaderBytes) return std::nullopt;
    if (kind == LineKind::kIncomplete)
      return Incomplete(absl::StrCat("has more than ", kMaxAedatHeaderBytes, " bytes"));
    if (kind == LineKind::kData && (is_first || header.version == AedatVersion::k31))
      return Incomplete("is incomplete");
    if (kind == LineKind::kData) break;
    header.size_bytes += line_bytes;
    const absl::string_view line = absl::StripTrailingAsciiWhitespace(rest.substr(0, line_bytes));
    if (is_first) {
      if (!IsAedat(line)) return Incomplete("does not begin with #!AER-DAT");
      EVPOSE_ASSIGN_OR_RETURN(header.version, VersionOf(line));
      if (header.version == AedatVersion::k4) return header;
    } else if (header.version == AedatVersion::k31 && line == kEndOfHeader31) {
      break;
    } else {
      EVPOSE_RETURN_IF_ERROR(ReadLine(line, header));
    }
  }
  EVPOSE_RETURN_IF_ERROR(ApplySensor(header));
  return header;
}

}  // namespace evpose::client
