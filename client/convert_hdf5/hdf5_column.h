// SPDX-License-Identifier: Apache-2.0

// A dataset of one dimension in an untrusted file.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/convert_hdf5/hdf5_handle.h"
#include "core/events/event.h"

namespace evpose::client {

class Hdf5Column {
 public:
  // Whether the file has an object of this absolute path.
  static bool Exists(const Hdf5Handle& file, const std::string& path);

  // Opens the dataset. Errors have the path. INVALID_ARGUMENT: another number of dimensions or class of elements,
  // chunks that are too large, a length that differs from that of the stored chunks, or a filter that is missing (with
  // the package to install). The filter ECF is not needed.
  static absl::StatusOr<Hdf5Column> Open(const Hdf5Handle& file, const std::string& path, H5T_class_t element_class);

  uint64_t size() const { return size_; }

  // Reads rows as elements of `type`; false if they cannot be read or if a chunk of them is missing. Not for a column
  // with the filter ECF.
  bool Read(uint64_t begin, uint64_t count, const Hdf5Handle& type, void* rows) const;

  // The size of the chunks if the only filter is ECF; otherwise 0.
  uint64_t ecf_chunk_size() const { return ecf_chunk_size_; }
  // Appends up to `count` events of the chunk that begins at the row `begin`; fewer if the chunk has fewer or cannot be
  // read. Chunks that are stored without the filter are read, too.
  void ReadEcfChunk(uint64_t begin, uint64_t count, std::vector<Event>& events);

 private:
  Hdf5Column(std::string path, Hdf5Handle dataset) : path_(std::move(path)), dataset_(std::move(dataset)) {}
  absl::Status CheckShape(H5T_class_t element_class);
  absl::Status CheckFilters(const Hdf5Handle& properties);
  absl::Status CheckStorage(const Hdf5Handle& properties);
  absl::Status Error(const std::string& what) const;
  bool AreChunksStored(uint64_t begin, uint64_t count) const;
  void AppendPlainChunk(uint64_t count, std::vector<Event>& events);

  std::string path_;
  Hdf5Handle dataset_;
  Hdf5Handle element_type_;
  uint64_t size_ = 0;
  uint64_t chunk_size_ = 0;  // rows of a chunk; 0 without chunks
  uint64_t ecf_chunk_size_ = 0;
  std::vector<uint8_t> chunk_;
  EventVector decoded_;
};

// An event of a row; false if its time is out of range.
bool ToEvent(const CdRow& row, Event& event);

}  // namespace evpose::client
