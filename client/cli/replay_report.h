// What a replay says at its end.
#pragma once

#include <cstdint>
#include <ostream>
#include <string>
#include <vector>

#include "client/cli/command.h"
#include "client/lib/types.h"
#include "core/events/recording_header.h"

namespace evpose::client {

struct ReplayReport {
  std::string recording;
  std::string out;      // empty: poses were not written
  std::string session;  // empty: it is gone
  RecordingHeader header;
  TrackSummary summary;
  absl::Duration wall_time;
  size_t truncated_bytes = 0;  // at the end of the recording, no whole word
  bool is_interrupted = false;
  std::vector<std::string> model_notices;
  uint32_t num_symmetries = 1;  // of the model

  void Add(const Notice& notice);

  // The last line has events, poses, losses, Mev/s and latencies.
  void Print(std::ostream& out_stream) const;
  Json ToJson() const;

 private:
  const ObjectHealth* Object() const { return summary.health.objects.empty() ? nullptr : &summary.health.objects[0]; }
  // What it ends without: a line, or empty when the object is tracked at the end.
  std::string WhyNoPose() const;
  double MegaEventsPerSecond() const;

  int64_t last_change_us_ = 0;
  uint64_t decode_faults_ = 0;
  std::string first_decode_fault_;
};

}  // namespace evpose::client
