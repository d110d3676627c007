// SPDX-License-Identifier: Apache-2.0
#include "client/mcap/event_png.h"

#include <zlib.h>

#include <cstdint>
#include <string_view>

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

constexpr std::string_view kPngMagic = "\x89PNG\r\n\x1a\n";
// Red, green and blue of no event, ON, OFF and both, as evpose render draws them.
constexpr std::string_view kPalette("\x16\x18\x1c\x5a\xbe\xff\xeb\x5a\x50\xe6\xe6\xe6", 12);

std::string BigEndian(uint32_t value) {
  std::string bytes;
  for (int shift = 24; shift >= 0; shift -= 8) bytes.push_back(static_cast<char>(value >> shift));
  return bytes;
}

std::string PngChunk(std::string_view type, std::string_view content) {
  const std::string covered = absl::StrCat(std::string(type), std::string(content));
  const uLong crc = crc32_z(0, reinterpret_cast<const Bytef*>(covered.data()), covered.size());
  return absl::StrCat(BigEndian(static_cast<uint32_t>(content.size())), covered, BigEndian(static_cast<uint32_t>(crc)));
}

std::string Deflate(const std::string& bytes) {
  uLongf size = compressBound(bytes.size());
  std::string compressed(size, '\0');
  // Cannot fail: the buffer has the size of the worst case.
  compress2(reinterpret_cast<Bytef*>(compressed.data()), &size, reinterpret_cast<const Bytef*>(bytes.data()),
            bytes.size(), 1);
  compressed.resize(size);
  return compressed;
}

// The rows of the image, each after its filter: four pixels in a byte, the first in the highest bits.
std::string Rows(const EventImage& image, int width_px, int height_px) {
  constexpr char kNone = 0, kUp = 2;
  const auto row_bytes = static_cast<size_t>((width_px + 3) / 4);
  std::string rows;
  rows.reserve((row_bytes + 1) * static_cast<size_t>(height_px));
  for (int y = 0; y < height_px; ++y) {
    // The further rows of a cell are equal to the one above.
    const bool is_repeated = y % image.cell_px != 0;
    rows.push_back(is_repeated ? kUp : kNone);
    rows.append(row_bytes, '\0');
    if (is_repeated) continue;
    char* const row = rows.data() + rows.size() - row_bytes;
    for (int x = 0; x < width_px; ++x) {
      const int bits = image.CellAt(x / image.cell_px, y / image.cell_px) << (6 - 2 * (x % 4));
      row[x / 4] = static_cast<char>(row[x / 4] | bits);
    }
  }
  return rows;
}

}  // namespace

std::string EventImagePng(const EventImage& image, int width_px, int height_px) {
  constexpr std::string_view kTwoBitsWithPalette("\x02\x03\x00\x00\x00", 5);
  const std::string head = absl::StrCat(BigEndian(static_cast<uint32_t>(width_px)),
                                        BigEndian(static_cast<uint32_t>(height_px)), std::string(kTwoBitsWithPalette));
  return absl::StrCat(std::string(kPngMagic), PngChunk("IHDR", head), PngChunk("PLTE", kPalette),
                      PngChunk("IDAT", Deflate(Rows(image, width_px, height_px))), PngChunk("IEND", ""));
}

}  // namespace evpose::client
