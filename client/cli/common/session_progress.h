// SPDX-License-Identifier: Apache-2.0

// The progress of a replay: the data that was sent, and the health of the session at the server.
#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <thread>

#include "client/cli/console/progress.h"
#include "evpose/client.h"

namespace evpose::client {

// Polls the health of the session in a thread of its own, and displays it.
class SessionProgress {
 public:
  // `total_bytes` is the size of the recording, -1 if unknown. The arguments must outlive it.
  SessionProgress(CliContext& context, Client& client, const std::string& session, int64_t total_bytes, bool is_shown);
  ~SessionProgress() { Stop(); }

  void Update(const TrackProgress& progress);
  // Prints a line, even if the progress is not displayed.
  void PrintLine(const std::string& text);
  void Stop();

 private:
  void Run(std::stop_token stop);

  CliContext& context_;
  Client& client_;
  const std::string session_;
  const int64_t total_bytes_;
  std::mutex mutex_;
  TrackProgress progress_;  // guarded by mutex_, as all displayed data is
  ProgressLine line_;
  std::jthread thread_;
};

}  // namespace evpose::client
