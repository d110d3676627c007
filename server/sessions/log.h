// The server's log: one line per event of a session's life, no secrets. Silent unless the program has made a logger of
// this name: a server inside another program does not write into that program's output.
#pragma once

#include <spdlog/sinks/null_sink.h>
#include <spdlog/spdlog.h>

#include <memory>

namespace evpose::server {

inline constexpr char kLogName[] = "evpose-server";

inline spdlog::logger& ServerLog() {
  static const std::shared_ptr<spdlog::logger> log = [] {
    auto made = spdlog::get(kLogName);
    return made != nullptr ? made : spdlog::create<spdlog::sinks::null_sink_mt>(kLogName);
  }();
  return *log;
}

}  // namespace evpose::server
