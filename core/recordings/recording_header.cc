// SPDX-License-Identifier: Apache-2.0
#include "core/recordings/recording_header.h"

#include <algorithm>
#include <array>
#include <initializer_list>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"

namespace evpose {
namespace {

// Cameras write less than 1 KiB; the limit bounds the search for the end in a file that is not a recording.
constexpr size_t kMaxHeaderBytes = size_t{64} * 1024;
constexpr size_t kDatBinaryBytes = 2;
constexpr std::string_view kDatCdType("\x0c\x08", kDatBinaryBytes);  // CD events of 8 bytes

struct Line {
  int number;              // from 1
  absl::string_view text;  // without '%', surrounding spaces and the end of the line
};

struct Lines {
  std::vector<Line> lines;
  size_t size_bytes = 0;
  bool may_go_on = false;  // the header may continue beyond the prefix
};

absl::Status LineError(int line, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat("header line ", line, ": ", what));
}

bool IsControl(char c) { return (static_cast<unsigned char>(c) < 0x20 && c != '\t') || c == 0x7f; }

// The lines that begin with "% " and hold no control character, up to "% end" if there is one. Event words that begin
// with the byte '%' by chance do not fulfil this.
Lines SplitLines(absl::string_view prefix) {
  Lines result;
  size_t begin = 0;
  while (true) {
    const absl::string_view rest = prefix.substr(begin);
    const size_t newline = rest.find('\n');
    const bool is_whole_line = newline != absl::string_view::npos;
    absl::string_view line = rest.substr(0, newline);
    absl::ConsumeSuffix(&line, "\r");
    bool is_header = rest.empty() || rest[0] == '%';
    is_header = is_header && (line.size() < 2 || line[1] == ' ');
    for (const char c : line) is_header = is_header && !IsControl(c);
    if (!is_header) break;
    if (!is_whole_line) result.may_go_on = true;
    if (rest.empty()) break;
    const size_t size = is_whole_line ? newline + 1 : rest.size();
    begin += size;
    result.lines.push_back({static_cast<int>(result.lines.size()) + 1, absl::StripAsciiWhitespace(line.substr(1))});
    if (is_whole_line && absl::EqualsIgnoreCase(result.lines.back().text, "end")) break;
    if (!is_whole_line) break;
  }
  result.size_bytes = begin;
  return result;
}

struct Sensor {
  absl::string_view name;  // in lower case, without dots
  SensorGeometry geometry;
};

// A name stands for the first of these that it contains.
constexpr std::array<Sensor, 9> kSensors = {{{"genx320", {320, 320}},
                                             {"imx636", {1280, 720}},
                                             {"imx646", {1280, 720}},
                                             {"imx637", {640, 512}},
                                             {"imx647", {640, 512}},
                                             {"gen4", {1280, 720}},
                                             {"gen3", {640, 480}},
                                             {"gen2", {304, 240}},
                                             {"atis", {304, 240}}}};

std::optional<SensorGeometry> SensorOfName(absl::string_view name) {
  const std::string plain = absl::StrReplaceAll(absl::AsciiStrToLower(name), {{".", ""}, {"_", ""}, {"-", ""}});
  for (const Sensor& sensor : kSensors) {
    if (absl::StrContains(plain, sensor.name)) return sensor.geometry;
  }
  return std::nullopt;
}

struct SystemIds {
  SensorGeometry geometry;
  std::initializer_list<int> ids;
};

// The system_ID of Prophesee's cameras, as in OpenEB.
constexpr SystemIds kSystemIds[] = {
    {{304, 240}, {0x14}},
    {{640, 480}, {0x15, 0x17, 0x19, 0x1c, 0x1d, 0x21, 0x22, 0x23, 0x28, 0x29}},
    {{1280, 720}, {0x1a, 0x1e, 0x1f, 0x20, 0x27, 0x2e, 0x30, 0x31, 0x32, 0x35, 0x37, 0x3a, 0x42}},
    {{640, 512}, {0x34, 0x36}},
    {{320, 320}, {0x3b, 0x40}}};

std::optional<SensorGeometry> SensorOfSystemId(absl::string_view text) {
  int id = 0;
  if (!absl::SimpleAtoi(text, &id)) return std::nullopt;
  id &= ~0x80;  // this flag marks a variant of the same sensor
  for (const SystemIds& system : kSystemIds) {
    if (std::find(system.ids.begin(), system.ids.end(), id) != system.ids.end()) return system.geometry;
  }
  return std::nullopt;
}

// The largest Prophesee sensor; FLAT64 may come from any camera.
SensorGeometry DefaultGeometry(Encoding encoding) {
  return encoding == Encoding::kFlat64 ? SensorGeometry{2048, 2048} : SensorGeometry{1280, 720};
}

// The statements of the header, each with the number of the first line that makes it.
class HeaderReader {
 public:
  absl::Status Read(const std::vector<Line>& lines) {
    for (const Line& line : lines) EVPOSE_RETURN_IF_ERROR(ReadLine(line));
    if (!encoding_.has_value()) {
      return absl::InvalidArgumentError(
          "the header names no format: no line '% format ...', '% evt ...' or '% Data file containing ...'");
    }
    if (width_.has_value() != height_.has_value()) {
      return LineError(width_.has_value() ? width_->line : height_->line, width_.has_value()
                                                                              ? "a width, but no line gives a height"
                                                                              : "a height, but no line gives a width");
    }
    return CheckVariant();
  }

  Encoding encoding() const { return encoding_->value; }
  int64_t time_offset_us() const { return time_offset_us_.has_value() ? time_offset_us_->value : 0; }
  bool geometry_is_stated() const { return width_.has_value(); }
  bool geometry_is_known() const { return width_.has_value() || NamedSensor().has_value(); }

  absl::StatusOr<SensorGeometry> Geometry() const {
    if (!width_.has_value()) return NamedSensor().value_or(DefaultGeometry(encoding()));
    const SensorGeometry geometry = {width_->value, height_->value};
    const absl::Status status = ValidateGeometry(encoding(), geometry);
    if (!status.ok()) return LineError(width_->line, status.message());
    return geometry;
  }

 private:
  template <typename Value>
  struct Stated {
    Value value;
    int line;
  };

  std::optional<SensorGeometry> NamedSensor() const {
    for (const auto& sensor : {plugin_, sensor_name_, generation_, system_id_}) {
      if (sensor.has_value()) return sensor->value;
    }
    return std::nullopt;
  }

  absl::Status ReadLine(const Line& line) {
    const std::pair<absl::string_view, absl::string_view> parts = absl::StrSplit(line.text, absl::MaxSplits(' ', 1));
    const std::string key = absl::AsciiStrToLower(parts.first);
    const absl::string_view value = absl::StripAsciiWhitespace(parts.second);
    if (absl::StartsWithIgnoreCase(line.text, "data file containing")) return SetEncoding(Encoding::kDat, line.number);
    if (key == "evt") return ReadEvt(value, line.number);
    if (key == "format") return ReadFormat(value, line.number);
    if (key == "geometry") return ReadGeometry(value, line.number);
    if (key == "width") return SetSize("width", value, line.number, width_);
    if (key == "height") return SetSize("height", value, line.number, height_);
    if (key == "time_offset_us") return ReadTimeOffset(value, line.number);
    if (key == "version") return SetOnce("version", std::string(value), line.number, version_);
    if (key == "endianness") return SetOnce("the order of bytes", std::string(value), line.number, word_order_);
    if (key == "plugin_name") return SetSensor(SensorOfName(value), line.number, plugin_);
    if (key == "sensor_name") return SetSensor(SensorOfName(value), line.number, sensor_name_);
    if (key == "sensor_generation" || key == "generation") {
      return SetSensor(SensorOfName(absl::StrCat("gen", value)), line.number, generation_);
    }
    if (key == "system_id") return SetSensor(SensorOfSystemId(value), line.number, system_id_);
    return absl::OkStatus();
  }

  absl::Status ReadTimeOffset(absl::string_view value, int line) {
    int64_t offset_us = 0;
    if (!absl::SimpleAtoi(value, &offset_us) || offset_us < -kMaxStateTimeUs || offset_us > kMaxStateTimeUs) {
      return LineError(line, absl::StrCat("the time offset ", Quoted(value), " is not a number of microseconds within ",
                                          kMaxStateTimeUs));
    }
    return SetOnce("the time offset", offset_us, line, time_offset_us_);
  }

  absl::Status ReadEvt(absl::string_view value, int line) {
    if (value == "3.0" || value == "3") return SetEncoding(Encoding::kEvt3, line);
    if (value == "2.1") return SetEncoding(Encoding::kEvt21, line);
    if (value == "2.0" || value == "2") return SetEncoding(Encoding::kEvt2, line);
    return LineError(line, absl::StrCat("EVT ", Escaped(value), " is not supported: only 3.0, 2.1 and 2.0 are"));
  }

  // A value such as "EVT3;height=720;width=1280".
  absl::Status ReadFormat(absl::string_view value, int line) {
    const std::vector<absl::string_view> parts = absl::StrSplit(value, ';');
    // StrSplit has no part at all for a view whose data() is null, that of a line without a value.
    if (parts.empty()) return ReadFormatName("", line);
    EVPOSE_RETURN_IF_ERROR(ReadFormatName(absl::StripAsciiWhitespace(parts.front()), line));
    for (size_t i = 1; i < parts.size(); ++i) {
      const std::pair<absl::string_view, absl::string_view> option = absl::StrSplit(parts[i], absl::MaxSplits('=', 1));
      const std::string key = absl::AsciiStrToLower(absl::StripAsciiWhitespace(option.first));
      const absl::string_view text = absl::StripAsciiWhitespace(option.second);
      if (key == "width") EVPOSE_RETURN_IF_ERROR(SetSize("width", text, line, width_));
      if (key == "height") EVPOSE_RETURN_IF_ERROR(SetSize("height", text, line, height_));
      if (key == "endianness") {
        EVPOSE_RETURN_IF_ERROR(SetOnce("the order of bytes", std::string(text), line, word_order_));
      }
    }
    return absl::OkStatus();
  }

  absl::Status ReadFormatName(absl::string_view name, int line) {
    for (const Encoding encoding :
         {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2, Encoding::kDat, Encoding::kFlat64}) {
      if (absl::EqualsIgnoreCase(name, std::string(EncodingName(encoding)))) return SetEncoding(encoding, line);
    }
    if (absl::EqualsIgnoreCase(name, "EVT21")) return SetEncoding(Encoding::kEvt21, line);
    return LineError(line, absl::StrCat("the format ", Quoted(name),
                                        " is not supported: only EVT3, EVT21, EVT2, DAT and FLAT64 are"));
  }

  absl::Status ReadGeometry(absl::string_view value, int line) {
    const std::vector<absl::string_view> parts = absl::StrSplit(value, 'x');
    if (parts.size() != 2) {
      return LineError(line,
                       absl::StrCat("the geometry ", Quoted(value), " cannot be read: it should be like 1280x720"));
    }
    EVPOSE_RETURN_IF_ERROR(SetSize("width", parts[0], line, width_));
    return SetSize("height", parts[1], line, height_);
  }

  static std::string TextOf(const std::string& text) { return Escaped(text); }
  static std::string TextOf(int64_t number) { return absl::StrCat(number); }
  static std::string TextOf(SensorGeometry size) { return absl::StrCat(size.width_px, "x", size.height_px); }

  // Keeps the first of several equal statements.
  template <typename Value>
  static absl::Status SetOnce(absl::string_view what, const Value& value, int line,
                              std::optional<Stated<Value>>& stated) {
    if (stated.has_value() && stated->value != value) {
      return LineError(line, absl::StrCat("says ", what, " ", TextOf(value), ", but line ", stated->line, " says ",
                                          TextOf(stated->value)));
    }
    if (!stated.has_value()) stated = {value, line};
    return absl::OkStatus();
  }

  // A name that stands for no known sensor states nothing.
  static absl::Status SetSensor(const std::optional<SensorGeometry>& sensor, int line,
                                std::optional<Stated<SensorGeometry>>& stated) {
    return sensor.has_value() ? SetOnce("a sensor of", *sensor, line, stated) : absl::OkStatus();
  }

  absl::Status SetEncoding(Encoding encoding, int line) {
    if (encoding_.has_value() && encoding_->value != encoding) {
      return LineError(line, absl::StrCat("says ", std::string(EncodingName(encoding)), ", but line ", encoding_->line,
                                          " says ", std::string(EncodingName(encoding_->value))));
    }
    if (!encoding_.has_value()) encoding_ = {encoding, line};
    return absl::OkStatus();
  }

  static absl::Status SetSize(absl::string_view what, absl::string_view text, int line,
                              std::optional<Stated<int>>& size) {
    int pixels = 0;
    if (!absl::SimpleAtoi(text, &pixels) || pixels <= 0) {
      return LineError(line, absl::StrCat("the ", what, " ", Quoted(text), " is not a positive number of pixels"));
    }
    return SetOnce(what, pixels, line, size);
  }

  absl::Status CheckVariant() const {
    if (encoding() == Encoding::kDat && version_.has_value() && version_->value != "2") {
      return LineError(version_->line,
                       absl::StrCat("version ", version_->value, " of DAT is not supported: only version 2 is"));
    }
    if (encoding() == Encoding::kEvt21 && word_order_.has_value() && word_order_->value != "little") {
      return LineError(word_order_->line, absl::StrCat("EVT2.1 words in the order '", word_order_->value,
                                                       "' are not supported: only 'little' is; record in EVT3"));
    }
    return absl::OkStatus();
  }

  std::optional<Stated<Encoding>> encoding_;
  std::optional<Stated<int>> width_;
  std::optional<Stated<int>> height_;
  std::optional<Stated<std::string>> version_;
  std::optional<Stated<std::string>> word_order_;
  std::optional<Stated<SensorGeometry>> plugin_;
  std::optional<Stated<SensorGeometry>> sensor_name_;
  std::optional<Stated<SensorGeometry>> generation_;
  std::optional<Stated<SensorGeometry>> system_id_;
  std::optional<Stated<int64_t>> time_offset_us_;
};

// Checks the two bytes after the text of a DAT header: type and size of the events.
absl::Status CheckDatBinary(absl::string_view bytes) {
  const int type = static_cast<unsigned char>(bytes[0]);
  const int size = static_cast<unsigned char>(bytes[1]);
  constexpr int kEvent2d = 0;
  constexpr int kEventCd = 12;
  if ((type == kEvent2d || type == kEventCd) && size == 8) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("the two bytes after the DAT header state events of type ", type,
                                                 " and ", size,
                                                 " bytes; only types 0 and 12 of 8 bytes are supported"));
}

}  // namespace

absl::StatusOr<std::optional<RecordingHeader>> ParseRecordingHeader(std::string_view prefix, bool is_whole_file) {
  const absl::string_view bytes(prefix.data(), prefix.size());
  const Lines lines = SplitLines(bytes.substr(0, kMaxHeaderBytes + 1));
  if (lines.size_bytes > kMaxHeaderBytes) {
    return absl::InvalidArgumentError(absl::StrCat("the header is longer than ", kMaxHeaderBytes, " bytes"));
  }
  if (lines.may_go_on && !is_whole_file) return std::nullopt;
  if (lines.lines.empty()) {
    return absl::InvalidArgumentError(
        "there is no header: a RAW or DAT recording begins with lines that start with '% '");
  }
  HeaderReader reader;
  EVPOSE_RETURN_IF_ERROR(reader.Read(lines.lines));
  RecordingHeader header;
  header.encoding = reader.encoding();
  EVPOSE_ASSIGN_OR_RETURN(header.geometry, reader.Geometry());
  header.geometry_is_stated = reader.geometry_is_stated();
  header.geometry_is_known = reader.geometry_is_known();
  header.time_offset_us = reader.time_offset_us();
  header.size_bytes = lines.size_bytes;
  header.text = std::string(bytes.substr(0, lines.size_bytes));
  if (header.encoding == Encoding::kDat) {
    if (bytes.size() < lines.size_bytes + kDatBinaryBytes) {
      if (!is_whole_file) return std::nullopt;
      return absl::InvalidArgumentError("the file ends before the two bytes that end a DAT header");
    }
    EVPOSE_RETURN_IF_ERROR(CheckDatBinary(bytes.substr(lines.size_bytes)));
    header.size_bytes += kDatBinaryBytes;
  }
  return header;
}

std::string MakeRawHeader(Encoding encoding, SensorGeometry geometry, int64_t time_offset_us) {
  const int width = geometry.width_px;
  const int height = geometry.height_px;
  const std::string offset = time_offset_us == 0 ? "" : absl::StrCat("% time_offset_us ", time_offset_us, "\n");
  if (encoding == Encoding::kDat) {
    return absl::StrCat("% Data file containing CD events.\n% Version 2\n", offset, "% Height ", height, "\n% Width ",
                        width, "\n", std::string(kDatCdType));
  }
  std::string name(EncodingName(encoding));
  std::string evt;
  std::string order;
  if (encoding == Encoding::kEvt3) evt = "% evt 3.0\n";
  if (encoding == Encoding::kEvt2) evt = "% evt 2.0\n";
  if (encoding == Encoding::kEvt21) {
    name = "EVT21";
    evt = "% evt 2.1\n";
    order = "% endianness little\n";
  }
  // The lines that readers need, in the order of a camera, but none that name a camera: there was none.
  return absl::StrCat(order, evt, "% format ", name, ";height=", height, ";width=", width, "\n% geometry ", width, "x",
                      height, "\n", offset, "% end\n");
}

}  // namespace evpose
