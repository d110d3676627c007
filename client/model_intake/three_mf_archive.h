// SPDX-License-Identifier: Apache-2.0

// The archive of a 3MF file.
#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace evpose::client {

// Errors, INVALID_ARGUMENT without the path: damaged, too large, or no 3MF file.
class ThreeMfArchive {
 public:
  static absl::StatusOr<ThreeMfArchive> Open(const std::string& path);

  // The name of the part that has the build, from the root of the archive: "/3D/3dmodel.model".
  absl::StatusOr<std::string> StartPart();
  // The content of a part. Its name begins with a slash; upper and lower case are the same.
  absl::StatusOr<std::string> Read(absl::string_view part);

 private:
  explicit ThreeMfArchive(std::shared_ptr<void> archive) : archive_(std::move(archive)) {}

  // The name of the only part that ends in .model.
  absl::StatusOr<std::string> OnlyModel();

  std::shared_ptr<void> archive_;
  size_t read_bytes_ = 0;
};

}  // namespace evpose::client
