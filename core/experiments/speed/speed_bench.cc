// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/speed/speed_bench.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <memory>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/events/decoder.h"
#include "core/experiments/speed/measured_time.h"
#include "core/experiments/speed/speed_windows.h"
#include "core/tracking/object/tracker_options.h"
#include "core/tracking/tracker.h"
#include "core/windows/event_window.h"

namespace evpose {
namespace {

// Size of a full chunk, as the server receives it.
constexpr size_t kPieceBytes = size_t{256} * 1024;

// Numbers of pieces of each line: more lines for the same events.
constexpr int kCuts[] = {1, 16};

class SpeedBench {
 public:
  SpeedBench(const SpeedBenchOptions& options, const std::function<void(const SpeedRow&)>& on_row,
             const SpeedProgress& on_progress)
      : options_(options), on_row_(on_row), progress_(NumSteps(), on_progress) {}

  absl::Status Run() {
    for (const SpeedScene& scene : SpeedScenes()) {
      const std::vector<std::string> parts = PartsOf(scene.name);
      if (parts.empty()) continue;
      const auto on_simulated = [&](double ratio) {
        return progress_.Show(ratio, absl::StrCat("simulating ", scene.name, " Mev/s"));
      };
      EVPOSE_ASSIGN_OR_RETURN(const SpeedRecording recording,
                              MakeSpeedRecording(scene, options_.duration_us, on_simulated));
      progress_.FinishStep();
      for (const std::string& part : parts) {
        if (!progress_.Show(0.0, absl::StrCat(part, ", ", scene.name, " Mev/s"))) {
          return absl::CancelledError("interrupted");
        }
        EVPOSE_RETURN_IF_ERROR(RunPart(part, recording));
        progress_.FinishStep();
      }
    }
    return absl::OkStatus();
  }

 private:
  // Parts that are requested and measured on this scene.
  std::vector<std::string> PartsOf(const std::string& scene) const {
    const bool is_decoded = scene == "4" || scene == "33";
    std::vector<std::string> parts;
    for (const std::string& part : SpeedParts()) {
      const bool is_wanted = options_.parts.empty() || absl::c_linear_search(options_.parts, part);
      if (is_wanted && (part == "decode") == is_decoded) parts.push_back(part);
    }
    return parts;
  }

  // The simulation of each scene, and the parts that are measured on it.
  size_t NumSteps() const {
    size_t num_steps = 0;
    for (const SpeedScene& scene : SpeedScenes()) {
      const size_t num_parts = PartsOf(scene.name).size();
      if (num_parts > 0) num_steps += 1 + num_parts;
    }
    return num_steps;
  }

  absl::Status RunPart(const std::string& part, const SpeedRecording& recording) {
    if (part == "decode") {
      for (const Encoding encoding : {Encoding::kEvt3, Encoding::kEvt21, Encoding::kEvt2}) {
        EVPOSE_RETURN_IF_ERROR(Decode(recording, encoding));
      }
      return absl::OkStatus();
    }
    if (part == "windows") return Windows(recording);
    if (part == "associate") return Associate(recording);
    if (part == "estimate") return Estimate(recording);
    if (part == "track") return Track(recording);
    return Initialize(recording);
  }

  SpeedRow Row(const std::string& part, const SpeedRecording& recording) const {
    SpeedRow row;
    row.part = part;
    row.what = part;
    row.scene = recording.scene;
    row.rate_mev_per_s = recording.RateMevPerS();
    row.num_events = recording.events.size();
    row.sensor_seconds = 1e-6 * static_cast<double>(recording.duration_us);
    row.seconds = std::numeric_limits<double>::infinity();
    return row;
  }

  absl::Status Decode(const SpeedRecording& recording, Encoding encoding) {
    EVPOSE_ASSIGN_OR_RETURN(const std::vector<uint8_t> bytes, EncodeRecording(recording, encoding));
    std::vector<uint8_t> copy(bytes.size());
    DecodedEvents decoded;
    SpeedRow row = Row("decode", recording);
    row.what = std::string(EncodingName(encoding));
    row.num_bytes = bytes.size();
    double copy_s = std::numeric_limits<double>::infinity();
    for (int i = 0; i < options_.num_repetitions; ++i) {
      copy_s = std::min(copy_s, ProcessorSecondsOf([&] { std::memcpy(copy.data(), bytes.data(), bytes.size()); }));
      EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventDecoder> decoder,
                              MakeEventDecoder(encoding, recording.geometry));
      const absl::Span<const uint8_t> all = bytes;
      row.seconds = std::min(row.seconds, ProcessorSecondsOf([&] {
                               for (size_t begin = 0; begin < all.size(); begin += kPieceBytes) {
                                 decoded.events.clear();
                                 decoded.time_marks.clear();
                                 decoder->Decode(all.subspan(begin, kPieceBytes), decoded);
                               }
                             }));
      if (decoder->counts().cd_events != recording.events.size()) {
        return absl::InternalError(absl::StrCat("decode: ", row.what, " gives ", decoder->counts().cd_events,
                                                " events and not ", recording.events.size()));
      }
    }
    row.memcpy_ratio = row.seconds / copy_s;
    on_row_(row);
    return absl::OkStatus();
  }

  absl::Status Windows(const SpeedRecording& recording) {
    SpeedRow row = Row("windows", recording);
    for (int i = 0; i < options_.num_repetitions; ++i) {
      EventWindower windower(WindowOptions(), recording.geometry);
      uint64_t num_events = 0;
      const auto on_window = [&](const EventWindow& window) { num_events += window.num_events; };
      row.seconds = std::min(row.seconds, ProcessorSecondsOf([&] {
                               windower.Add(recording.events, on_window);
                               windower.Finish(on_window);
                             }));
      if (num_events != recording.events.size()) return absl::InternalError("windows: events are missing");
    }
    on_row_(row);
    return absl::OkStatus();
  }

  // Measures with each of kCuts: `measure` processes the windows and lowers the row's time.
  absl::Status OnCutLines(const std::string& part, const SpeedRecording& recording,
                          const std::function<void(const SpeedWindows&, SpeedRow&)>& measure) {
    EVPOSE_ASSIGN_OR_RETURN(SpeedWindows made, MakeSpeedWindows(recording));
    const std::vector<SpeedWindow> whole = made.windows;
    SpeedRow first;
    for (const int num_pieces : kCuts) {
      made.windows = WithCutLines(whole, num_pieces);
      SpeedRow row = Row(part, recording);
      row.what = absl::StrCat("lines x", num_pieces);
      row.num_events = 0;
      row.num_windows = whole.size();
      row.sensor_seconds = 0.0;
      for (const SpeedWindow& window : made.windows) {
        row.num_events += window.num_events;
        row.num_window_lines += window.lines.size();
        row.sensor_seconds += 1e-6 * static_cast<double>(window.t_end_us - window.t_begin_us);
      }
      measure(made, row);
      if (first.num_windows == 0) first = row;
      row.lines_ratio = static_cast<double>(row.num_window_lines) / static_cast<double>(first.num_window_lines);
      row.cost_ratio = row.seconds / first.seconds;
      on_row_(row);
    }
    return absl::OkStatus();
  }

  absl::Status Associate(const SpeedRecording& recording) {
    return OnCutLines("associate", recording, [this](const SpeedWindows& made, SpeedRow& row) {
      for (int i = 0; i < options_.num_repetitions; ++i) {
        WindowAssociation association(*made.context);
        row.seconds = std::min(row.seconds, ProcessorSecondsOf([&] {
                                 for (const SpeedWindow& window : made.windows) association.Associate(window);
                               }));
      }
    });
  }

  absl::Status Estimate(const SpeedRecording& recording) {
    return OnCutLines("estimate", recording, [this](const SpeedWindows& made, SpeedRow& row) {
      const std::vector<EstimationInput> inputs = MakeEstimationInputs(*made.context, made.windows);
      row.num_events = 0;
      for (const EstimationInput& window : inputs) row.num_events += window.events.size();
      for (int i = 0; i < options_.num_repetitions; ++i) {
        const auto estimator = made.context->options.MakeEstimator(made.context->camera);
        WindowFit fit;
        row.seconds = std::min(row.seconds, ProcessorSecondsOf([&] {
                                 for (const EstimationInput& window : inputs) {
                                   estimator->Fit(window.predicted, window.input, 1.0, fit);
                                   estimator->Accept(fit, window.input);
                                 }
                               }));
      }
    });
  }

  absl::Status Track(const SpeedRecording& recording) {
    SpeedRow row = Row("track", recording);
    row.num_lines = static_cast<int>(recording.model->lines.size());
    std::vector<PoseEstimate> poses;
    for (int i = 0; i < options_.num_repetitions; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(
          const std::unique_ptr<Tracker> tracker,
          Tracker::Create(recording.model, recording.camera, TrackerOptions(), recording.initial_camera_from_object));
      poses.clear();
      row.seconds = std::min(row.seconds, ProcessorSecondsOf([&] {
                               tracker->AddEvents(recording.events, poses);
                               tracker->Finish(poses);
                             }));
      row.num_poses = poses.size();
      if (poses.empty())
        return absl::InternalError(absl::StrCat("track: no pose of the scene of ", row.scene, " Mev/s"));
    }
    on_row_(row);
    return absl::OkStatus();
  }

  // All processing until the first pose, mainly the search.
  absl::Status Initialize(const SpeedRecording& recording) {
    SpeedRow row = Row("initialize", recording);
    std::vector<PoseEstimate> poses;
    for (int i = 0; i < options_.num_repetitions; ++i) {
      EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Tracker> tracker,
                              Tracker::Create(recording.model, recording.camera, TrackerOptions(), std::nullopt));
      // Events in one call: few, because the measured time ends with the call that returns the first pose.
      constexpr size_t kPieceEvents = 500;
      const absl::Span<const Event> events = recording.events;
      poses.clear();
      size_t begin = 0;
      const double seconds = ProcessorSecondsOf([&] {
        for (; begin < events.size() && poses.empty(); begin += kPieceEvents) {
          tracker->AddEvents(events.subspan(begin, kPieceEvents), poses);
        }
      });
      row.seconds = std::min(row.seconds, seconds);
      row.num_events = std::min(begin, events.size());
      row.num_poses = poses.size();
      row.sensor_seconds = 1e-6 * static_cast<double>(events[row.num_events - 1].t_us - events.front().t_us);
    }
    on_row_(row);
    return absl::OkStatus();
  }

  const SpeedBenchOptions& options_;
  const std::function<void(const SpeedRow&)>& on_row_;
  StepProgress progress_;
};

}  // namespace

const std::vector<std::string>& SpeedParts() {
  static const std::vector<std::string>* const parts =
      new std::vector<std::string>{"decode", "windows", "associate", "estimate", "track", "initialize"};
  return *parts;
}

absl::Status SpeedBenchOptions::Validate() const {
  for (const std::string& part : parts) {
    if (absl::c_linear_search(SpeedParts(), part)) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("parts: no part is called \"", part, "\"; known are: ", absl::StrJoin(SpeedParts(), ", ")));
  }
  EVPOSE_RETURN_IF_ERROR(CheckRange("duration_us", static_cast<double>(duration_us), 10'000, 10'000'000));
  return CheckRange("num_repetitions", num_repetitions, 1, 1000);
}

absl::Status RunSpeedBench(const SpeedBenchOptions& options, const std::function<void(const SpeedRow&)>& on_row,
                           const SpeedProgress& on_progress) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  return SpeedBench(options, on_row, on_progress).Run();
}

}  // namespace evpose
