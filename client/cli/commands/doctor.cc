// SPDX-License-Identifier: Apache-2.0

// evpose doctor: checks a recording or a live camera for what goes wrong most often.
#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/commands.h"
#include "client/cli/commands/doctor_report.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/console/progress.h"
#include "client/containers/open_recording.h"
#include "client/diagnosis/packet_watch.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_file.h"
#include "core/diagnosis/object_checks.h"
#include "core/diagnosis/recording_diagnosis.h"
#include "core/events/event_reader.h"

namespace evpose::client {
namespace {

// Of a live pipe: some periods of the slowest flicker, and packets of most cameras.
constexpr double kDefaultPipeSeconds = 5.0;

struct DoctorArguments {
  std::string recording;
  std::string model;
  std::string camera;
  ModelReadingArguments reading;
  double start_s = 0.0;
  std::optional<double> duration_s;
  bool is_json = false;

  bool is_pipe() const { return recording == "-"; }
};

// Reads a recording into its diagnosis.
class RecordingExamination {
 public:
  RecordingExamination(const DoctorArguments& arguments, CliContext& context)
      : arguments_(arguments), context_(context) {}

  absl::Status Read(const std::optional<CameraModel>& camera);
  // Appends the findings of the events, and those of the camera and of the model if these were given.
  absl::Status Report(const std::optional<CameraModel>& camera, DoctorReport& report) const;

 private:
  // True when the events of --start and --duration, or of a live pipe, have been read.
  bool IsComplete() const { return is_complete_ || (deadline_ && SystemClock().Now() >= *deadline_); }
  void AddPiece(absl::Span<const Event> events);

  const DoctorArguments& arguments_;
  CliContext& context_;
  std::optional<RecordingDiagnosis> diagnosis_;
  PacketWatch packets_;
  RecordingHeader header_;
  StreamFacts facts_;
  std::vector<SkippedParts> skipped_;
  std::optional<int64_t> t_begin_us_;   // begin of the part that is examined
  std::optional<absl::Time> deadline_;  // end of the examination of a live pipe, host's clock
  bool is_complete_ = false;
  std::vector<Event> selected_;
};

absl::Status RecordingExamination::Read(const std::optional<CameraModel>& camera) {
  const double pipe_s = arguments_.duration_s.value_or(kDefaultPipeSeconds);
  if (arguments_.is_pipe()) deadline_ = SystemClock().Now() + absl::Seconds(pipe_s);
  OpenRecordingOptions options;
  options.stop = [this] { return context_.IsInterrupted() || IsComplete(); };
  if (camera) options.geometry = SensorGeometry{camera->width_px, camera->height_px};
  absl::StatusOr<std::unique_ptr<RecordingReader>> opened = OpenRecording(arguments_.recording, options);
  if (absl::IsCancelled(opened.status()) && !context_.IsInterrupted()) {
    return absl::DeadlineExceededError(absl::StrFormat(
        "standard input: sent no header within %.3g s; is the camera running? --duration waits longer", pipe_s));
  }
  EVPOSE_RETURN_IF_ERROR(opened.status());
  RecordingReader& reader = **opened;
  header_ = reader.header();
  absl::StatusOr<RecordingDiagnosis> diagnosis = RecordingDiagnosis::Make(header_.geometry);
  if (!diagnosis.ok()) {
    return absl::Status(diagnosis.status().code(),
                        absl::StrCat(arguments_.recording, ": ", diagnosis.status().message()));
  }
  diagnosis_.emplace(*std::move(diagnosis));
  EVPOSE_ASSIGN_OR_RETURN(EventReader events, EventReader::Make(reader));
  ProgressLine progress(context_);
  while (!IsComplete()) {
    const absl::Time before = SystemClock().Now();
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (context_.IsInterrupted() && !arguments_.is_pipe())
      return absl::CancelledError("interrupted: nothing was diagnosed");
    if (!has_piece) break;
    const auto& piece = events.decoded().events;
    const absl::Time now = SystemClock().Now();
    if (arguments_.is_pipe() && !piece.empty()) packets_.Add(now, now - before, piece.back().t_us);
    AddPiece(piece);
    ShowReading(events, reader, progress);
  }
  skipped_ = reader.skipped();
  facts_ = {events.counts(), events.data_bytes(), WordBytes(header_.encoding), 0};
  if (!arguments_.is_pipe() && !is_complete_) facts_.truncated_bytes = events.pending_bytes();
  return absl::OkStatus();
}

void RecordingExamination::AddPiece(absl::Span<const Event> events) {
  if (events.empty()) return;
  if (!t_begin_us_) t_begin_us_ = events.front().t_us + std::llround(arguments_.start_s * 1e6);
  const bool has_end = arguments_.is_pipe() || arguments_.duration_s;
  if (arguments_.start_s == 0.0 && !has_end) return diagnosis_->Add(events);
  const int64_t duration_us = std::llround(arguments_.duration_s.value_or(kDefaultPipeSeconds) * 1e6);
  selected_.clear();
  for (const Event& event : events) {
    if (arguments_.start_s > 0.0 && event.t_us < *t_begin_us_) continue;
    if (has_end && event.t_us >= *t_begin_us_ + duration_us) {
      is_complete_ = true;
      break;
    }
    selected_.push_back(event);
  }
  diagnosis_->Add(selected_);
}

absl::Status RecordingExamination::Report(const std::optional<CameraModel>& camera, DoctorReport& report) const {
  const std::string encoding(EncodingName(header_.encoding));
  report.subjects.push_back(absl::StrFormat(
      "%s: %s %dx%d, %d events in %.3f s", arguments_.is_pipe() ? "standard input" : arguments_.recording,
      header_.container.empty() ? encoding : header_.container, header_.geometry.width_px, header_.geometry.height_px,
      diagnosis_->num_events(), 1e-6 * static_cast<double>(diagnosis_->duration_us())));
  if (!skipped_.empty()) report.subjects.push_back("left out: " + DescribeSkipped(skipped_));
  for (Finding& finding : diagnosis_->Findings(facts_)) report.findings.push_back(std::move(finding));
  if (arguments_.is_pipe()) {
    report.findings.push_back(packets_.CheckPeriod({}));
    report.findings.push_back(packets_.CheckLag({}));
  }
  const double extent_px = diagnosis_->motion().extent_px;
  report.findings.push_back(CheckObjectSize(extent_px));
  if (!camera) {
    report.findings.push_back(NotChecked("camera", "--camera was not given"));
  } else {
    report.findings.push_back(CheckCamera(*camera, header_, diagnosis_->extent(), facts_.counts));
  }
  if (arguments_.model.empty() || !camera) {
    report.findings.push_back(NotChecked("model-scale", "--model and --camera were not given"));
    return absl::OkStatus();
  }
  EVPOSE_ASSIGN_OR_RETURN(const ObjectModel model, arguments_.reading.Load(arguments_.model));
  report.findings.push_back(
      CheckScale(model.diameter_m, arguments_.reading.metres_per_unit, *camera, extent_px, diagnosis_->options()));
  for (const std::string& notice : model.notices) report.subjects.push_back("model: " + notice);
  return absl::OkStatus();
}

absl::Status RunDoctor(const DoctorArguments& arguments, CliContext& context) {
  if (arguments.is_pipe() && arguments.start_s > 0.0)
    return UsageError("--start: standard input has no beginning to count from");
  std::optional<CameraModel> camera;
  if (!arguments.camera.empty()) {
    EVPOSE_ASSIGN_OR_RETURN(camera, LoadCameraModel(arguments.camera));
  }
  DoctorReport report;
  RecordingExamination examination(arguments, context);
  EVPOSE_RETURN_IF_ERROR(examination.Read(camera));
  EVPOSE_RETURN_IF_ERROR(examination.Report(camera, report));
  EVPOSE_RETURN_IF_ERROR(
      PrintResult(context, arguments.is_json, report.ToJson(), [&report](std::ostream& out) { report.Print(out); }));
  const std::string problems = report.Names(Verdict::kProblem);
  if (problems.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("problems were found: ", problems));
}

}  // namespace

CommandRunner AddDoctorCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<DoctorArguments>();
  app.option_defaults()->group(kInputGroup);
  AddFile(app, "recording", arguments->recording, absl::StrCat("Recording: ", kRecordingFormats))->required();
  CLI::Option* model =
      AddFile(app, "--model", arguments->model, "Model of the object, whose size is compared with the events");
  CLI::Option* camera = AddFile(app, "--camera", arguments->camera, kCameraFiles);
  model->needs(camera);
  arguments->reading.AddTo(app, model);
  AddOption(app, "--start", arguments->start_s, "Time after the first event at which the examination begins",
            CLI::Range(0.0, 1e9))
      ->type_name("SECONDS");
  app.add_option("--duration", arguments->duration_s,
                 "Time that is examined. Default: the rest of a file, 5 s of a pipe")
      ->type_name("SECONDS")
      ->check(AboveZero());
  AddJson(app, arguments->is_json);
  app.footer(
      "Checks decoding, clock, event rate, motion, noise, hot and dead pixels, flicker, polarities and focus of a "
      "recording, or of a live camera whose RAW data come through a pipe (-), and the sizes of camera and model. Each "
      "check is ok, advice, a problem, or was not made, with the measured quantity, its limit, the places and the "
      "remedy.\n\n"
      "Exit status:\n"
      "  0  No problem was found\n"
      "  1  A problem was found, or the recording cannot be read\n"
      "  2  Wrong usage\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose doctor cube/recording.raw --model cube/model.obj --camera cube/camera.yaml");
  return [arguments, &context] { return RunDoctor(*arguments, context); };
}

}  // namespace evpose::client
