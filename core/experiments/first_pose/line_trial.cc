// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/first_pose/line_trial.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/experiments/first_pose/pose_determinacy.h"
#include "core/models/symmetry.h"
#include "core/numerics/random.h"
#include "core/simulation/objects.h"
#include "core/simulation/random_rotation.h"
#include "core/simulation/simulator.h"

namespace evpose {
namespace {

// Range of the distances of the object, relative to its size: it has some 200 to 340 px in the image of an EVK4.
constexpr double kMinDistanceOfSize = 3.0;
constexpr double kMaxDistanceOfSize = 5.0;
// Pixels between the object and the border of the image: noisy end points stay inside.
constexpr double kBorderPx = 5.0;
// Pixels: shorter visible parts are no segments. A line detector finds shorter ones in any scattered events.
constexpr double kMinSegmentPx = 12.0;
constexpr double kSpuriousMargin = 0.2;  // relative to the sides of the bounding box
// Lower bound of the noise for the determinacy: without noise every pose would be determined.
constexpr double kMinBoundNoisePx = 0.1;
// Lines that must be left of a pose: three may allow several poses. The number of draws bounds the time.
constexpr size_t kMinLinesLeft = 4;
constexpr int kMaxDraws = 100'000;

size_t NumLines(absl::Span<const VisibleSegment> visible) {
  std::set<int> lines;
  for (const VisibleSegment& segment : visible) lines.insert(segment.line);
  return lines.size();
}

class Generator : public LineTrialGenerator {
 public:
  Generator(const LineTrialOptions& options, ObjectModel model, double size_m)
      : options_(options),
        model_(std::move(model)),
        size_m_(size_m),
        camera_(UndistortedCamera()),
        // Visibility for the true pose: faces that are turned away are invisible.
        visibility_(model_, {.min_length_px = kMinSegmentPx, .grazing_cosine = 0.0}),
        determinacy_(model_, camera_, visibility_, std::max(options.noise_px, kMinBoundNoisePx)) {}

  const ObjectModel& model() const override { return model_; }
  const CameraModel& camera() const override { return camera_; }

  LineTrial Make(uint64_t seed) const override {
    Random random(seed);
    LineTrial trial;
    for (int draw = 0; draw < kMaxDraws && !DrawPose(random, trial); ++draw) {
    }
    AddObject(random, trial);
    AddSpurious(random, trial);
    Shuffle(random, trial);
    return trial;
  }

  // True if a twentieth of the maximum number of draws in Make() suffices to find a suitable pose.
  bool FindsPoses() const {
    Random random(0);
    LineTrial trial;
    for (int draw = 0; draw < kMaxDraws / 20; ++draw) {
      if (DrawPose(random, trial)) return true;
    }
    return false;
  }

 private:
  static CameraModel UndistortedCamera() {
    CameraModel camera = SimulationOptions::SimulatedEvk4Camera();
    camera.distortion = {};
    return camera;
  }

  bool IsWhollyInImage(const RigidTransform& pose) const {
    return std::all_of(model_.vertices.begin(), model_.vertices.end(), [&](const Eigen::Vector3d& vertex) {
      const Eigen::Vector2d pixel = camera_.Project(pose * vertex);
      return pixel.x() > kBorderPx && pixel.y() > kBorderPx && pixel.x() < camera_.width_px - kBorderPx &&
             pixel.y() < camera_.height_px - kBorderPx;
    });
  }

  bool DrawPose(Random& random, LineTrial& trial) const {
    const double depth_m = size_m_ * random.Uniform(kMinDistanceOfSize, kMaxDistanceOfSize);
    const double u = random.Uniform(0.0, camera_.width_px), v = random.Uniform(0.0, camera_.height_px);
    const Eigen::Matrix3d rotation = DrawRotation(random);
    const RigidTransform pose{rotation, depth_m * BearingOf(camera_, {u, v})};
    if (!IsWhollyInImage(pose)) return false;
    std::vector<VisibleSegment> visible = visibility_.VisibleSegments(camera_, pose);
    if (NumLines(visible) < kMinLinesLeft + static_cast<size_t>(options_.num_missing)) return false;
    if (!determinacy_.IsDetermined(pose, visible)) return false;
    trial.camera_from_object = pose;
    trial.visible = std::move(visible);
    return true;
  }

  Eigen::Vector2d Noise(Random& random) const {
    const double x = random.Normal(), y = random.Normal();
    return options_.noise_px * Eigen::Vector2d(x, y);
  }

  void AddObject(Random& random, LineTrial& trial) const {
    std::vector<int> lines;
    for (const VisibleSegment& segment : trial.visible) {
      if (lines.empty() || lines.back() != segment.line) lines.push_back(segment.line);
    }
    std::set<int> missing;
    while (missing.size() < static_cast<size_t>(options_.num_missing)) {
      missing.insert(lines[random.UniformInt(lines.size())]);
    }
    for (const VisibleSegment& part : trial.visible) {
      if (missing.count(part.line) != 0) continue;
      const ModelLine& line = model_.lines[part.line];
      const auto project = [&](double s) -> Eigen::Vector2d {
        return camera_.Project(trial.camera_from_object * (line.p1 + s * (line.p2 - line.p1))) + Noise(random);
      };
      const Eigen::Vector2d begin = project(part.begin);
      trial.segments.push_back({begin, project(part.end)});
      trial.model_line.push_back(part.line);
    }
  }

  void AddSpurious(Random& random, LineTrial& trial) const {
    const size_t num_real = trial.segments.size();
    Eigen::AlignedBox2d box;
    for (const ImageSegment& segment : trial.segments) box.extend(segment.p1_px).extend(segment.p2_px);
    const Eigen::Vector2d margin = kSpuriousMargin * box.sizes();
    for (int i = 0; i < options_.num_spurious; ++i) {
      const Eigen::Vector2d middle{random.Uniform(box.min().x() - margin.x(), box.max().x() + margin.x()),
                                   random.Uniform(box.min().y() - margin.y(), box.max().y() + margin.y())};
      const double half_px = 0.5 * trial.segments[random.UniformInt(num_real)].length_px();
      const double angle_rad = random.Uniform(0.0, 2.0 * M_PI);
      const Eigen::Vector2d half(half_px * std::cos(angle_rad), half_px * std::sin(angle_rad));
      trial.segments.push_back({middle - half, middle + half});
      trial.model_line.push_back(-1);
    }
  }

  static void Shuffle(Random& random, LineTrial& trial) {
    for (size_t i = trial.segments.size(); i > 1; --i) {
      const size_t j = random.UniformInt(i);
      std::swap(trial.segments[i - 1], trial.segments[j]);
      std::swap(trial.model_line[i - 1], trial.model_line[j]);
    }
    for (ImageSegment& segment : trial.segments) {
      if (random.UniformInt(2) == 1) std::swap(segment.p1_px, segment.p2_px);
    }
  }

  const LineTrialOptions options_;
  const ObjectModel model_;
  const double size_m_;
  const CameraModel camera_;
  const VisibilityTester visibility_;
  const PoseDeterminacy determinacy_;
};

}  // namespace

absl::Status LineTrialOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("LineTrialOptions.noise_px", noise_px, 0.0, 10.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("LineTrialOptions.num_spurious", num_spurious, 0, 100));
  return CheckRange("LineTrialOptions.num_missing", num_missing, 0, 20);
}

absl::StatusOr<std::unique_ptr<LineTrialGenerator>> LineTrialGenerator::Create(const LineTrialOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  const std::string name(SimulatedObjectName(options.object));
  EVPOSE_ASSIGN_OR_RETURN(const SimulationOptions preset, SimulationPreset(name));
  const double size_m = preset.scene.object_size_m;
  ObjectModel model = MakeSceneObject(options.object, size_m).model;
  model.symmetries = FindSymmetries(model);
  auto generator = std::make_unique<Generator>(options, std::move(model), size_m);
  if (!generator->FindsPoses()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "hardly any pose of the ", name, " is determined with ", options.num_missing, " lines missing and a noise of ",
        options.noise_px, " px; ask for fewer missing lines or less noise"));
  }
  return generator;
}

std::vector<LineMatch> TrueMatches(const LineTrialGenerator& trials, const LineTrial& trial) {
  std::vector<LineMatch> matches;
  for (size_t j = 0; j < trial.segments.size(); ++j) {
    if (trial.model_line[j] < 0) continue;
    const ModelLine& line = trials.model().lines[trial.model_line[j]];
    matches.push_back({line.p1, line.p2, trial.segments[j]});
  }
  return matches;
}

PoseError CompareWithTruth(const LineTrialGenerator& trials, const LineTrial& trial,
                           const RigidTransform& camera_from_object) {
  return ComparePoses(trials.model(), trials.camera(), trial.visible, trial.camera_from_object, camera_from_object);
}

}  // namespace evpose
