// SPDX-License-Identifier: Apache-2.0

// A NumPy array in a file or in an archive, read piece by piece.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "client/containers/npy_header.h"

namespace evpose::client {

// Fills the span with the next bytes and returns their number; 0 at the end.
using ReadBytes = std::function<absl::StatusOr<size_t>(absl::Span<uint8_t>)>;

class NpyArray {
 public:
  // Reads the header. INVALID_ARGUMENT with `name` if it cannot be read.
  static absl::StatusOr<NpyArray> Open(const std::string& name, ReadBytes read);

  const NpyHeader& header() const { return header_; }

  // Replaces `items` by the next ones, at most `max_items`, and returns their number; 0 at the end, also of a truncated
  // array. Errors: those of ReadBytes, which at the end of the file may find that it is damaged.
  absl::StatusOr<size_t> Next(size_t max_items, std::vector<uint8_t>& items);

 private:
  NpyArray(NpyHeader header, std::string buffered, ReadBytes read)
      : header_(std::move(header)),
        buffered_(std::move(buffered)),
        read_(std::move(read)),
        num_left_(header_.num_items()) {}

  // Reads what follows the array, because a file is checked at its end.
  absl::Status ReadToEnd();

  NpyHeader header_;
  std::string buffered_;  // read together with the header
  ReadBytes read_;
  int64_t num_left_ = 0;  // items that the header announces and Next() has not returned
};

}  // namespace evpose::client
