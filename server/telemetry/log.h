// SPDX-License-Identifier: Apache-2.0

// The server's log: one line for each event, as text or JSON, without secrets. Nothing is written before SetUpLog(), so
// that a server inside another program does not write to that program's output.
#pragma once

#include <concepts>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/strings/string_view.h"

namespace evpose::server {

inline constexpr char kLogName[] = "evpose-server";

enum class LogLevel { kDebug, kInfo, kWarning, kError, kOff };
enum class LogFormat { kText, kJson };

// Parses "debug", "info", "warning", "error" or "off"; nullopt for every other word.
std::optional<LogLevel> ParseLogLevel(absl::string_view name);
const char* LogLevelName(LogLevel level);
std::optional<LogFormat> ParseLogFormat(absl::string_view name);  // "text", "json"

// Directs the log to standard error, at this level and above. To be called before the first line is written.
void SetUpLog(LogFormat format, LogLevel level);
// May be called at any time from any thread.
void SetLogLevel(LogLevel level);
LogLevel CurrentLogLevel();
LogFormat CurrentLogFormat();

// A named value. Text may contain arbitrary bytes from a client; LogText() escapes them.
struct LogField {
  template <std::integral Number>
  LogField(const char* field, Number number) : name(field), value(static_cast<int64_t>(number)) {}
  LogField(const char* field, uint64_t number) : name(field), value(number) {}
  LogField(const char* field, bool flag) : name(field), value(flag) {}
  template <typename Text>
  requires(!std::integral<Text>) LogField(const char* field, const Text& text)
      : name(field), value(std::string(text)) {}

  const char* name;
  std::variant<std::string, int64_t, uint64_t, bool> value;
};

// Writes a line. `event` is a constant identifier such as session_attached, by which programs distinguish lines.
void Log(LogLevel level, const char* event, const std::vector<LogField>& fields);

// Returns the part of a line after time and level: event and fields. Bytes other than printable ASCII, quotes and
// backslashes are escaped as in JSON, and long values are cut, so that every event is exactly one line.
std::string LogText(LogFormat format, const char* event, const std::vector<LogField>& fields);

}  // namespace evpose::server
