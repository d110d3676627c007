// SPDX-License-Identifier: Apache-2.0

// Captures the server's log in tests.
#pragma once

#include <spdlog/sinks/ostream_sink.h>
#include <spdlog/spdlog.h>

#include <memory>
#include <mutex>
#include <sstream>
#include <string>

#include "server/telemetry/log.h"

namespace evpose::server {

// Replaces the log of the program. Must be created before the first line is written, once in a program.
class CapturedLog {
 public:
  CapturedLog() {
    const auto sink = std::make_shared<spdlog::sinks::ostream_sink_mt>(text_);
    const auto logger = std::make_shared<spdlog::logger>(kLogName, sink);
    logger->set_level(spdlog::level::trace);
    logger->set_pattern("%l %v");
    spdlog::register_logger(logger);
    sink_ = sink;
  }

  // Returns the lines written since the last call.
  std::string Take() {
    sink_->flush();
    std::string text = text_.str();
    text_.str("");
    return text;
  }

 private:
  std::ostringstream text_;
  std::shared_ptr<spdlog::sinks::sink> sink_;
};

inline CapturedLog captured_log;

}  // namespace evpose::server
