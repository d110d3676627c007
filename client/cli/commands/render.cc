// SPDX-License-Identifier: Apache-2.0

// evpose render: draws events and the projected model as a picture or a film.
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/videoio.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/commands/commands.h"
#include "client/cli/common/model_arguments.h"
#include "client/cli/common/pose_reader.h"
#include "client/cli/common/recording_input.h"
#include "client/cli/console/progress.h"
#include "client/cli/console/wait_message.h"
#include "client/cli/pictures/frame_painter.h"
#include "client/cli/pictures/png.h"
#include "client/model_intake/model_intake.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/base/temporary_files.h"
#include "core/camera_files/camera_file.h"
#include "core/command_line/number_range.h"
#include "core/geometry/trajectory_gaps.h"
#include "core/recordings/event_reader.h"
#include "core/recordings/recording_reader.h"

namespace evpose::client {
namespace {

constexpr size_t kRenderPieceBytes = size_t{64} * 1024;  // interrupts are checked before each piece
constexpr int64_t kMaxFrames = 200'000;                  // a jump of the clock must not fill the disk

constexpr double kDefaultFps = 30.0;

struct RenderArguments {
  std::string recording;
  std::string poses;
  std::string model;
  std::string camera;
  std::string out;
  ModelReadingArguments reading;
  PoseFrameArguments frame;
  std::optional<double> at_s;
  double window_ms = 10.0;
  std::optional<double> fps;  // absent: kDefaultFps
};

struct RenderInputs {
  CameraModel camera;
  ObjectModel model;
  ReadPoses read;  // AMBIGUOUS poses are not drawn
  // Longest gap between two poses, microseconds, that is interpolated; the first (last) pose is also drawn for this
  // time before (after) it.
  int64_t max_gap_us = 0;
  std::unique_ptr<RecordingReader> reader;
  const CliContext* context = nullptr;

  const Trajectory& poses() const { return read.trajectory; }
  std::optional<RigidTransform> PoseAt(int64_t t_us) const {
    return PoseNear(poses(), t_us, max_gap_us, read.after_losses);
  }
};

absl::Status CheckNotInterrupted(const RenderInputs& inputs) {
  if (!inputs.context->IsInterrupted()) return absl::OkStatus();
  return absl::CancelledError("interrupted: nothing was written");
}

absl::StatusOr<RenderInputs> ReadInputs(const RenderArguments& arguments, CliContext& context) {
  RenderInputs inputs;
  inputs.context = &context;
  EVPOSE_ASSIGN_OR_RETURN(inputs.camera, LoadCameraModel(arguments.camera));
  EVPOSE_ASSIGN_OR_RETURN(inputs.model, arguments.reading.Load(context, arguments.model));
  EVPOSE_ASSIGN_OR_RETURN(const PoseFrame frame, arguments.frame.Read(context.err));
  EVPOSE_ASSIGN_OR_RETURN(inputs.read, ReadCameraPoses(arguments.poses, frame));
  inputs.max_gap_us = LongestInterpolatedStepUs(inputs.poses());
  const std::optional<WaitMessage> wait = WaitForRecording(context, arguments.recording);
  EVPOSE_ASSIGN_OR_RETURN(inputs.reader, OpenSeenBy(inputs.camera, arguments.camera, arguments.recording,
                                                    {.stop = context.is_interrupted}));
  return inputs;
}

// Passes all events in order to `on_event`, until it returns false or the recording ends.
absl::Status ForEachEvent(RenderInputs& inputs, const std::function<absl::StatusOr<bool>(const Event&)>& on_event) {
  EVPOSE_ASSIGN_OR_RETURN(EventReader events,
                          EventReader::Make(*inputs.reader, {.max_piece_bytes = kRenderPieceBytes}));
  ProgressLine progress(*inputs.context);
  while (true) {
    EVPOSE_RETURN_IF_ERROR(CheckNotInterrupted(inputs));
    ShowReading(events, *inputs.reader, progress);
    EVPOSE_ASSIGN_OR_RETURN(const bool has_piece, events.Next());
    if (!has_piece) return CheckNotInterrupted(inputs);  // an interrupt also ends a live source
    for (const Event& event : events.decoded().events) {
      EVPOSE_ASSIGN_OR_RETURN(const bool goes_on, on_event(event));
      if (!goes_on) return absl::OkStatus();
    }
  }
}

// Returns why there is no pose to draw, for a file without any.
std::string DescribeNoPose(const RenderArguments& arguments, const RenderInputs& inputs) {
  const std::vector<int64_t>& ambiguous_us = inputs.read.ambiguous_us;
  if (ambiguous_us.empty()) return absl::StrCat(arguments.poses, " has no pose");
  return absl::StrCat(arguments.poses, ": all its poses, ", FormatTimeSpan({ambiguous_us.front(), ambiguous_us.back()}),
                      ", are AMBIGUOUS, and none is drawn: each is one of several that are compatible with the "
                      "events; evpose view shows them");
}

double Seconds(int64_t t_us) { return static_cast<double>(t_us) * 1e-6; }

// Returns why there is no pose to draw at a time, for a file with other poses.
std::string DescribeNoPoseAt(const RenderInputs& inputs, int64_t at_us) {
  const auto is_near = [&](int64_t t_us) { return std::abs(t_us - at_us) <= inputs.max_gap_us; };
  const std::vector<int64_t>& ambiguous_us = inputs.read.ambiguous_us;
  if (std::any_of(ambiguous_us.begin(), ambiguous_us.end(), is_near)) {
    return absl::StrFormat("its poses near %.6f s are AMBIGUOUS, and none is drawn", Seconds(at_us));
  }
  const int64_t first_us = inputs.poses().front().t_us, last_us = inputs.poses().back().t_us;
  if (at_us < first_us) return absl::StrFormat("its first pose is at %.6f s", Seconds(first_us));
  if (at_us > last_us) return absl::StrFormat("its last pose is at %.6f s", Seconds(last_us));
  if (PoseNear(inputs.poses(), at_us, inputs.max_gap_us)) {
    return absl::StrFormat("has no pose at %.6f s: the object was lost between the poses before and after it",
                           Seconds(at_us));
  }
  return absl::StrFormat("has no pose at %.6f s: the poses before and after it are more than %d ms apart",
                         Seconds(at_us), inputs.max_gap_us / 1000);
}

// Returns a text with both intervals if the poses and the events have no time in common; otherwise an empty text.
std::string DescribeOtherTimes(const RenderArguments& arguments, const RenderInputs& inputs, const TimeSpan& events) {
  if (inputs.poses().empty()) return "";
  const TimeSpan poses = {inputs.poses().front().t_us, inputs.poses().back().t_us};
  return DescribeNoCommonTime(arguments.poses, poses, arguments.recording, events);
}

// Prints why the film has no pose in any frame, or why the picture at `at_us` has none; nothing if there is a pose.
void WarnWithoutPose(const RenderArguments& arguments, const RenderInputs& inputs, const TimeSpan& events,
                     std::optional<int64_t> at_us) {
  std::string why = DescribeOtherTimes(arguments, inputs, events);
  if (inputs.poses().empty()) {
    why = absl::StrCat(DescribeNoPose(arguments, inputs), ": only the events are drawn");
  } else if (why.empty() && at_us && !inputs.PoseAt(*at_us)) {
    why = absl::StrCat(arguments.poses, ": ", DescribeNoPoseAt(inputs, *at_us), ": only the events are drawn");
  }
  if (!why.empty()) inputs.context->err << "evpose render: " << why << std::endl;
}

void FinishFrame(FramePainter& painter, const RenderInputs& inputs, int64_t t_us, double window_ms) {
  const std::optional<RigidTransform> pose = inputs.PoseAt(t_us);
  painter.DrawModel(pose);
  painter.DrawLegend(t_us, window_ms, pose);
}

// The error for a picture at a time without events.
absl::Status NoEventError(const RenderArguments& arguments, const RenderInputs& inputs, int64_t t_us,
                          const TimeSpan& events) {
  if (const std::string why = DescribeOtherTimes(arguments, inputs, events); !arguments.at_s && !why.empty()) {
    return absl::OutOfRangeError(why);
  }
  return absl::OutOfRangeError(
      absl::StrFormat("%s has no event within %g ms of %.6f s: its events are %s; give another time with --at",
                      arguments.recording, arguments.window_ms / 2, Seconds(t_us), FormatTimeSpan(events)));
}

absl::Status RenderPicture(const RenderArguments& arguments, RenderInputs& inputs) {
  if (!arguments.at_s && inputs.poses().empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(DescribeNoPose(arguments, inputs), "; --at SECONDS draws the events of that time alone"));
  }
  const Trajectory& poses = inputs.poses();
  const int64_t t_us =
      arguments.at_s ? std::llround(*arguments.at_s * 1e6) : (poses.front().t_us + poses.back().t_us) / 2;
  const int64_t half_window_us = std::llround(arguments.window_ms * 500.0);
  FramePainter painter(inputs.camera, inputs.model);
  const bool has_pose = inputs.PoseAt(t_us).has_value();
  uint64_t drawn = 0;
  std::optional<TimeSpan> events;
  EVPOSE_RETURN_IF_ERROR(ForEachEvent(inputs, [&](const Event& event) -> absl::StatusOr<bool> {
    events = {events ? events->from_us : event.t_us, event.t_us};
    if (event.t_us < t_us - half_window_us) return true;
    // Without a picture or a pose, the message has the times of all events.
    if (event.t_us >= t_us + half_window_us) return drawn == 0 || !has_pose;
    painter.DrawEvent(event);
    ++drawn;
    return true;
  }));
  if (!events) return absl::OutOfRangeError(absl::StrCat(arguments.recording, " has no event"));
  if (drawn == 0) return NoEventError(arguments, inputs, t_us, *events);
  WarnWithoutPose(arguments, inputs, *events, t_us);
  FinishFrame(painter, inputs, t_us, arguments.window_ms);
  EVPOSE_ASSIGN_OR_RETURN(const std::string png, EncodePng(painter.image()));
  return WriteFile(arguments.out, png);
}

// A film file. It appears under its name when it is complete.
class Film {
 public:
  static absl::StatusOr<std::unique_ptr<Film>> Create(const std::string& path, double fps, const cv::Size& size) {
    // FFmpeg would report on standard error what Commit() reports. OpenCV reads the variable at its first use of
    // FFmpeg.
    // NOLINTNEXTLINE(concurrency-mt-unsafe): no other thread uses the environment
    setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", /*overwrite=*/0);
    cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
    // OpenCV does not report why it cannot write a file.
    EVPOSE_ASSIGN_OR_RETURN(OutputFile probe, OutputFile::Create(path));
    probe.Remove();
    std::unique_ptr<Film> film(new Film(path));
    const bool is_mp4 = absl::EndsWith(path, ".mp4");
    const int codec =
        is_mp4 ? cv::VideoWriter::fourcc('m', 'p', '4', 'v') : cv::VideoWriter::fourcc('M', 'J', 'P', 'G');
    film->writer_.open(film->temporary_path_, codec, fps, size);
    if (film->writer_.isOpened()) return film;
    return absl::UnavailableError(
        is_mp4 ? absl::StrCat(path, ": cannot be written; OpenCV may lack the MPEG-4 encoder here: try .avi")
               : absl::StrCat(path, ": cannot be written"));
  }
  ~Film() {
    writer_.release();
    std::error_code ignored;
    if (!is_committed_) std::filesystem::remove(temporary_path_, ignored);
    UnregisterTemporaryFile(temporary_path_);
  }

  void Write(const cv::Mat& image) {
    writer_.write(image);
    ++num_frames_;
  }
  // OpenCV reports no error of a write, as on a full disk: the frames that are in the file are counted.
  absl::Status Commit() {
    writer_.release();
    int64_t num_readable = 0;
    for (cv::VideoCapture film(temporary_path_, cv::CAP_FFMPEG); film.grab();) ++num_readable;
    if (num_readable < num_frames_) {
      return absl::UnavailableError(absl::StrCat(path_, ": writing failed: of ", num_frames_, " frames only ",
                                                 num_readable, " are in the file: make room on its disk"));
    }
    std::error_code error;
    std::filesystem::rename(temporary_path_, path_, error);
    if (error) return absl::UnavailableError(absl::StrCat(path_, ": ", error.message()));
    is_committed_ = true;
    return absl::OkStatus();
  }

 private:
  // The extension remains last, because it selects the container.
  explicit Film(const std::string& path)
      : path_(path),
        temporary_path_(absl::StrCat(path, ".partial-", getpid(), std::filesystem::path(path).extension().string())) {
    RegisterTemporaryFile(temporary_path_);
  }

  const std::string path_;
  const std::string temporary_path_;
  cv::VideoWriter writer_;
  int64_t num_frames_ = 0;
  bool is_committed_ = false;
};

// Frame k shows the middle of [first + k period, first + (k + 1) period).
absl::Status RenderFilm(const RenderArguments& arguments, RenderInputs& inputs) {
  const double fps = arguments.fps.value_or(kDefaultFps);
  const int64_t period_us = std::llround(1e6 / fps);
  const int64_t window_us = std::llround(arguments.window_ms * 1e3);
  if (window_us > period_us) {
    return UsageError(absl::StrFormat("--window-ms is at most the time from frame to frame, %g ms", period_us * 1e-3));
  }
  FramePainter painter(inputs.camera, inputs.model);
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Film> film, Film::Create(arguments.out, fps, painter.image().size()));
  std::optional<int64_t> first_us;
  int64_t last_us = 0;
  int64_t frame = 0;
  const auto middle_us = [&] { return *first_us + frame * period_us + period_us / 2; };
  const auto finish = [&] {
    FinishFrame(painter, inputs, middle_us(), arguments.window_ms);
    film->Write(painter.image());
    painter.Clear();
    ++frame;
  };
  const auto on_event = [&](const Event& event) -> absl::StatusOr<bool> {
    if (!first_us) first_us = event.t_us;
    last_us = event.t_us;
    const int64_t event_frame = (event.t_us - *first_us) / period_us;
    if (event_frame > kMaxFrames) {
      return absl::OutOfRangeError(absl::StrFormat("%s: at %.6f s the film has more than %d frames",
                                                   arguments.recording, event.t_us * 1e-6, kMaxFrames));
    }
    while (frame < event_frame) {
      EVPOSE_RETURN_IF_ERROR(CheckNotInterrupted(inputs));
      finish();
    }
    if (std::abs(event.t_us - middle_us()) * 2 <= window_us) painter.DrawEvent(event);
    return true;
  };
  EVPOSE_RETURN_IF_ERROR(ForEachEvent(inputs, on_event));
  if (!first_us) return absl::OutOfRangeError(absl::StrCat(arguments.recording, " has no event"));
  finish();
  const TimeSpan events = {*first_us, last_us};
  if (const std::string why = DescribeOtherTimes(arguments, inputs, events); !why.empty()) {
    return absl::OutOfRangeError(why);  // for every frame
  }
  WarnWithoutPose(arguments, inputs, events, std::nullopt);
  return film->Commit();
}

absl::Status RunRender(const RenderArguments& arguments, CliContext& context) {
  const bool is_film = absl::EndsWith(arguments.out, ".mp4") || absl::EndsWith(arguments.out, ".avi");
  if (!is_film && !absl::EndsWith(arguments.out, ".png")) {
    return UsageError(absl::StrCat("--out ", arguments.out, ": a picture is a .png, a film a .mp4 or .avi"));
  }
  if (is_film && arguments.at_s) return UsageError("--at is for pictures; a film shows the whole recording");
  if (!is_film && arguments.fps) return UsageError("--fps is for films, .mp4 or .avi");
  EVPOSE_ASSIGN_OR_RETURN(RenderInputs inputs, ReadInputs(arguments, context));
  try {
    EVPOSE_RETURN_IF_ERROR(is_film ? RenderFilm(arguments, inputs) : RenderPicture(arguments, inputs));
  } catch (const cv::Exception& error) {
    return absl::InternalError(absl::StrCat(arguments.out, ": OpenCV: ", error.what()));
  }
  context.out << arguments.out << "\n";
  return absl::OkStatus();
}

}  // namespace

CommandRunner AddRenderCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<RenderArguments>();
  app.option_defaults()->group(kInputGroup);
  AddFile(app, "recording", arguments->recording, absl::StrCat("Recording: ", kRecordingFormats))->required();
  AddFile(app, "--poses", arguments->poses,
          "Poses of one object: .tum, .csv or .jsonl, as replay writes them; AMBIGUOUS ones are not drawn")
      ->required();
  AddFile(app, "--model", arguments->model, absl::StrCat("Model of the object: ", kModelFormats))->required();
  AddFile(app, "--camera", arguments->camera, kCameraFiles)->required();
  arguments->frame.AddForReading(app);
  arguments->reading.AddTo(app);
  app.option_defaults()->group(kOutputGroup);
  AddOutputFile(app, "-o,--out", arguments->out, "Picture (.png) or film (.mp4, .avi) to write")->required();
  app.add_option("--at", arguments->at_s, "Time of the picture on the sensor's clock. Default: the middle of the poses")
      ->check(FiniteNumber())
      ->type_name("SECONDS");
  AddOption(app, "--window-ms", arguments->window_ms, "Duration of the events that are drawn, around that time",
            NumberRange(0.001, 10'000.0))
      ->type_name("MILLISECONDS");
  app.add_option("--fps", arguments->fps, "Frames per second of the film, which lasts as long as the recording")
      ->check(NumberRange(1.0, 1000.0))
      ->default_str(absl::StrCat(kDefaultFps))
      ->type_name("HZ");
  app.footer(
      "ON events are blue, OFF events red, the visible edges of the model green. Pictures of small sensors are "
      "enlarged by a whole factor, to a height of at least 480 pixels.\n\n"
      "Example:\n"
      "  evpose simulate --object cube --camera vga --duration 0.5 --out cube\n"
      "  evpose render cube/recording.raw --poses cube/truth.tum --model cube/model.obj --camera cube/camera.yaml "
      "--out cube/picture.png");
  return [arguments, &context] { return RunRender(*arguments, context); };
}

}  // namespace evpose::client
