// SPDX-License-Identifier: Apache-2.0

// The part of evpose doctor that examines a recording or a live camera.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "absl/types/span.h"
#include "client/cli/commands/doctor_report.h"
#include "client/cli/console/cli_context.h"
#include "client/diagnosis/packet_watch.h"
#include "core/diagnosis/recording_diagnosis.h"
#include "core/geometry/camera.h"
#include "core/recordings/recording_header.h"

namespace evpose::client {

struct DoctorRecording {
  std::string path;
  double start_s = 0.0;
  std::optional<double> duration_s;

  bool is_pipe() const { return path == "-"; }
};

// Reads a recording into its diagnosis.
class RecordingExamination {
 public:
  // All references must outlive it.
  RecordingExamination(const DoctorRecording& recording, CliContext& context)
      : recording_(recording), context_(context) {}

  // Errors: those of OpenRecording() and of reading; CANCELLED after an interrupt.
  absl::Status Read(const std::optional<CameraModel>& camera);
  // Appends the findings of the events, and the result of comparing the recording with the camera, which is "not
  // checked" without a camera. To be called after Read().
  void Report(const std::optional<CameraModel>& camera, DoctorReport& report) const;

  // The larger side of the moving region, pixels; 0 if nothing moves.
  double extent_px() const { return diagnosis_->motion().extent_px; }
  const DiagnosisOptions& options() const { return diagnosis_->options(); }
  // Returns the bytes per second of the events in the busiest tenth of the time; 0 without events.
  double busy_bytes_per_s() const;

 private:
  // Returns whether all events of --start and --duration, or of the time for a live pipe, have been read.
  bool IsComplete() const;
  void AddPiece(absl::Span<const Event> events);

  const DoctorRecording& recording_;
  CliContext& context_;
  std::optional<RecordingDiagnosis> diagnosis_;
  PacketWatch packets_;
  RecordingHeader header_;
  StreamFacts facts_;
  std::optional<int64_t> t_begin_us_;   // begin of the part that is examined
  std::optional<absl::Time> deadline_;  // end of the examination of a live pipe, host's clock
  bool is_complete_ = false;
  std::vector<Event> selected_;
};

}  // namespace evpose::client
