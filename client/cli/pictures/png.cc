// SPDX-License-Identifier: Apache-2.0
#include "client/cli/pictures/png.h"

#include <opencv2/imgcodecs.hpp>
#include <vector>

namespace evpose::client {

absl::StatusOr<std::string> EncodePng(const cv::Mat& image) {
  std::vector<uint8_t> png;
  if (image.empty() || !cv::imencode(".png", image, png)) {
    return absl::InternalError("the picture cannot be encoded as PNG");
  }
  return std::string(png.begin(), png.end());
}

}  // namespace evpose::client
