// SPDX-License-Identifier: Apache-2.0

// The server's log: one line per event, as text or as JSON, no secrets. Silent unless SetUpLog was called: a server
// inside another program does not write into that program's output.
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

// "debug", "info", "warning", "error", "off"; nothing for another word.
std::optional<LogLevel> ParseLogLevel(absl::string_view name);
const char* LogLevelName(LogLevel level);
std::optional<LogFormat> ParseLogFormat(absl::string_view name);  // "text", "json"

// To standard error, from this level on. Before the first line.
void SetUpLog(LogFormat format, LogLevel level);
// At any time, from any thread.
void SetLogLevel(LogLevel level);
LogLevel CurrentLogLevel();
LogFormat CurrentLogFormat();

// A value may be anything that a client sends.
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

// `event` is a word of ours, as session_attached, by which a program tells lines apart.
void Log(LogLevel level, const char* event, const std::vector<LogField>& fields);

// What follows time and level in a line: event and fields. Bytes that are no printable ASCII, quotes and backslashes
// are escaped as in JSON, and what is too long is cut: a line is a line whatever is in it.
std::string LogText(LogFormat format, const char* event, const std::vector<LogField>& fields);

}  // namespace evpose::server
