// SPDX-License-Identifier: Apache-2.0
#include "core/baselines/first_pose/lsd_detector.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"
#include "core/detection/event_grid.h"
#include "core/numerics/robust.h"

namespace evpose {
namespace {

// Tested speeds, as multiples of the speed of the stretch: the fit starts from the one that agrees with most events.
constexpr int kMaxSpeedSteps = 8;
constexpr double kSpeedStep = 0.25;
// Pixels: the scatter of the events about a segment. The fit of its motion is repeated, with weights from this scatter.
constexpr double kSigmaPx = 0.6;
constexpr int kPasses = 4;
// Two segments are sides of one streak if they overlap by more than this share of the shorter one and the sine of the
// angle between them is below this bound.
constexpr double kDuplicateOverlap = 0.5;
constexpr double kDuplicateSine = 0.06;

// An event's distance from a segment, and its time.
struct Distance {
  double y_px = 0.0;
  double tau_s = 0.0;
};

struct EdgeMotion {
  double offset_px = 0.0;
  double speed_px_per_s = 0.0;
  int num_events = 0;
  double rms_px = 0.0;
};

std::vector<ImageSegment> FindSegments(const EventStretch& stretch, const LsdDetectorOptions& options) {
  Eigen::AlignedBox2f box;
  for (const StretchEvent& event : stretch.events) box.extend(Eigen::Vector2f(event.u_px, event.v_px));
  const Eigen::Vector2f corner = box.min().array().floor() - 2.0f;
  const Eigen::Vector2f size = box.max() - corner;
  cv::Mat image = cv::Mat::zeros(static_cast<int>(size.y()) + 4, static_cast<int>(size.x()) + 4, CV_8UC1);
  const int step = 255 / options.white_events;
  for (const StretchEvent& event : stretch.events) {
    uint8_t& pixel = image.at<uint8_t>(static_cast<int>(std::lround(event.v_px - corner.y())),
                                       static_cast<int>(std::lround(event.u_px - corner.x())));
    pixel = static_cast<uint8_t>(std::min(255, pixel + step));
  }
  if (options.blur_px > 0.0) cv::GaussianBlur(image, image, cv::Size(), options.blur_px);
  std::vector<cv::Vec4f> found;
  cv::createLineSegmentDetector()->detect(image, found);
  std::vector<ImageSegment> segments;
  for (const cv::Vec4f& ends : found) {
    const Eigen::Vector2d p1(ends[0] + corner.x(), ends[1] + corner.y()),
        p2(ends[2] + corner.x(), ends[3] + corner.y());
    if ((p2 - p1).norm() >= options.min_length_px) segments.push_back({p1, p2});
  }
  std::stable_sort(segments.begin(), segments.end(),
                   [](const ImageSegment& a, const ImageSegment& b) { return a.length_px() > b.length_px(); });
  return segments;
}

class MotionMeter {
 public:
  MotionMeter(const EventStretch& stretch, const LsdDetectorOptions& options)
      : stretch_(stretch), options_(options), grid_(stretch.events) {}

  // Fits the distances of the events beside the segment against time, robustly; only events of the more frequent
  // polarity are used.
  std::optional<EdgeMotion> Measure(const ImageSegment& segment) {
    const Eigen::Vector2d along = (segment.p2_px - segment.p1_px) / segment.length_px();
    const double reach = options_.stretch.motion_px + options_.gate_px;
    indices_.clear();
    grid_.Near(segment.p1_px, segment.p2_px, reach, indices_);
    std::vector<Distance> distances[2];
    for (const int32_t index : indices_) {
      const StretchEvent& event = stretch_.events[index];
      const Eigen::Vector2d way = Eigen::Vector2d(event.u_px, event.v_px) - segment.p1_px;
      const double s = along.dot(way), y = along.x() * way.y() - along.y() * way.x();
      if (s < 0.0 || s > segment.length_px() || std::abs(y) > reach) continue;
      distances[event.polarity].push_back({y, event.tau_s});
    }
    const std::vector<Distance>& used = distances[distances[1].size() > distances[0].size()];
    if (used.size() < static_cast<size_t>(options_.min_events)) return std::nullopt;
    return Refined(used, BestStart(used));
  }

 private:
  // Returns the offset and the tested speed that agree with most events.
  EdgeMotion BestStart(const std::vector<Distance>& distances) const {
    EdgeMotion best;
    std::vector<double> rest(distances.size());
    for (int k = -kMaxSpeedSteps; k <= kMaxSpeedSteps; ++k) {
      const double speed = kSpeedStep * k * stretch_.time_scale_px_per_s;
      for (size_t i = 0; i < rest.size(); ++i) rest[i] = distances[i].y_px - speed * distances[i].tau_s;
      std::sort(rest.begin(), rest.end());
      size_t begin = 0;
      for (size_t end = 0; end < rest.size(); ++end) {
        while (rest[end] - rest[begin] > 2.0 * kSigmaPx) ++begin;
        const int count = static_cast<int>(end - begin + 1);
        if (count > best.num_events) best = {0.5 * (rest[begin] + rest[end]), speed, count, 0.0};
      }
    }
    return best;
  }

  std::optional<EdgeMotion> Refined(const std::vector<Distance>& distances, EdgeMotion motion) const {
    for (int pass = 0; pass < kPasses; ++pass) {
      double n = 1e-9, t = 0.0, tt = 0.0, y = 0.0, ty = 0.0;
      for (const Distance& distance : distances) {
        const double u =
            (distance.y_px - motion.offset_px - motion.speed_px_per_s * distance.tau_s) / (kTukeyEfficient * kSigmaPx);
        if (std::abs(u) >= 1.0) continue;
        const double weight = (1.0 - u * u) * (1.0 - u * u);
        n += weight;
        t += weight * distance.tau_s;
        tt += weight * distance.tau_s * distance.tau_s;
        y += weight * distance.y_px;
        ty += weight * distance.tau_s * distance.y_px;
      }
      const double spread = tt - t * t / n;
      if (spread > 1e-15) motion.speed_px_per_s = (ty - t * y / n) / spread;
      motion.offset_px = (y - motion.speed_px_per_s * t) / n;
    }
    double squares = 0.0;
    motion.num_events = 0;
    for (const Distance& distance : distances) {
      const double residual = distance.y_px - motion.offset_px - motion.speed_px_per_s * distance.tau_s;
      if (std::abs(residual) > options_.gate_px) continue;
      ++motion.num_events;
      squares += residual * residual;
    }
    if (motion.num_events < options_.min_events) return std::nullopt;
    motion.rms_px = std::sqrt(squares / motion.num_events);
    return motion;
  }

  const EventStretch& stretch_;
  const LsdDetectorOptions& options_;
  EventGrid grid_;
  std::vector<int32_t> indices_;
};

ImageSegment Shifted(const ImageSegment& segment, double distance_px) {
  const Eigen::Vector2d along = (segment.p2_px - segment.p1_px) / segment.length_px();
  const Eigen::Vector2d shift = distance_px * Eigen::Vector2d(-along.y(), along.x());
  return {segment.p1_px + shift, segment.p2_px + shift};
}

// Whether `other` lies along `line`, no longer than it.
bool IsDuplicate(const ImageSegment& line, const ImageSegment& other, double duplicate_px) {
  const Eigen::Vector2d along = (line.p2_px - line.p1_px) / line.length_px();
  const Eigen::Vector2d way = (other.p2_px - other.p1_px) / other.length_px();
  if (std::abs(along.x() * way.y() - along.y() * way.x()) > kDuplicateSine) return false;
  const Eigen::Vector2d middle = 0.5 * (other.p1_px + other.p2_px) - line.p1_px;
  if (std::abs(along.x() * middle.y() - along.y() * middle.x()) > duplicate_px) return false;
  const double s1 = along.dot(other.p1_px - line.p1_px), s2 = along.dot(other.p2_px - line.p1_px);
  const double overlap = std::min(std::max(s1, s2), line.length_px()) - std::max(std::min(s1, s2), 0.0);
  return overlap > kDuplicateOverlap * other.length_px();
}

class LsdLineDetector : public LineDetector {
 public:
  LsdLineDetector(const LsdDetectorOptions& options, SensorGeometry geometry)
      : options_(options), selector_(options.stretch, geometry.width_px, geometry.height_px) {}

  LineDetection Detect(absl::Span<const PixelEvent> events) override {
    const EventStretch stretch = selector_.Select(events);
    LineDetection detection = {stretch.t_begin_us, stretch.t_end_us, {}};
    if (stretch.events.empty()) return detection;
    try {
      detection.lines = Lines(stretch, FindSegments(stretch, options_));
    } catch (const cv::Exception&) {  // LSD has failed: no lines
      detection.lines.clear();
    }
    return detection;
  }

 private:
  std::vector<DetectedLine> Lines(const EventStretch& stretch, const std::vector<ImageSegment>& segments) const {
    MotionMeter meter(stretch, options_);
    std::vector<DetectedLine> lines;
    for (const ImageSegment& segment : segments) {
      const std::optional<EdgeMotion> motion = meter.Measure(segment);
      if (!motion) continue;
      const double sweep = motion->speed_px_per_s * stretch.half_duration_s();
      const DetectedLine line = {Shifted(segment, motion->offset_px - sweep),
                                 Shifted(segment, motion->offset_px + sweep), motion->speed_px_per_s,
                                 motion->num_events, motion->rms_px};
      const bool is_seen = std::any_of(lines.begin(), lines.end(), [&](const DetectedLine& longer) {
        return IsDuplicate(longer.at_end, line.at_end, options_.duplicate_px);
      });
      if (!is_seen) lines.push_back(line);
    }
    std::stable_sort(lines.begin(), lines.end(),
                     [](const DetectedLine& a, const DetectedLine& b) { return a.num_events > b.num_events; });
    return lines;
  }

  const LsdDetectorOptions options_;
  StretchSelector selector_;
};

}  // namespace

absl::Status LsdDetectorOptions::Validate() const {
  absl::Status status = stretch.Validate();
  status.Update(CheckRange("white_events", white_events, 1, 255));
  status.Update(CheckRange("blur_px", blur_px, 0.0, 20.0));
  status.Update(CheckRange("min_length_px", min_length_px, 1.0, 1e4));
  status.Update(CheckRange("min_events", min_events, 2, 1e6));
  status.Update(CheckRange("gate_px", gate_px, 0.5, 50.0));
  status.Update(CheckRange("duplicate_px", duplicate_px, 0.0, 50.0));
  return status;
}

absl::StatusOr<std::unique_ptr<LineDetector>> MakeLsdLineDetector(const LsdDetectorOptions& options,
                                                                  SensorGeometry geometry) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckSensor(geometry));
  return std::make_unique<LsdLineDetector>(options, geometry);
}

}  // namespace evpose
