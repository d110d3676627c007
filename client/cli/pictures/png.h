// SPDX-License-Identifier: Apache-2.0

// Pictures as files.
#pragma once

#include <opencv2/core/mat.hpp>
#include <string>

#include "absl/status/statusor.h"

namespace evpose::client {

// The bytes of a PNG file. Error: INTERNAL if OpenCV cannot encode the image, for example one without pixels.
absl::StatusOr<std::string> EncodePng(const cv::Mat& image);

}  // namespace evpose::client
