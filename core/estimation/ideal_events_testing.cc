// SPDX-License-Identifier: Apache-2.0
#include "core/estimation/ideal_events_testing.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/contours/edge_elements.h"
#include "core/geometry/projected_line.h"
#include "core/models/visibility.h"
#include "core/numerics/random.h"

namespace evpose::testing {
namespace {

constexpr int64_t kStepUs = 50;  // at 10 000 px/s a line moves by half a pixel

bool FacesCamera(const ModelLine& line, const RigidTransform& pose) {
  for (const Eigen::Vector3d& normal : line.face_normals) {
    if ((pose.rotation * normal).dot(pose * line.p1) < 0.0) return true;
  }
  return line.face_normals.empty();
}

void AddPixel(const CameraModel& camera, const Eigen::Vector2d& pixel, int64_t t_us, uint8_t polarity,
              std::vector<Event>& events) {
  const double x = std::round(pixel.x());
  const double y = std::round(pixel.y());
  if (!(x >= 0 && y >= 0 && x < camera.width_px && y < camera.height_px)) return;
  events.push_back({t_us, static_cast<uint16_t>(x), static_cast<uint16_t>(y), polarity});
}

void AddLineEvents(const ModelLine& line, const CameraModel& camera, const Motion& motion,
                   const IdealEventOptions& options, double t_s, int64_t t_us, Random& random,
                   std::vector<Event>& events) {
  const RigidTransform pose = motion(t_s);
  if (!FacesCamera(line, pose)) return;
  const auto now = ProjectLine(camera, pose, line.p1, line.p2);
  constexpr double kAheadS = 1e-5;  // step of the difference quotient of the velocity
  const auto ahead = ProjectLine(camera, motion(t_s + kAheadS), line.p1, line.p2);
  if (!now || !ahead) return;
  const Eigen::Vector2d extent = now->p2_px - now->p1_px;
  const double length_px = extent.norm();
  const Eigen::Vector2d normal(-extent.y() / length_px, extent.x() / length_px);
  const Eigen::Vector2d v1 = (ahead->p1_px - now->p1_px) / kAheadS;
  const Eigen::Vector2d v2 = (ahead->p2_px - now->p2_px) / kAheadS;
  const double fastest = std::max(std::abs(normal.dot(v1)), std::abs(normal.dot(v2)));
  const uint32_t count = random.Poisson(options.events_per_px2 * length_px * fastest * kStepUs * 1e-6);
  for (uint32_t i = 0; i < count; ++i) {
    const double along = random.Uniform();
    const int64_t offset_us = static_cast<int64_t>(random.UniformInt(kStepUs));
    const Eigen::Vector2d velocity = v1 + along * (v2 - v1);
    if (random.Uniform() * fastest > std::abs(normal.dot(velocity))) continue;
    const Eigen::Vector2d pixel =
        now->p1_px + along * extent + velocity * (offset_us * 1e-6) + normal * (options.sigma_px * random.Normal());
    const auto polarity = static_cast<uint8_t>(random.UniformInt(2));
    if (options.is_hidden && options.is_hidden(pixel, t_s + static_cast<double>(offset_us) * 1e-6)) continue;
    AddPixel(camera, pixel, t_us + offset_us, polarity, events);
  }
}

// The curves and contours of a model, as straight lines without faces: the extractor has tested their visibility.
class CurvesAndContours {
 public:
  explicit CurvesAndContours(const ObjectModel& model)
      : model_(model),
        faces_(model.vertices, model.triangles),
        extractor_(model, faces_, {.sagitta_px = 0.02, .max_elements = 10'000}) {}

  bool empty() const { return !extractor_.has_curves(); }
  std::vector<ModelLine> At(const CameraModel& camera, const RigidTransform& pose) const {
    std::vector<EdgeElement> elements;
    constexpr int kFinest = 0;
    extractor_.Extract(camera, pose, kFinest, elements);
    std::vector<ModelLine> lines;
    for (const EdgeElement& element : elements) lines.push_back({element.p1, element.p2, {}});
    return lines;
  }

 private:
  const ObjectModel& model_;
  const TriangleBvh faces_;
  const EdgeElementExtractor extractor_;
};

}  // namespace

std::shared_ptr<const ObjectModel> MakeCube(double edge_m) {
  auto model = std::make_shared<ObjectModel>();
  const double h = edge_m / 2.0;
  for (int i = 0; i < 8; ++i) model->vertices.emplace_back(i & 1 ? h : -h, i & 2 ? h : -h, i & 4 ? h : -h);
  const std::array<std::array<uint32_t, 4>, 6> faces = {
      {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}}};
  for (const auto& face : faces) {
    model->triangles.push_back({face[0], face[1], face[2]});
    model->triangles.push_back({face[0], face[2], face[3]});
  }
  for (int i = 0; i < 8; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const int j = i | (1 << axis);
      if (j == i) continue;
      ModelLine line{model->vertices[i], model->vertices[j], {}};
      for (int other = 0; other < 3; ++other) {
        if (other == axis) continue;
        Eigen::Vector3d normal = Eigen::Vector3d::Zero();
        normal[other] = i & (1 << other) ? 1.0 : -1.0;
        line.face_normals.push_back(normal);
      }
      model->lines.push_back(line);
    }
  }
  model->diameter_m = edge_m * std::sqrt(3.0);
  return model;
}

std::function<bool(const Eigen::Vector2d& pixel, double t_s)> HiddenBehind(const ObjectModel& model,
                                                                           const CameraModel& camera, Motion motion) {
  auto tester = std::make_shared<const VisibilityTester>(model, VisibilityOptions());
  return [tester, camera, motion = std::move(motion)](const Eigen::Vector2d& pixel, double t_s) {
    constexpr double kFarM = 100.0;  // behind every object of a test
    const Eigen::Vector3d ray((pixel.x() - camera.cx_px) / camera.fx_px, (pixel.y() - camera.cy_px) / camera.fy_px,
                              1.0);
    const RigidTransform object_from_camera = motion(t_s).Inverse();
    return !tester->IsPointVisible(object_from_camera.translation_m, object_from_camera * (kFarM * ray));
  };
}

std::vector<Event> MergeEvents(const std::vector<std::vector<Event>>& streams) {
  std::vector<Event> merged;
  for (const std::vector<Event>& stream : streams) merged.insert(merged.end(), stream.begin(), stream.end());
  std::stable_sort(merged.begin(), merged.end(), [](const Event& a, const Event& b) { return a.t_us < b.t_us; });
  return merged;
}

CameraModel MakeCamera(int width_px, int height_px, double focal_px) {
  CameraModel camera;
  camera.width_px = width_px;
  camera.height_px = height_px;
  camera.fx_px = focal_px;
  camera.fy_px = focal_px;
  camera.cx_px = (width_px - 1) / 2.0;
  camera.cy_px = (height_px - 1) / 2.0;
  return camera;
}

Motion ConstantTwist(const RigidTransform& start, const Vector6d& twist) {
  return [start, twist](double t_s) { return Perturb(start, twist * t_s); };
}

RigidTransform MakePose(const Eigen::Vector3d& translation_m, const Eigen::Vector3d& rotation_rad) {
  return {ExpSo3(rotation_rad), translation_m};
}

SensorProfile UnbiasedSensor() {
  SensorProfile sensor;
  sensor.blur_px = 0.0;
  sensor.latency_us = 0.0;
  sensor.refractory_us = 0.0;
  sensor.uncertainty = 0.0;
  return sensor;
}

std::vector<Event> MakeIdealEvents(const ObjectModel& model, const CameraModel& camera, const Motion& motion,
                                   const IdealEventOptions& options) {
  // At 5 rad/s the view changes by 0.15 degrees meanwhile.
  constexpr int64_t kExtractUs = 500;
  Random random(options.seed);
  const CurvesAndContours curves(model);
  std::vector<ModelLine> elements;
  std::vector<Event> events;
  for (int64_t t_us = 0; t_us < options.duration_us; t_us += kStepUs) {
    const size_t first = events.size();
    const int64_t stamp_us = options.t_begin_us + t_us;
    for (const ModelLine& line : model.lines) {
      AddLineEvents(line, camera, motion, options, t_us * 1e-6, stamp_us, random, events);
    }
    if (!curves.empty() && t_us % kExtractUs == 0) elements = curves.At(camera, motion(t_us * 1e-6));
    for (const ModelLine& line : elements) {
      AddLineEvents(line, camera, motion, options, t_us * 1e-6, stamp_us, random, events);
    }
    const uint32_t clutter = random.Poisson(options.clutter_per_s * kStepUs * 1e-6);
    for (uint32_t i = 0; i < clutter; ++i) {
      const Eigen::Vector2d pixel{random.Uniform(0, camera.width_px - 1), random.Uniform(0, camera.height_px - 1)};
      const int64_t clutter_us = stamp_us + static_cast<int64_t>(random.UniformInt(kStepUs));
      AddPixel(camera, pixel, clutter_us, static_cast<uint8_t>(random.UniformInt(2)), events);
    }
    std::stable_sort(events.begin() + static_cast<std::ptrdiff_t>(first), events.end(),
                     [](const Event& a, const Event& b) { return a.t_us < b.t_us; });
  }
  return events;
}

}  // namespace evpose::testing
