// SPDX-License-Identifier: Apache-2.0

// Benchmark of model files: preparation, and tracking from the true pose on simulated recordings of the exact surface.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/experiments/tracking/tracking_score.h"
#include "core/models/object_model.h"
#include "core/tracking/object/pose_estimate.h"
#include "core/tracking/object/tracker_options.h"

namespace evpose {

struct BenchModel {
  std::string name;
  std::string path;              // the file that is prepared and tracked
  double metres_per_unit = 1.0;  // unit of that file
  // File in metres with the surface that is rendered, in the same object frame; empty: `path`.
  std::string reference_path;
};

// What is in the recordings besides the object.
enum class ModelBenchScene {
  kStandard,          // a background at rest; it is plain for odd seeds and textured for even ones
  kOccluder,          // the same background, and a bar that moves with the object and hides 35 % of its diameter
  kMovingBackground,  // a textured background that moves in the image, as it does if the camera is turned to and fro
};

// "standard", "occluder", "moving-background".
std::string_view ModelBenchSceneName(ModelBenchScene scene);
std::vector<std::string> ModelBenchSceneNames();
// Error: INVALID_ARGUMENT listing the known names.
absl::StatusOr<ModelBenchScene> ParseModelBenchScene(std::string_view name);

// The defaults are settings of the benchmark and not tuned.
struct ModelBenchOptions {
  std::vector<BenchModel> models;  // at least one
  int num_seeds = 3;  // [1, 1000]; seeds 1, 2, ... determine attitude, motion, background, pixels and noise
  ModelBenchScene scene = ModelBenchScene::kStandard;
  int64_t duration_us = 1'500'000;  // duration of a recording, microseconds
  double noise_ratio = 0.05;        // share of the events that are noise, as in the other benchmarks
  std::string camera = "evk4";      // name of a simulated camera
  // Directory of the recordings, with a subdirectory for each run, to use them again. Empty: none is stored.
  std::string recordings;
  TrackerOptions tracker;
  // Reads a model file; the client's loader reads more formats.
  std::function<absl::StatusOr<ObjectModel>(const std::string& path, const ModelOptions& options)> load_model =
      LoadObjectModel;

  // INVALID_ARGUMENT names the field.
  absl::Status Validate() const;
};

enum class ModelOutcome {
  kKept,  // a good pose was reported all the time, to the end
  kWeak,  // not, but before the first loss a direction that is no symmetry was known worse than 12 px
  kLost,
};

struct ModelRun {
  uint64_t seed = 0;
  double events_per_s = 0.0;
  ModelOutcome outcome = ModelOutcome::kLost;
  // Errors of the poses that are not weak (LargestSigmaPx() above 12); NaN without any. Errors are modulo the
  // symmetries.
  double position_rmse_of_depth = 0.0;
  double rotation_median_rad = 0.0;
  double rotation_p95_rad = 0.0;
  double longest_wrong_s = 0.0;       // as TrackingScore::longest_wrong_tracking_s, without the weak poses
  double longest_weak_wrong_s = 0.0;  // with them
  double weak_ratio = 0.0;            // share of the poses that are weak
  double compute_ratio = 0.0;         // processor time / sensor time
};

struct ModelBenchRow {
  BenchModel model;
  // Why the model cannot be tracked; empty if it can. Otherwise the following members are not set.
  std::string error;
  double preparation_s = 0.0;  // processor time from the file to the model
  double diameter_m = 0.0;
  size_t triangles = 0;  // number of triangles of the prepared model
  size_t lines = 0;      // straight edges
  size_t curves = 0;     // curved edges
  size_t regions = 0;    // number of regions of the smooth surface
  // "none", the number of rotations of a discrete symmetry, "axis", "sphere".
  std::string symmetry;
  double mean_elements = 0.0;  // visible lines and edge elements at poses of the first run
  std::vector<ModelRun> runs;  // by seed

  // Means over the runs: NaN if one of them has no pose. Maxima of the time with a wrong pose and of the processor
  // time.
  ModelRun summary;
  int num_kept = 0;
  int num_weak = 0;
  int worst_run = 0;  // index: lost before weak before kept, then the largest position error
};

// Called with the finished share of the work, in [0, 1], and a description of the present step; returning false ends
// the work with CANCELLED. May be null.
using ModelBenchProgress = std::function<bool(double done_ratio, const std::string& text)>;

// Runs the benchmark. The result is a function of the options and the files, except for the processor times. `on_row`
// is called after each model. A model that cannot be prepared has a row with the error. Errors: those of Validate() and
// of PlayRun(); a reference that cannot be read.
absl::Status RunModelBench(const ModelBenchOptions& options, const std::function<void(const ModelBenchRow&)>& on_row,
                           const ModelBenchProgress& on_progress = nullptr);

// Largest standard deviation, in pixels at the outline, of the motions of the object that are no continuous symmetry of
// it (core/experiments/README.md, section 3), from the covariance of a pose.
class OutlineUncertainty {
 public:
  // Keeps a reference to the model, which must outlive it.
  OutlineUncertainty(const ObjectModel& model, double focal_px);

  double LargestSigmaPx(const PoseEstimate& pose) const;

 private:
  const ObjectModel& model_;
  double focal_px_;
  Eigen::Vector3d centre_;  // centre of the box about the model, object frame
};

}  // namespace evpose
