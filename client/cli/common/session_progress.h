// SPDX-License-Identifier: Apache-2.0

// The progress of a replay: how much was sent, and what the server makes of it.
#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <thread>

#include "client/cli/common/progress.h"
#include "client/lib/client.h"

namespace evpose::client {

// Asks the server for the session's health now and then, in a thread of its own, and shows it.
class SessionProgress {
 public:
  // `total_bytes`: of the recording, -1 when not known. The arguments must outlive it.
  SessionProgress(CliContext& context, Client& client, const std::string& session, int64_t total_bytes, bool is_shown);
  ~SessionProgress() { Stop(); }

  void Update(const TrackProgress& progress);
  // A line of its own, also when the progress is not shown.
  void Say(const std::string& text);
  void Stop();

 private:
  void Run(std::stop_token stop);

  CliContext& context_;
  Client& client_;
  const std::string session_;
  const int64_t total_bytes_;
  std::mutex mutex_;
  TrackProgress progress_;  // guarded by mutex_, as what is shown is
  ProgressLine line_;
  std::jthread thread_;
};

}  // namespace evpose::client
