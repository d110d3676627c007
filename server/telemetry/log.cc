// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/log.h"

#include <spdlog/sinks/null_sink.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"

namespace evpose::server {
namespace {

constexpr size_t kMaxValueBytes = 2048;  // longer values, which clients may send, are cut: they would bury other lines
constexpr char kTextPattern[] = "%Y-%m-%dT%H:%M:%S.%e%z %l %v";
constexpr char kJsonPattern[] = R"({"time":"%Y-%m-%dT%H:%M:%S.%e%z","level":"%l",%v})";

// The names have the order of LogLevel.
constexpr std::array kLevelNames = {"debug", "info", "warning", "error", "off"};
constexpr std::array kSpdlogLevels = {spdlog::level::debug, spdlog::level::info, spdlog::level::warn,
                                      spdlog::level::err, spdlog::level::off};

spdlog::level::level_enum SpdlogLevel(LogLevel level) { return kSpdlogLevels[static_cast<size_t>(level)]; }

std::atomic<LogFormat> current_format = LogFormat::kText;

spdlog::logger& Logger() {
  // Never destroyed, because a thread may write to the log while the program exits.
  static const auto& logger = *new std::shared_ptr<spdlog::logger>([] {
    auto made = spdlog::get(kLogName);
    return made != nullptr ? made : spdlog::create<spdlog::sinks::null_sink_mt>(kLogName);
  }());
  return *logger;
}

// Returns the text in quotes, escaped to ASCII, and cut at kMaxValueBytes.
std::string Quoted(const std::string& text) {
  const bool is_long = text.size() > kMaxValueBytes;
  const nlohmann::json json = is_long ? text.substr(0, kMaxValueBytes) + "..." : text;
  return json.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
}

bool IsPlain(const std::string& text) {
  return !text.empty() && text.size() <= kMaxValueBytes && std::all_of(text.begin(), text.end(), [](char c) {
    return c > ' ' && c <= '~' && c != '"' && c != '\\' && c != '=';
  });
}

std::string Value(LogFormat format, const LogField& field) {
  if (const auto* text = std::get_if<std::string>(&field.value)) {
    return format == LogFormat::kText && IsPlain(*text) ? *text : Quoted(*text);
  }
  if (const auto* flag = std::get_if<bool>(&field.value)) return *flag ? "true" : "false";
  if (const auto* number = std::get_if<int64_t>(&field.value)) return absl::StrCat(*number);
  return absl::StrCat(std::get<uint64_t>(field.value));
}

}  // namespace

std::optional<LogLevel> ParseLogLevel(absl::string_view name) {
  const auto* const found = std::find(kLevelNames.begin(), kLevelNames.end(), name);
  if (found == kLevelNames.end()) return std::nullopt;
  return static_cast<LogLevel>(found - kLevelNames.begin());
}

const char* LogLevelName(LogLevel level) { return kLevelNames[static_cast<size_t>(level)]; }

std::optional<LogFormat> ParseLogFormat(absl::string_view name) {
  if (name == "text") return LogFormat::kText;
  if (name == "json") return LogFormat::kJson;
  return std::nullopt;
}

void SetUpLog(LogFormat format, LogLevel level) {
  const auto logger = spdlog::stderr_logger_mt(kLogName);
  logger->set_pattern(format == LogFormat::kJson ? kJsonPattern : kTextPattern);
  current_format = format;
  SetLogLevel(level);
}

void SetLogLevel(LogLevel level) { Logger().set_level(SpdlogLevel(level)); }

LogLevel CurrentLogLevel() {
  const auto* const found = std::find(kSpdlogLevels.begin(), kSpdlogLevels.end(), Logger().level());
  return found == kSpdlogLevels.end() ? LogLevel::kDebug : static_cast<LogLevel>(found - kSpdlogLevels.begin());
}

LogFormat CurrentLogFormat() { return current_format; }

std::string LogText(LogFormat format, const char* event, const std::vector<LogField>& fields) {
  std::string text = format == LogFormat::kJson ? absl::StrCat("\"event\":\"", event, "\"") : event;
  for (const LogField& field : fields) {
    if (format == LogFormat::kJson) {
      absl::StrAppend(&text, ",\"", field.name, "\":", Value(format, field));
    } else {
      absl::StrAppend(&text, " ", field.name, "=", Value(format, field));
    }
  }
  return text;
}

void Log(LogLevel level, const char* event, const std::vector<LogField>& fields) {
  spdlog::logger& logger = Logger();
  const auto of_spdlog = SpdlogLevel(level);
  if (logger.should_log(of_spdlog))
    logger.log(of_spdlog, spdlog::string_view_t(LogText(current_format, event, fields)));
}

}  // namespace evpose::server
