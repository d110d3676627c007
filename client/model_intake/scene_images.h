// SPDX-License-Identifier: Apache-2.0

// The images of a scene's materials.
#pragma once

#include <assimp/mesh.h>
#include <assimp/scene.h>

#include <filesystem>
#include <map>
#include <opencv2/core/mat.hpp>
#include <string>
#include <utility>
#include <vector>

namespace evpose::client {

// Decodes each image when a mesh first uses it.
class SceneImages {
 public:
  // `path` is the file of the scene; images that are not in it are beside it. `are_read`: false if no image can be
  // used. Keeps a reference to `scene`.
  SceneImages(const aiScene& scene, const std::string& path, bool are_read)
      : scene_(scene), directory_(std::filesystem::path(path).parent_path()), are_read_(are_read) {}

  // The number of the image that colours a mesh, and the channel of texture coordinates that belongs to it; -1 if there
  // is no image that can be used.
  std::pair<int, unsigned> ImageOf(const aiMesh& mesh);
  // The images in the order of their numbers. Appends why images are not used to `notices`.
  std::vector<cv::Mat> Take(std::vector<std::string>& notices) &&;

 private:
  int Load(const std::string& name);

  const aiScene& scene_;
  const std::filesystem::path directory_;
  const bool are_read_;
  std::map<std::string, int> numbers_;  // by name
  std::vector<cv::Mat> images_;
  std::vector<std::string> notices_;
};

}  // namespace evpose::client
