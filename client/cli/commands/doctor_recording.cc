// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/doctor_recording.h"

#include <cmath>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/console/progress.h"
#include "client/cli/console/wait_message.h"
#include "client/containers/open_recording.h"
#include "core/base/status_macros.h"
#include "core/diagnosis/object_checks.h"
#include "core/recordings/event_reader.h"

namespace evpose::client {
namespace {

// Seconds of a live pipe that are examined: some periods of the slowest flicker, and several packets of most cameras.
constexpr double kDefaultPipeSeconds = 5.0;

}  // namespace

bool RecordingExamination::IsComplete() const {
  return is_complete_ || (deadline_ && SystemClock().Now() >= *deadline_);
}

absl::Status RecordingExamination::Read(const std::optional<CameraModel>& camera) {
  const double pipe_s = recording_.duration_s.value_or(kDefaultPipeSeconds);
  if (recording_.is_pipe()) deadline_ = SystemClock().Now() + absl::Seconds(pipe_s);
  OpenRecordingOptions options;
  options.stop = [this] { return context_.IsInterrupted() || IsComplete(); };
  if (camera) options.geometry = SensorGeometry{camera->width_px, camera->height_px};
  std::optional<WaitMessage> wait = WaitForRecording(context_, recording_.path);
  absl::StatusOr<std::unique_ptr<RecordingReader>> opened = OpenRecording(recording_.path, options);
  wait.reset();
  if (absl::IsCancelled(opened.status()) && !context_.IsInterrupted()) {
    return absl::DeadlineExceededError(absl::StrFormat(
        "standard input: sent no header within %.3g s; is the camera running? --duration waits longer", pipe_s));
  }
  EVPOSE_RETURN_IF_ERROR(opened.status());
  RecordingReader& reader = **opened;
  header_ = reader.header();
  absl::StatusOr<RecordingDiagnosis> diagnosis = RecordingDiagnosis::Make(header_.geometry);
  if (!diagnosis.ok()) {
    return absl::Status(diagnosis.status().code(), absl::StrCat(recording_.path, ": ", diagnosis.status().message()));
  }
  diagnosis_.emplace(*std::move(diagnosis));
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(reader));
  ProgressLine progress(context_);
  while (!IsComplete()) {
    const absl::Time before = SystemClock().Now();
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (context_.IsInterrupted() && !recording_.is_pipe())
      return absl::CancelledError("interrupted: nothing was diagnosed");
    if (!has_piece) break;
    const auto& piece = events.decoded().events;
    const absl::Time now = SystemClock().Now();
    if (recording_.is_pipe() && !piece.empty()) packets_.Add(now, now - before, piece.back().t_us);
    AddPiece(piece);
    ShowReading(events, reader, progress);
  }
  if (recording_.start_s > 0.0 && t_begin_us_ && diagnosis_->num_events() == 0) {
    return absl::OutOfRangeError(
        absl::StrFormat("%s: has no events later than --start, %.6g s after its first event: give an earlier --start",
                        recording_.path, recording_.start_s));
  }
  facts_ = {events.counts(), events.data_bytes(), WordBytes(header_.encoding), 0, reader.skipped()};
  if (!recording_.is_pipe() && !is_complete_) facts_.truncated_bytes = events.pending_bytes();
  return absl::OkStatus();
}

void RecordingExamination::AddPiece(absl::Span<const Event> events) {
  if (events.empty()) return;
  if (!t_begin_us_) t_begin_us_ = events.front().t_us + std::llround(recording_.start_s * 1e6);
  const bool has_end = recording_.is_pipe() || recording_.duration_s;
  if (recording_.start_s == 0.0 && !has_end) return diagnosis_->Add(events);
  const int64_t duration_us = std::llround(recording_.duration_s.value_or(kDefaultPipeSeconds) * 1e6);
  selected_.clear();
  for (const Event& event : events) {
    if (recording_.start_s > 0.0 && event.t_us < *t_begin_us_) continue;
    if (has_end && event.t_us >= *t_begin_us_ + duration_us) {
      is_complete_ = true;
      break;
    }
    selected_.push_back(event);
  }
  diagnosis_->Add(selected_);
}

void RecordingExamination::Report(const std::optional<CameraModel>& camera, DoctorReport& report) const {
  const std::string encoding(EncodingName(header_.encoding));
  // The other events are outside the interval that is examined, or have no time.
  const std::string of_all = diagnosis_->num_events() == facts_.counts.cd_events
                                 ? ""
                                 : absl::StrFormat(" of the %d that were decoded,", facts_.counts.cd_events);
  report.subjects.push_back(absl::StrFormat(
      "%s: %s %dx%d, %d events%s in %.3f s", recording_.is_pipe() ? "standard input" : recording_.path,
      header_.container.empty() ? encoding : header_.container, header_.geometry.width_px, header_.geometry.height_px,
      diagnosis_->num_events(), of_all, 1e-6 * static_cast<double>(diagnosis_->duration_us())));
  if (!facts_.skipped.empty()) report.subjects.push_back("left out: " + DescribeSkipped(facts_.skipped));
  for (Finding& finding : diagnosis_->Findings(facts_)) report.findings.push_back(std::move(finding));
  if (recording_.is_pipe()) {
    report.findings.push_back(packets_.CheckPeriod({}));
    report.findings.push_back(packets_.CheckLag({}));
  }
  report.findings.push_back(CheckObjectSize(extent_px()));
  report.findings.push_back(camera ? CheckCamera(*camera, header_, diagnosis_->extent(), facts_.counts)
                                   : NotChecked("camera", "--camera was not given"));
}

double RecordingExamination::busy_bytes_per_s() const {
  const auto events = static_cast<double>(facts_.counts.cd_events);
  if (events == 0.0) return 0.0;
  const double bytes_per_event = static_cast<double>(facts_.data_bytes) / events;
  return diagnosis_->motion().busy_events_in_20_ms * 1e6 / MotionSamples::kSliceUs * bytes_per_event;
}

}  // namespace evpose::client
