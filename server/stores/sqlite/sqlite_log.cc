// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_log.h"

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <vector>

#include "absl/strings/str_cat.h"

namespace evpose::server {
namespace {

// Sizes of SQLite's format of the write-ahead log, and its largest page.
constexpr size_t kHeaderBytes = 32;
constexpr size_t kFrameHeaderBytes = 24;
constexpr uint32_t kLogMagic = 0x377f0682;  // with the lowest bit set: the words of the checksums are big-endian
constexpr uint32_t kMaxPageBytes = 65536;

uint32_t BigEndian(const uint8_t* bytes) {
  return uint32_t{bytes[0]} << 24 | uint32_t{bytes[1]} << 16 | uint32_t{bytes[2]} << 8 | bytes[3];
}

uint32_t LittleEndian(const uint8_t* bytes) {
  return uint32_t{bytes[3]} << 24 | uint32_t{bytes[2]} << 16 | uint32_t{bytes[1]} << 8 | bytes[0];
}

// The checksum of the log, which is cumulative: that of a frame covers all earlier frames.
struct Checksum {
  bool is_big_endian = false;
  uint32_t s0 = 0;
  uint32_t s1 = 0;

  void Add(const uint8_t* bytes, size_t size) {
    for (size_t i = 0; i + 8 <= size; i += 8) {
      s0 += (is_big_endian ? BigEndian(bytes + i) : LittleEndian(bytes + i)) + s1;
      s1 += (is_big_endian ? BigEndian(bytes + i + 4) : LittleEndian(bytes + i + 4)) + s0;
    }
  }
  bool Is(const uint8_t* bytes) const { return s0 == BigEndian(bytes) && s1 == BigEndian(bytes + 4); }
};

bool ReadBytes(std::ifstream& file, std::vector<uint8_t>& bytes) {
  file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  return static_cast<size_t>(file.gcount()) == bytes.size();
}

}  // namespace

std::string FindDamageOfSqliteLog(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::vector<uint8_t> header(kHeaderBytes);
  if (!file || !ReadBytes(file, header)) return "";  // there is no log, or it is empty
  Checksum checksum = {.is_big_endian = (BigEndian(header.data()) & 1) != 0};
  checksum.Add(header.data(), 24);
  const uint32_t page_bytes = BigEndian(header.data() + 8);
  if ((BigEndian(header.data()) & ~1u) != kLogMagic || !checksum.Is(header.data() + 24) || page_bytes == 0 ||
      page_bytes > kMaxPageBytes) {
    return absl::StrCat("the header of the log ", path, " is damaged: the last commits may be missing");
  }
  std::vector<uint8_t> frame(kFrameHeaderBytes + page_bytes);
  bool is_whole = true;
  int lost_commits = 0;
  while (ReadBytes(file, frame)) {
    // Behind the frames of this log there may be frames of an earlier one, which have another salt.
    const bool is_ours = std::equal(frame.begin() + 8, frame.begin() + 16, header.begin() + 16);
    if (is_ours && is_whole) {
      checksum.Add(frame.data(), 8);
      checksum.Add(frame.data() + kFrameHeaderBytes, page_bytes);
    }
    is_whole = is_whole && is_ours && checksum.Is(frame.data() + 16);
    const bool ends_transaction = BigEndian(frame.data() + 4) != 0;
    if (!is_whole && is_ours && ends_transaction) ++lost_commits;
  }
  if (lost_commits < 2) return "";
  return absl::StrCat("the log ", path, " is damaged in its middle: the last ", lost_commits,
                      " transactions are lost, and sessions are as they were before");
}

}  // namespace evpose::server
