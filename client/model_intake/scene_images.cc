// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/scene_images.h"

#include <assimp/material.h>
#include <assimp/texture.h>

#include <algorithm>
#include <cstdint>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "client/model_intake/scene_files.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kMaxImageBytes = size_t{256} << 20;  // of an encoded image; bounds memory
// Largest width and height at which edges are searched, pixels. An object that fills a sensor of 1280 pixels shows a
// texture of 4096 pixels at a third of its size.
constexpr int kMaxImageSidePx = 4096;

absl::StatusOr<cv::Mat> Decode(const void* bytes, size_t size) {
  const cv::Mat encoded(1, static_cast<int>(size), CV_8U, const_cast<void*>(bytes));
  const cv::Mat image = cv::imdecode(encoded, cv::IMREAD_GRAYSCALE);
  if (image.empty()) return absl::InvalidArgumentError("it cannot be decoded");
  return image;
}

absl::StatusOr<cv::Mat> DecodeEmbedded(const aiTexture& texture) {
  if (texture.mHeight == 0) return Decode(texture.pcData, texture.mWidth);  // compressed, mWidth bytes
  const cv::Mat texels(static_cast<int>(texture.mHeight), static_cast<int>(texture.mWidth), CV_8UC4, texture.pcData);
  cv::Mat image;
  cv::cvtColor(texels, image, cv::COLOR_BGRA2GRAY);  // aiTexel is b, g, r, a
  return image;
}

absl::StatusOr<cv::Mat> LoadImage(const aiScene& scene, const std::filesystem::path& directory,
                                  const std::string& name) {
  const aiTexture* const embedded = scene.GetEmbeddedTexture(name.c_str());
  if (embedded != nullptr) return DecodeEmbedded(*embedded);
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(FindSceneFile(directory, name).string(), kMaxImageBytes));
  return Decode(bytes.data(), bytes.size());
}

bool IsMoved(const aiMaterial& material, aiTextureType type) {
  aiUVTransform transform;
  if (material.Get(_AI_MATKEY_UVTRANSFORM_BASE, static_cast<unsigned>(type), 0, transform) != aiReturn_SUCCESS) {
    return false;
  }
  return transform.mTranslation != aiVector2D(0, 0) || transform.mScaling != aiVector2D(1, 1) ||
         transform.mRotation != 0;
}

}  // namespace

std::pair<int, unsigned> SceneImages::ImageOf(const aiMesh& mesh) {
  if (!are_read_ || mesh.mMaterialIndex >= scene_.mNumMaterials) return {-1, 0};
  const aiMaterial& material = *scene_.mMaterials[mesh.mMaterialIndex];
  for (const aiTextureType type : {aiTextureType_DIFFUSE, aiTextureType_BASE_COLOR}) {
    aiString name;
    unsigned channel = 0;
    if (material.GetTexture(type, 0, &name, nullptr, &channel) != aiReturn_SUCCESS || name.length == 0) continue;
    if (channel >= AI_MAX_NUMBER_OF_TEXTURECOORDS || !mesh.HasTextureCoords(channel)) return {-1, 0};
    const auto [found, is_new] = numbers_.try_emplace(name.C_Str(), -1);
    if (!is_new) return {found->second, channel};
    if (IsMoved(material, type)) {
      notices_.push_back(absl::StrCat("image ", name.C_Str(),
                                      ": its edges are not used, because its material moves it on the surface"));
    } else {
      found->second = Load(name.C_Str());
    }
    return {found->second, channel};
  }
  return {-1, 0};
}

int SceneImages::Load(const std::string& name) {
  absl::StatusOr<cv::Mat> image = LoadImage(scene_, directory_, name);
  if (!image.ok()) {
    notices_.push_back(absl::StrCat("image ", name, ": its edges are not used: ", image.status().message()));
    return -1;
  }
  const double scale = static_cast<double>(kMaxImageSidePx) / std::max(image->cols, image->rows);
  if (scale < 1.0) cv::resize(*image, *image, {}, scale, scale, cv::INTER_AREA);
  images_.push_back(*std::move(image));
  return static_cast<int>(images_.size()) - 1;
}

std::vector<cv::Mat> SceneImages::Take(std::vector<std::string>& notices) && {
  notices.insert(notices.end(), notices_.begin(), notices_.end());
  return std::move(images_);
}

}  // namespace evpose::client
