// SPDX-License-Identifier: Apache-2.0

// The files that a scene consists of: its own, and those that it names.
#pragma once

#include <assimp/DefaultIOSystem.h>

#include <filesystem>
#include <string>

#include "absl/strings/string_view.h"

namespace evpose::client {

// The path of the file `name` of a scene in `directory`. Exporters write names as URIs ("my%20part.bin"), with the
// backslashes of Windows, or with a folder that exists on another machine: the first of these readings whose file
// exists is returned, or `name` in `directory` if there is none.
std::filesystem::path FindSceneFile(const std::filesystem::path& directory, absl::string_view name);

// Opens the files of a scene for Assimp, which opens the names in a scene as they are.
class SceneFiles : public Assimp::DefaultIOSystem {
 public:
  // `contents` are those of the scene's own file, `path`, and must outlive this object. Its byte order mark, which some
  // readers of Assimp take for a part of the first word, is left out.
  SceneFiles(const std::string& path, absl::string_view contents);

  bool Exists(const char* name) const override;
  Assimp::IOStream* Open(const char* name, const char* mode) override;

 private:
  std::string PathOf(absl::string_view name) const;

  const std::string path_;
  const std::filesystem::path directory_;
  const absl::string_view contents_;
};

}  // namespace evpose::client
