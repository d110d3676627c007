// SPDX-License-Identifier: Apache-2.0
#include "client/diagnosis/tar_file.h"

#include <algorithm>
#include <cstring>
#include <optional>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kTarBlock = 512;

struct TarHeader {
  char name[100], mode[8], uid[8], gid[8], size[12], mtime[12], checksum[8], type, link[100], magic[6], version[2],
      owner[32], group[32], major[8], minor[8], prefix[155], rest[12];
};
static_assert(sizeof(TarHeader) == kTarBlock);
constexpr char kRegularFile = '0';
constexpr char kDirectory = '5';

// Returns the sum of the bytes of a header; the bytes of the sum itself count as blanks.
int64_t Checksum(TarHeader header) {
  std::memset(header.checksum, ' ', sizeof(header.checksum));
  int64_t sum = 0;
  for (size_t i = 0; i < kTarBlock; ++i) sum += reinterpret_cast<const unsigned char*>(&header)[i];
  return sum;
}

template <size_t kSize>
void PutText(char (&field)[kSize], std::string_view text) {
  std::copy_n(text.begin(), std::min(text.size(), kSize), field);
}

template <size_t kSize>
std::string TextOf(const char (&field)[kSize]) {
  return std::string(field, std::find(field, field + kSize, '\0'));
}

// Parses an octal number with blanks around it; nullopt if the field contains no such number.
template <size_t kSize>
std::optional<int64_t> NumberOf(const char (&field)[kSize]) {
  static_assert(kSize <= 12, "36 bits of octal digits");
  const std::string text(absl::StripAsciiWhitespace(TextOf(field)));
  if (text.empty()) return std::nullopt;
  int64_t number = 0;
  for (const char digit : text) {
    if (digit < '0' || digit > '7') return std::nullopt;
    number = 8 * number + (digit - '0');
  }
  return number;
}

bool IsSafeName(const std::string& name) {
  const auto is_allowed = [](char c) {
    return absl::ascii_isalnum(static_cast<unsigned char>(c)) || c == '.' || c == '_' || c == '-' || c == '/';
  };
  if (!std::all_of(name.begin(), name.end(), is_allowed)) return false;
  const std::vector<std::string> parts = absl::StrSplit(name, '/');
  return std::none_of(parts.begin(), parts.end(),
                      [](const std::string& part) { return part.empty() || part == "." || part == ".."; });
}

// Returns what is wrong with a header; empty for a valid header of a file or a directory.
std::string WhyRefused(const TarHeader& header, size_t rest_bytes) {
  if (std::memcmp(header.magic, "ustar", 5) != 0 || NumberOf(header.checksum) != Checksum(header)) {
    return "there is no header of a ustar archive";
  }
  const bool is_directory = header.type == kDirectory;
  const std::string text = TextOf(header.name);
  const std::string name(is_directory ? absl::StripSuffix(text, "/") : absl::string_view(text));
  if (header.prefix[0] != '\0' || !IsSafeName(name)) return "the name of a member is not a plain path in the archive";
  if (header.type != kRegularFile && !is_directory) return absl::StrCat(name, " is a link or another special member");
  const std::optional<int64_t> size = NumberOf(header.size);
  if (!size || (is_directory && *size != 0)) return absl::StrCat(name, " has an invalid size");
  const uint64_t padded = (static_cast<uint64_t>(*size) + kTarBlock - 1) / kTarBlock * kTarBlock;
  return padded > rest_bytes ? absl::StrCat("the archive ends within ", name) : "";
}

}  // namespace

absl::StatusOr<TarWriter> TarWriter::Create(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Create(path));
  return TarWriter(std::move(file));
}

void TarWriter::Add(const std::string& name, std::string_view contents) {
  if (name.size() >= sizeof(TarHeader::name) || contents.size() >= (size_t{1} << 33)) {
    status_.Update(
        absl::InvalidArgumentError(absl::StrCat(name, ": is too large for an archive, or its name too long")));
    return;
  }
  TarHeader header = {};
  PutText(header.name, name);
  PutText(header.mode, "0000644");
  PutText(header.uid, "0000000");
  PutText(header.gid, "0000000");
  PutText(header.size, absl::StrFormat("%011o", contents.size()));
  PutText(header.mtime, "00000000000");
  header.type = kRegularFile;
  PutText(header.magic, "ustar");
  PutText(header.version, "00");
  PutText(header.checksum, absl::StrFormat("%06o", Checksum(header)));
  header.checksum[7] = ' ';
  status_.Update(file_.Append({reinterpret_cast<const char*>(&header), kTarBlock}));
  status_.Update(file_.Append(contents));
  status_.Update(file_.Append(std::string((kTarBlock - contents.size() % kTarBlock) % kTarBlock, '\0')));
}

absl::Status TarWriter::Commit() {
  status_.Update(file_.Append(std::string(2 * kTarBlock, '\0')));
  EVPOSE_RETURN_IF_ERROR(status_);
  return file_.Commit();
}

absl::StatusOr<std::map<std::string, std::string>> ParseTar(std::string_view archive) {
  std::map<std::string, std::string> files;
  for (size_t offset = 0;;) {
    const auto error = [offset](const std::string& text) {
      return absl::InvalidArgumentError(
          absl::StrCat("byte ", offset, ": ", text, "; is it a complete archive of evpose doctor --bundle?"));
    };
    const std::string_view block = archive.substr(offset, kTarBlock);
    if (block.size() < kTarBlock) return error("the archive has no end mark");
    if (block.find_first_not_of('\0') == std::string_view::npos) return files;
    TarHeader header;
    std::memcpy(&header, block.data(), kTarBlock);
    const std::string refused = WhyRefused(header, archive.size() - offset - kTarBlock);
    if (!refused.empty()) return error(refused);
    const auto size = static_cast<size_t>(*NumberOf(header.size));
    const std::string name = TextOf(header.name);
    const std::string_view contents = archive.substr(offset + kTarBlock, size);
    if (header.type == kRegularFile && !files.emplace(name, contents).second) {
      return error(absl::StrCat(name, " occurs twice"));
    }
    offset += kTarBlock + (size + kTarBlock - 1) / kTarBlock * kTarBlock;
  }
}

absl::StatusOr<std::map<std::string, std::string>> ReadTar(const std::string& path, size_t max_bytes) {
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path, max_bytes));
  auto files = ParseTar(bytes);
  if (files.ok()) return files;
  return absl::Status(files.status().code(), absl::StrCat(path, ": ", files.status().message()));
}

}  // namespace evpose::client
