// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/three_mf_archive.h"

#include <minizip/unzip.h>

#include <pugixml.hpp>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"

namespace evpose::client {
namespace {

// Uncompressed, all parts together; as kMaxModelFileBytes of scene_reader.h, and for the same reason.
constexpr size_t kMaxPartBytes = size_t{512} << 20;
constexpr int kNoCase = 2;  // of unzLocateFile()

constexpr absl::string_view kRelationships = "/_rels/.rels";
constexpr absl::string_view kStartType = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";

}  // namespace

absl::StatusOr<ThreeMfArchive> ThreeMfArchive::Open(const std::string& path) {
  void* const archive = unzOpen64(path.c_str());
  if (archive == nullptr) {
    return absl::InvalidArgumentError("is not a 3MF file: it is not an archive, or it is cut off");
  }
  return ThreeMfArchive(std::shared_ptr<void>(archive, [](void* opened) { unzClose(opened); }));
}

absl::StatusOr<std::string> ThreeMfArchive::OnlyModel() {
  std::string found;
  for (int status = unzGoToFirstFile(archive_.get()); status == UNZ_OK; status = unzGoToNextFile(archive_.get())) {
    char name[256] = {};
    unzGetCurrentFileInfo64(archive_.get(), nullptr, name, sizeof(name) - 1, nullptr, 0, nullptr, 0);
    if (!absl::EndsWithIgnoreCase(name, ".model")) continue;
    if (!found.empty()) {
      return absl::InvalidArgumentError(absl::StrCat("its archive has several .model files, and ", kRelationships,
                                                     " does not state which one has the build; export it again"));
    }
    found = absl::StrCat("/", name);
  }
  if (found.empty()) return absl::InvalidArgumentError("is not a 3MF file: its archive has no .model file");
  return found;
}

absl::StatusOr<std::string> ThreeMfArchive::StartPart() {
  const absl::StatusOr<std::string> text = Read(kRelationships);
  if (!text.ok()) return OnlyModel();
  pugi::xml_document document;
  document.load_buffer(text->data(), text->size());
  for (const pugi::xml_node& relationship : document.child("Relationships").children("Relationship")) {
    if (relationship.attribute("Type").as_string() != kStartType) continue;
    return absl::StrCat("/", absl::StripPrefix(relationship.attribute("Target").as_string(), "/"));
  }
  return OnlyModel();
}

absl::StatusOr<std::string> ThreeMfArchive::Read(absl::string_view part) {
  const std::string name(absl::StripPrefix(part, "/"));
  unz_file_info64 info;
  if (unzLocateFile(archive_.get(), name.c_str(), kNoCase) != UNZ_OK ||
      unzGetCurrentFileInfo64(archive_.get(), &info, nullptr, 0, nullptr, 0, nullptr, 0) != UNZ_OK) {
    return absl::InvalidArgumentError(absl::StrCat("its archive has no ", name));
  }
  if (info.uncompressed_size > kMaxPartBytes - read_bytes_) {
    return absl::InvalidArgumentError(
        absl::StrCat("its parts are too large: more than ", kMaxPartBytes >> 20, " MiB; simplify the model"));
  }
  std::string content(info.uncompressed_size, '\0');
  read_bytes_ += content.size();
  const bool is_open = unzOpenCurrentFile(archive_.get()) == UNZ_OK;
  const int size =
      is_open ? unzReadCurrentFile(archive_.get(), content.data(), static_cast<unsigned>(content.size())) : -1;
  if (size < 0 || static_cast<size_t>(size) != content.size() || unzCloseCurrentFile(archive_.get()) != UNZ_OK) {
    return absl::InvalidArgumentError(absl::StrCat(name, " in the archive cannot be read"));
  }
  return content;
}

}  // namespace evpose::client
