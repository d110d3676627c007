// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/model_arguments.h"

#include <filesystem>
#include <utility>

#include "client/cli/common/command.h"
#include "client/model_intake/model_intake.h"
#include "core/base/status_macros.h"
#include "server/runtime/client_text.h"
#include "server/runtime/enum_number.h"

namespace evpose::client {
namespace {

constexpr char kSmooth[] = "smooth";
constexpr char kAsIs[] = "as-is";

}  // namespace

void ModelReadingArguments::AddTo(CLI::App& app, CLI::Option* model) {
  for (CLI::Option* const option :
       {AddOption(app, "--scale", metres_per_unit,
                  "Metres per unit of the model file; 0.001 for mm. A unit that the file states is applied before",
                  AboveZero()),
        AddOption(app, "--crease-angle", crease_angle_deg,
                  "Least angle, degrees, by which the surface of the model turns at a crease", CLI::Range(0.1, 179.9)),
        AddOption(app, "--surface", surface,
                  "smooth: the facets of the model approximate a smooth surface; as-is: the object has these facets: "
                  "edges above --crease-angle are always edges of the object, the others where they form its outline",
                  CLI::IsMember({kSmooth, kAsIs}))}) {
    if (model != nullptr) option->needs(model);
  }
}

absl::StatusOr<ObjectModel> ModelReadingArguments::Load(const std::string& path) const {
  return LoadModelFile(
      path,
      {.metres_per_unit = metres_per_unit, .crease_angle_deg = crease_angle_deg, .is_smooth = surface == kSmooth});
}

absl::StatusOr<ModelUpload> ModelReadingArguments::ReadForUpload(const std::string& path) const {
  EVPOSE_ASSIGN_OR_RETURN(ModelFile file, ReadModelFile(path, metres_per_unit));
  std::string name = std::filesystem::path(path).filename().string();
  if (!server::IsPlainText(name)) name.clear();  // a server refuses it, and the model needs none
  return ModelUpload{.bytes = std::move(file.bytes),
                     .options = {.format = server::EnumNumber<ModelFormat>(file.format),
                                 .metres_per_unit = metres_per_unit,
                                 .crease_angle_deg = crease_angle_deg,
                                 .surface = surface == kSmooth ? ModelSurface::kSmooth : ModelSurface::kAsIs,
                                 .file_name = std::move(name)},
                     .notices = std::move(file.notices)};
}

absl::StatusOr<ModelInfo> UploadModel(Client& client, const std::string& path, const ModelUpload& model) {
  absl::StatusOr<ModelInfo> info =
      client.UploadModel({reinterpret_cast<const uint8_t*>(model.bytes.data()), model.bytes.size()}, model.options);
  if (!info.ok()) return ModelError(path, info.status());
  info->notices.insert(info->notices.begin(), model.notices.begin(), model.notices.end());
  return info;
}

}  // namespace evpose::client
