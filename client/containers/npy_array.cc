// SPDX-License-Identifier: Apache-2.0
#include "client/containers/npy_array.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::client {

absl::StatusOr<NpyArray> NpyArray::Open(const std::string& name, ReadBytes read) {
  std::string prefix;
  while (true) {
    absl::StatusOr<std::optional<NpyHeader>> header = ParseNpyHeader(prefix);
    if (!header.ok()) return absl::InvalidArgumentError(absl::StrCat(name, ": ", header.status().message()));
    if (header->has_value()) {
      std::string buffered = prefix.substr((*header)->size_bytes);
      return NpyArray(*std::move(*header), std::move(buffered), std::move(read));
    }
    uint8_t piece[1024];
    EVPOSE_ASSIGN_OR_RETURN(const size_t size, read(absl::MakeSpan(piece)));
    if (size == 0) return absl::InvalidArgumentError(absl::StrCat(name, ": ends within the header of the NumPy array"));
    prefix.append(reinterpret_cast<const char*>(piece), size);
  }
}

absl::StatusOr<size_t> NpyArray::Next(size_t max_items, std::vector<uint8_t>& items) {
  const auto wanted = static_cast<size_t>(std::min<int64_t>(static_cast<int64_t>(max_items), num_left_));
  items.resize(wanted * header_.item_bytes);
  if (wanted == 0) EVPOSE_RETURN_IF_ERROR(ReadToEnd());
  size_t size = buffered_.copy(reinterpret_cast<char*>(items.data()), items.size());
  buffered_.erase(0, size);
  while (size < items.size()) {
    EVPOSE_ASSIGN_OR_RETURN(const size_t more, read_(absl::MakeSpan(items).subspan(size)));
    if (more == 0) break;
    size += more;
  }
  const size_t count = size / header_.item_bytes;
  num_left_ -= static_cast<int64_t>(count);
  return count;
}

absl::Status NpyArray::ReadToEnd() {
  uint8_t piece[1024];
  size_t size = 1;
  while (size > 0) {
    EVPOSE_ASSIGN_OR_RETURN(size, read_(absl::MakeSpan(piece)));
  }
  return absl::OkStatus();
}

}  // namespace evpose::client
