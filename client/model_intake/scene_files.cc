// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/scene_files.h"

#include <assimp/MemoryIOWrapper.h>

#include <cstdint>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/strip.h"

namespace evpose::client {
namespace {

// "my%20part.bin" -> "my part.bin"
std::string Decoded(absl::string_view uri) {
  std::string decoded;
  for (size_t i = 0; i < uri.size(); ++i) {
    const bool is_code = uri[i] == '%' && i + 2 < uri.size() && absl::ascii_isxdigit(uri[i + 1]) != 0 &&
                         absl::ascii_isxdigit(uri[i + 2]) != 0;
    if (!is_code) {
      decoded += uri[i];
      continue;
    }
    decoded += absl::HexStringToBytes(uri.substr(i + 1, 2));
    i += 2;
  }
  return decoded;
}

}  // namespace

std::filesystem::path FindSceneFile(const std::filesystem::path& directory, absl::string_view name) {
  const std::filesystem::path as_it_is = directory / std::string(name);
  const std::string decoded = Decoded(name);
  const std::filesystem::path with_slashes = absl::StrReplaceAll(decoded, {{"\\", "/"}});
  std::error_code error;
  for (const std::filesystem::path& path :
       {as_it_is, directory / decoded, directory / with_slashes, directory / with_slashes.filename()}) {
    if (std::filesystem::is_regular_file(path, error)) return path;
  }
  return as_it_is;
}

SceneFiles::SceneFiles(const std::string& path, absl::string_view contents)
    : path_(path),
      directory_(std::filesystem::path(path).parent_path()),
      contents_(absl::StripPrefix(contents, "\xEF\xBB\xBF")) {}

// Assimp prepends the folder of the scene to the names in it.
std::string SceneFiles::PathOf(absl::string_view name) const {
  absl::ConsumePrefix(&name, directory_.string());
  if (!directory_.empty()) absl::ConsumePrefix(&name, "/");
  return FindSceneFile(directory_, name).string();
}

bool SceneFiles::Exists(const char* name) const {
  return name == path_ || Assimp::DefaultIOSystem::Exists(PathOf(name).c_str());
}

Assimp::IOStream* SceneFiles::Open(const char* name, const char* mode) {
  if (name == path_) {
    return new Assimp::MemoryIOStream(reinterpret_cast<const uint8_t*>(contents_.data()), contents_.size());
  }
  return Assimp::DefaultIOSystem::Open(PathOf(name).c_str(), mode);
}

}  // namespace evpose::client
