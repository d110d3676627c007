// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/model_arguments.h"

#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/common/command.h"
#include "client/cli/console/wait_message.h"
#include "client/model_intake/model_intake.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"
#include "core/command_line/number_range.h"
#include "server/runtime/client_text.h"
#include "server/runtime/enum_number.h"

namespace evpose::client {
namespace {

constexpr char kSmooth[] = "smooth";
constexpr char kAsIs[] = "as-is";

}  // namespace

void ModelReadingArguments::AddTo(CLI::App& app, CLI::Option* model) {
  for (CLI::Option* const option :
       {AddOption(
            app, "--scale", metres_per_unit,
            "Metres per unit of the model file: 0.001 if it is in millimetres. A unit that the file itself states "
            "is applied first",
            AboveZero())
            ->type_name("FACTOR"),
        AddOption(
            app, "--crease-angle", crease_angle_deg,
            "Smallest angle between two faces of the model whose common side is an edge of the object. If the file "
            "states normals or is a STEP or IGES file, that angle is 10 degrees, unless this one is below 10 or "
            "above 30",
            NumberRange(0.1, 179.9))
            ->type_name("DEGREES"),
        AddOption(app, "--surface", surface,
                  "Whether the faces of the model approximate a smooth surface (smooth) or the object itself has them "
                  "(as-is), so that their sides may be edges below --crease-angle, too",
                  CLI::IsMember({kSmooth, kAsIs}))}) {
    option->group(kInputGroup);
    if (model != nullptr) option->needs(model);
  }
}

absl::StatusOr<ObjectModel> ModelReadingArguments::Load(const CliContext& context, const std::string& path) const {
  const WaitMessage message = WaitMessage::ForWork(context, absl::StrCat("reading ", path));
  return LoadSilently(path);
}

absl::StatusOr<ObjectModel> ModelReadingArguments::LoadSilently(const std::string& path) const {
  return LoadModelFile(
      path,
      {.metres_per_unit = metres_per_unit, .crease_angle_deg = crease_angle_deg, .is_smooth = surface == kSmooth});
}

absl::StatusOr<ModelUpload> ModelReadingArguments::ReadForUpload(const CliContext& context,
                                                                 const std::string& path) const {
  const WaitMessage message = WaitMessage::ForWork(context, absl::StrCat("reading ", path));
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

absl::StatusOr<ModelInfo> UploadModel(const CliContext& context, Client& client, const std::string& path,
                                      const ModelUpload& model) {
  const WaitMessage wait(context, absl::StrCat("the server to prepare ", path));
  absl::StatusOr<ModelInfo> info = client.UploadModel(AsBytes(model.bytes), model.options);
  if (!info.ok()) return ModelError(path, info.status());
  info->notices.insert(info->notices.begin(), model.notices.begin(), model.notices.end());
  return info;
}

}  // namespace evpose::client
