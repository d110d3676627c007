// SPDX-License-Identifier: Apache-2.0
#include "client/containers/zip_entries.h"

#include <minizip/unzip.h>

#include <algorithm>
#include <limits>
#include <memory>

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

constexpr size_t kMaxEntries = 64;           // NumPy archives of events have at most a dozen
constexpr int kMaxListed = 10'000;           // entries that are looked at
constexpr size_t kMaxEntryNameBytes = 1024;  // a longer name, which no entry of an array has, is cut

std::shared_ptr<void> OpenArchive(const std::string& path) {
  void* const archive = unzOpen64(path.c_str());
  return archive == nullptr ? nullptr : std::shared_ptr<void>(archive, [](void* opened) { unzClose(opened); });
}

absl::Status DamagedArchive(const std::string& path) {
  return absl::InvalidArgumentError(absl::StrCat(path, ": is a damaged or truncated ZIP archive"));
}

}  // namespace

absl::StatusOr<std::vector<std::string>> ListZipEntries(const std::string& path, std::string_view suffix) {
  const std::shared_ptr<void> archive = OpenArchive(path);
  if (archive == nullptr) return DamagedArchive(path);
  std::vector<std::string> names;
  int result = unzGoToFirstFile(archive.get());
  for (int i = 0; result == UNZ_OK && i < kMaxListed && names.size() < kMaxEntries; ++i) {
    char name[kMaxEntryNameBytes] = {};
    result = unzGetCurrentFileInfo64(archive.get(), nullptr, name, sizeof(name) - 1, nullptr, 0, nullptr, 0);
    if (result != UNZ_OK) break;
    if (std::string_view(name).ends_with(suffix)) names.emplace_back(name);
    result = unzGoToNextFile(archive.get());
  }
  if (result != UNZ_OK && result != UNZ_END_OF_LIST_OF_FILE) return DamagedArchive(path);
  return names;
}

absl::StatusOr<ReadBytes> OpenZipEntry(const std::string& path, const std::string& name) {
  std::shared_ptr<void> archive = OpenArchive(path);
  const bool is_open = archive != nullptr && unzLocateFile(archive.get(), name.c_str(), 1) == UNZ_OK &&
                       unzOpenCurrentFile(archive.get()) == UNZ_OK;
  if (!is_open) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", name, " cannot be read: it is damaged, encrypted or neither stored nor deflated"));
  }
  return ReadBytes([archive, path, name,
                    is_at_end = std::make_shared<bool>(false)](absl::Span<uint8_t> buffer) -> absl::StatusOr<size_t> {
    if (*is_at_end || buffer.empty()) return 0;
    const auto size = std::min<size_t>(buffer.size(), std::numeric_limits<int>::max());
    const int num_read = unzReadCurrentFile(archive.get(), buffer.data(), static_cast<unsigned>(size));
    if (num_read > 0) return static_cast<size_t>(num_read);
    *is_at_end = true;
    // Closing an entry at its end compares its checksum.
    if (num_read == 0 && unzCloseCurrentFile(archive.get()) != UNZ_CRCERROR) return 0;
    return absl::DataLossError(absl::StrCat(
        path, ": ", name,
        " is damaged: ", num_read < 0 ? "it cannot be decompressed" : "its data do not have their checksum"));
  });
}

}  // namespace evpose::client
