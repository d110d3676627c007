// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/texture_edges.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "core/base/check_range.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Share of light that black paper returns; it keeps the contrast of dark pixels finite.
constexpr double kBlack = 0.02;
// Exponent of the encoding of images (IEC 61966-2-1).
constexpr double kGamma = 2.2;

// The natural logarithm of the light of each pixel.
cv::Mat LogLight(const cv::Mat& grey) {
  cv::Mat table(1, 256, CV_32F);
  for (int i = 0; i < 256; ++i) {
    table.at<float>(i) = static_cast<float>(std::log(std::pow(i / 255.0, kGamma) + kBlack));
  }
  cv::Mat light;
  cv::LUT(grey, table, light);
  return light;
}

struct Gradients {
  cv::Mat x, y, size;  // per pixel
};

Gradients GradientsOf(const cv::Mat& light) {
  Gradients gradients;
  cv::Sobel(light, gradients.x, CV_32F, 1, 0, 3, 0.125);
  cv::Sobel(light, gradients.y, CV_32F, 0, 1, 3, 0.125);
  cv::magnitude(gradients.x, gradients.y, gradients.size);
  return gradients;
}

constexpr int kNone = -1;

// A pixel at which the gradient is largest along its direction.
struct EdgePoint {
  Eigen::Vector2d position;
  Eigen::Vector2d gradient;
  int next = kNone;
  int previous = kNone;
};

// Links edge points to chains, with the brighter side always on the same side (Devernay, "A non-maxima suppression
// method for edge detection with sub-pixel accuracy", INRIA RR-2724, 1995).
class EdgeLinker {
 public:
  EdgeLinker(const cv::Mat& light, const cv::Mat& mask, double min_gradient)
      : gradients_(GradientsOf(light)), number_of_(light.size(), CV_32S, cv::Scalar(kNone)) {
    for (int y = 2; y < light.rows - 2; ++y) {
      for (int x = 2; x < light.cols - 2; ++x) {
        if (mask.at<uint8_t>(y, x) != 0 && gradients_.size.at<float>(y, x) > min_gradient) AddIfLargest(x, y);
      }
    }
    for (int i = 0; i < static_cast<int>(points_.size()); ++i) Link(i);
  }

  // Each chain once; a ring ends with its first point.
  std::vector<std::vector<int>> Chains() const {
    std::vector<std::vector<int>> chains;
    std::vector<bool> is_used(points_.size(), false);
    for (const bool takes_rings : {false, true}) {
      for (int first = 0; first < static_cast<int>(points_.size()); ++first) {
        const bool begins = points_[static_cast<size_t>(first)].previous == kNone;
        if (is_used[static_cast<size_t>(first)] || begins == takes_rings) continue;
        std::vector<int>& chain = chains.emplace_back();
        int i = first;
        for (; i != kNone && !is_used[static_cast<size_t>(i)]; i = points_[static_cast<size_t>(i)].next) {
          is_used[static_cast<size_t>(i)] = true;
          chain.push_back(i);
        }
        if (i == first) chain.push_back(first);
      }
    }
    return chains;
  }

  const EdgePoint& point(int i) const { return points_[static_cast<size_t>(i)]; }

 private:
  void AddIfLargest(int x, int y) {
    const Eigen::Vector2d gradient(gradients_.x.at<float>(y, x), gradients_.y.at<float>(y, x));
    const bool is_across_x = std::abs(gradient.x()) >= std::abs(gradient.y());
    const int dx = is_across_x ? 1 : 0, dy = is_across_x ? 0 : 1;
    const double before = gradients_.size.at<float>(y - dy, x - dx), here = gradients_.size.at<float>(y, x),
                 after = gradients_.size.at<float>(y + dy, x + dx);
    // If two pixels are equal, the second is taken.
    if (!(here >= before && here > after)) return;
    const double offset = 0.5 * (before - after) / (before - 2.0 * here + after);  // the top of a parabola
    number_of_.at<int>(y, x) = static_cast<int>(points_.size());
    points_.push_back({Eigen::Vector2d(x + offset * dx, y + offset * dy), gradient});
  }

  // The nearest point with a like gradient on the left of the gradient (sign 1) or on its right (-1); kNone if none.
  int Nearest(const EdgePoint& from, double sign) const {
    const Eigen::Vector2d along = sign * Eigen::Vector2d(-from.gradient.y(), from.gradient.x());
    const int x = static_cast<int>(std::lround(from.position.x())),
              y = static_cast<int>(std::lround(from.position.y()));
    int nearest = kNone;
    double nearest_px = 3.0;  // beyond the corner of the 5 x 5 pixels
    for (int v = std::max(0, y - 2); v <= std::min(number_of_.rows - 1, y + 2); ++v) {
      for (int u = std::max(0, x - 2); u <= std::min(number_of_.cols - 1, x + 2); ++u) {
        const int other = number_of_.at<int>(v, u);
        if (other == kNone) continue;
        const Eigen::Vector2d step = point(other).position - from.position;
        if (step.dot(along) <= 0.0 || point(other).gradient.dot(from.gradient) <= 0.0) continue;
        if (step.norm() >= nearest_px) continue;
        nearest = other;
        nearest_px = step.norm();
      }
    }
    return nearest;
  }

  // Two points are linked if each is the nearest of the other.
  void Link(int i) {
    const int next = Nearest(point(i), 1.0);
    if (next == kNone || Nearest(point(next), -1.0) != i) return;
    points_[static_cast<size_t>(i)].next = next;
    points_[static_cast<size_t>(next)].previous = i;
  }

  const Gradients gradients_;
  cv::Mat number_of_;  // number of the edge point of each pixel
  std::vector<EdgePoint> points_;
};

// The chain as chords.
std::vector<Eigen::Vector2d> Simplify(const std::vector<cv::Point2f>& chain, bool is_ring, double max_deviation_px) {
  std::vector<cv::Point2f> corners;
  cv::approxPolyDP(chain, corners, max_deviation_px, is_ring);
  if (is_ring && !corners.empty()) corners.push_back(corners.front());
  std::vector<Eigen::Vector2d> points;
  for (const cv::Point2f& corner : corners) points.push_back({corner.x, corner.y});
  return points;
}

}  // namespace

absl::Status TextureEdgeOptions::Validate() const {
  EVPOSE_RETURN_IF_ERROR(CheckRange("TextureEdgeOptions.min_contrast", min_contrast, 0.0, 10.0, OpenEnds::kLow));
  // The window of the filter grows with it.
  EVPOSE_RETURN_IF_ERROR(CheckRange("TextureEdgeOptions.smoothing_px", smoothing_px, 0.1, 20.0));
  EVPOSE_RETURN_IF_ERROR(CheckRange("TextureEdgeOptions.min_length_px", min_length_px, 0.0, 1e6));
  return CheckRange("TextureEdgeOptions.max_deviation_px", max_deviation_px, 0.01, 100.0);
}

std::vector<TextureEdge> FindTextureEdges(const cv::Mat& grey, const cv::Mat& mask, const TextureEdgeOptions& options) {
  cv::Mat light = LogLight(grey);
  cv::GaussianBlur(light, light, {}, options.smoothing_px, options.smoothing_px, cv::BORDER_REPLICATE);
  // A step of contrast C, smoothed with the standard deviation s, has the gradient C / (s sqrt(2 pi)). The Sobel filter
  // smooths by another 0.5 px^2 along the gradient and along the edge.
  const double contrast_per_gradient =
      std::sqrt(2.0 * std::numbers::pi * (options.smoothing_px * options.smoothing_px + 0.5));
  // Along an edge the contrast varies: its weak parts are kept if its mean suffices (hysteresis).
  const EdgeLinker linker(light, mask, 0.5 * options.min_contrast / contrast_per_gradient);
  std::vector<TextureEdge> edges;
  for (const std::vector<int>& chain : linker.Chains()) {
    std::vector<cv::Point2f> points;
    double length_px = 0.0, gradients = 0.0;
    for (const int i : chain) {
      const EdgePoint& point = linker.point(i);
      const cv::Point2f position(static_cast<float>(point.position.x()), static_cast<float>(point.position.y()));
      if (!points.empty()) length_px += cv::norm(position - points.back());
      points.push_back(position);
      gradients += point.gradient.norm();
    }
    const double contrast = contrast_per_gradient * gradients / static_cast<double>(chain.size());
    if (length_px < options.min_length_px || contrast < options.min_contrast) continue;
    const bool is_ring = chain.front() == chain.back();
    if (is_ring) points.pop_back();
    edges.push_back({Simplify(points, is_ring, options.max_deviation_px), contrast});
  }
  return edges;
}

}  // namespace evpose::client
