// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/tracking_recordings.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <system_error>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/recordings/event_reader.h"
#include "core/recordings/recording_reader.h"
#include "core/simulation/describe.h"

namespace evpose {
namespace {

namespace fs = std::filesystem;

constexpr const char* kRecordingName = "recording.raw";

// Text of simulation.txt of a complete recording.
std::string Note(const SimulationOptions& run, uint64_t num_events, uint64_t num_bytes) {
  return absl::StrCat(DescribeSimulation(run), "events ", num_events, "\nbytes ", num_bytes, "\n");
}

// Number of events according to simulation.txt; nullopt if the recording is missing, of another simulation or
// incomplete.
std::optional<uint64_t> NumKeptEvents(const SimulationOptions& run, const fs::path& directory) {
  constexpr size_t kMaxNoteBytes = 1 << 16;  // a description has some kilobytes
  const absl::StatusOr<std::string> note = ReadFile((directory / kSimulationNote).string(), kMaxNoteBytes);
  if (!note.ok()) return std::nullopt;
  std::error_code error;
  const uint64_t num_bytes = fs::file_size(directory / kRecordingName, error);
  if (error) return std::nullopt;
  const std::string description = DescribeSimulation(run);
  uint64_t num_events = 0;
  const size_t line = note->rfind("\nevents ");
  if (line == std::string::npos) return std::nullopt;
  const std::string number = note->substr(line + 8, note->find('\n', line + 1) - line - 8);
  if (!absl::SimpleAtoi(number, &num_events) || *note != Note(run, num_events, num_bytes)) return std::nullopt;
  return num_events;
}

absl::StatusOr<uint64_t> Keep(const SimulationOptions& run, const fs::path& directory,
                              const std::function<bool(double)>& on_simulated) {
  std::error_code error;
  fs::remove(directory / kSimulationNote, error);  // it describes the recording that is about to be replaced
  double done_ratio = 0.0;
  EVPOSE_ASSIGN_OR_RETURN(const SimulationReport report,
                          SimulateToDirectory(
                              run, directory.string(), [&](double ratio) { done_ratio = ratio; },
                              [&] { return on_simulated && !on_simulated(done_ratio); }));
  const uint64_t num_bytes = fs::file_size(directory / kRecordingName, error);
  if (error) {
    return absl::UnavailableError(absl::StrCat((directory / kRecordingName).string(), ": ", error.message()));
  }
  EVPOSE_RETURN_IF_ERROR(WriteFile((directory / kSimulationNote).string(), Note(run, report.events, num_bytes)));
  return report.events;
}

absl::Status Read(const fs::path& directory, uint64_t num_events, const EventConsumer& on_events) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<RecordingReader> reader,
                          RecordingReader::Open((directory / kRecordingName).string()));
  constexpr size_t kPieceBytes = 1 << 17;  // bounds the memory
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(*reader, {.max_piece_bytes = kPieceBytes}));
  while (true) {
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (!has_piece) break;
    EVPOSE_RETURN_IF_ERROR(on_events(events.decoded().events));
  }
  if (events.counts().cd_events == num_events) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(directory.string(), ": holds ", events.counts().cd_events, " events and not ",
                                          num_events, ": delete it, and it will be made again"));
}

}  // namespace

absl::Status PlayRun(const SimulationOptions& run, const std::string& directory, const EventConsumer& on_events,
                     const std::function<bool(double)>& on_simulated) {
  if (directory.empty()) return Simulate(run, on_events).status();
  std::optional<uint64_t> num_events = NumKeptEvents(run, directory);
  if (!num_events) {
    EVPOSE_ASSIGN_OR_RETURN(num_events, Keep(run, directory, on_simulated));
  }
  return Read(directory, *num_events, on_events);
}

}  // namespace evpose
