// SPDX-License-Identifier: Apache-2.0
#include "core/camera_files/camera_file.h"

#include <algorithm>
#include <cstddef>
#include <exception>
#include <new>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/types/span.h"
#include "core/base/output_file.h"
#include "core/base/quoted.h"
#include "core/base/status_macros.h"
#include "core/camera_files/camera_readers.h"
#include "core/camera_files/camera_tree.h"

namespace evpose {
namespace {

// Files have 500 bytes to 10 kB; calibrations with the points of all views a few hundred.
constexpr size_t kMaxFileBytes = 1 << 20;

absl::StatusOr<CameraFile> ReadTree(const CameraTree& tree, const std::string& file, const std::string& selection) {
  const CameraFields root(tree.root, file);
  if (IsKalibr(root)) return ReadKalibr(root, file, selection);
  if (IsRosMessage(root)) {
    EVPOSE_RETURN_IF_ERROR(CheckNotSelected(file, selection));
    return ReadRosMessage(root);
  }
  if (IsOpenCv(tree, root)) return ReadOpenCv(tree, root, file, selection);
  EVPOSE_RETURN_IF_ERROR(CheckNotSelected(file, selection));
  return ReadRosCameraInfo(root);
}

absl::StatusOr<CameraFile> Parse(const std::string& text, const std::string& file, const std::string& selection) {
  if (IsColmap(text)) return ReadColmap(text, file, selection);
  EVPOSE_ASSIGN_OR_RETURN(const CameraTree tree, ParseCameraTree(text, file));
  return ReadTree(tree, file, selection);
}

}  // namespace

absl::Status CheckNotSelected(const std::string& file, const std::string& selection) {
  if (selection.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(file, "#", selection, ": the file has one camera, without a name"));
}

absl::StatusOr<std::string> SelectCamera(const std::vector<std::string>& names, const std::string& file,
                                         const std::string& selection) {
  if (selection.empty() && names.size() == 1) return names.front();
  if (std::find(names.begin(), names.end(), selection) != names.end()) return selection;
  // A hostile file may have thousands.
  constexpr size_t kMaxListed = 20;
  const auto listed = absl::MakeConstSpan(names).first(std::min(names.size(), kMaxListed));
  const auto append = [](std::string* out, const std::string& name) { absl::StrAppend(out, Escaped(name)); };
  const std::string has =
      absl::StrCat("has the cameras ", absl::StrJoin(listed, ", ", append), names.size() > kMaxListed ? ", ..." : "");
  if (selection.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": ", has, "; select one, as ", file, "#", Escaped(names.front())));
  }
  return absl::InvalidArgumentError(absl::StrCat(file, "#", selection, ": the file ", has));
}

absl::StatusOr<CameraFile> ParseCameraFile(const std::string& text, const std::string& file,
                                           const std::string& selection) {
  if (text.size() > kMaxFileBytes) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s: larger than %d bytes; not a camera file", file, kMaxFileBytes));
  }
  absl::StatusOr<CameraFile> result;
  try {
    result = Parse(text, file, selection);
  } catch (const std::bad_alloc&) {
    throw;                             // memory is exhausted: no fault of the file
  } catch (const std::exception& e) {  // exceptions of yaml-cpp, for a tree whose nodes are not what their keys promise
    return absl::InvalidArgumentError(absl::StrCat(file, ": not a camera file: ", Escaped(e.what(), kMaxParserText)));
  }
  if (!result.ok()) return result;
  if (const absl::Status status = result->camera.Validate(); !status.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": ", status.message()));
  }
  return result;
}

namespace {

absl::StatusOr<std::string> ReadCameraText(const std::string& path) {
  absl::StatusOr<std::string> text = ReadFile(path, kMaxFileBytes);
  if (!absl::IsInvalidArgument(text.status())) return text;
  return absl::InvalidArgumentError(absl::StrCat(text.status().message(), "; not a camera file"));
}

}  // namespace

absl::StatusOr<CameraFile> ReadCameraFile(const std::string& path) {
  const size_t mark = path.rfind('#');
  if (mark == std::string::npos || mark == 0 || CheckIsFile(path).ok()) {
    EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadCameraText(path));
    return ParseCameraFile(text, path);
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::string text, ReadCameraText(path.substr(0, mark)));
  return ParseCameraFile(text, path.substr(0, mark), path.substr(mark + 1));
}

absl::StatusOr<CameraModel> LoadCameraModel(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(const CameraFile file, ReadCameraFile(path));
  return file.camera;
}

absl::StatusOr<CameraModel> ParseCameraModel(const std::string& text, const std::string& file) {
  EVPOSE_ASSIGN_OR_RETURN(const CameraFile parsed, ParseCameraFile(text, file));
  return parsed.camera;
}

}  // namespace evpose
