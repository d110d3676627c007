// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/hdf5_column.h"

#include <algorithm>
#include <array>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "client/containers/hdf5/ecf_codec.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Bounds the memory. Known recordings have chunks of 16384 events, 256 KiB.
constexpr uint64_t kMaxChunkBytes = uint64_t{64} << 20;

// A file may state any number of rows, and skipping rows without a chunk could take years. Therefore about half of the
// chunks of the stated rows must be stored; files of recorders that crashed lack the last ones.
constexpr uint64_t kMaxMissingChunks = 64;

struct KnownFilter {
  H5Z_filter_t number;
  const char* advice;
};

// The numbers are registered with the HDF Group.
constexpr KnownFilter kKnownFilters[] = {
    {32001, "Blosc: install the Debian package hdf5-filter-plugin-blosc-serial"},
    {307, "bzip2: install the Debian package hdf5-filter-plugin"},
    {32004, "LZ4: install the Debian package hdf5-filter-plugin"},
    {32000, "LZF, which only h5py has: write the file again without compression"},
    {32015, "Zstandard, for which Debian has no package: write the file again without compression (h5repack -f NONE)"}};

std::string FilterAdvice(H5Z_filter_t filter) {
  for (const KnownFilter& known : kKnownFilters) {
    if (known.number == filter) return known.advice;
  }
  return absl::StrCat("number ", filter, ": write the file again without compression (h5repack -f NONE)");
}

}  // namespace

bool ToEvent(const CdRow& row, Event& event) {
  event = {row.t, row.x, row.y, static_cast<uint8_t>(row.p > 0 ? 1 : 0)};
  return row.t >= 0 && row.t <= kMaxStateTimeUs;
}

bool Hdf5Column::Exists(const Hdf5Handle& file, const std::string& path) {
  for (size_t end = path.find('/', 1);; end = path.find('/', end + 1)) {
    if (H5Lexists(file.id(), path.substr(0, end).c_str(), H5P_DEFAULT) <= 0) return false;
    if (end == std::string::npos) return H5Oexists_by_name(file.id(), path.c_str(), H5P_DEFAULT) > 0;
  }
}

absl::Status Hdf5Column::Error(const std::string& what) const {
  return absl::InvalidArgumentError(absl::StrCat("the dataset ", path_, " ", what));
}

absl::StatusOr<Hdf5Column> Hdf5Column::Open(const Hdf5Handle& file, const std::string& path,
                                            H5T_class_t element_class) {
  // The cache holds a chunk, so that it is decompressed once however few rows a call reads.
  const Hdf5Handle access(H5Pcreate(H5P_DATASET_ACCESS), H5Pclose);
  H5Pset_chunk_cache(access.id(), H5D_CHUNK_CACHE_NSLOTS_DEFAULT, kMaxChunkBytes, 1.0);
  Hdf5Column column(path, Hdf5Handle(H5Dopen2(file.id(), path.c_str(), access.id()), H5Dclose));
  if (!column.dataset_.ok()) return column.Error(absl::StrCat("cannot be opened", LibraryError()));
  EVPOSE_RETURN_IF_ERROR(column.CheckShape(element_class));
  const Hdf5Handle properties(H5Dget_create_plist(column.dataset_.id()), H5Pclose);
  EVPOSE_RETURN_IF_ERROR(column.CheckFilters(properties));
  EVPOSE_RETURN_IF_ERROR(column.CheckStorage(properties));
  return column;
}

absl::Status Hdf5Column::CheckShape(H5T_class_t element_class) {
  const Hdf5Handle space(H5Dget_space(dataset_.id()), H5Sclose);
  hsize_t size = 0;
  if (H5Sget_simple_extent_ndims(space.id()) != 1 || H5Sget_simple_extent_dims(space.id(), &size, nullptr) != 1) {
    return Error("does not have one dimension");
  }
  size_ = size;
  element_type_ = Hdf5Handle(H5Dget_type(dataset_.id()), H5Tclose);
  const H5T_class_t actual = H5Tget_class(element_type_.id());
  // A bool of h5py is an enumeration.
  if (actual == element_class || (element_class == H5T_INTEGER && actual == H5T_ENUM)) return absl::OkStatus();
  return Error(element_class == H5T_COMPOUND ? "does not have rows of several members" : "does not hold integers");
}

absl::Status Hdf5Column::CheckFilters(const Hdf5Handle& properties) {
  const int num_filters = H5Pget_nfilters(properties.id());
  for (int i = 0; i < num_filters; ++i) {
    unsigned flags = 0;
    size_t num_values = 0;
    const H5Z_filter_t filter =
        H5Pget_filter2(properties.id(), static_cast<unsigned>(i), &flags, &num_values, nullptr, 0, nullptr, nullptr);
    if (filter == static_cast<H5Z_filter_t>(kEcfFilter) && num_filters == 1) {
      hsize_t chunk_size = 0;
      if (H5Pget_chunk(properties.id(), 1, &chunk_size) != 1) return Error("has no chunks");
      ecf_chunk_size_ = chunk_size;
    } else if (filter < 0 || H5Zfilter_avail(filter) <= 0) {
      return Error(absl::StrCat("is compressed with ", FilterAdvice(filter)));
    }
  }
  return absl::OkStatus();
}

absl::Status Hdf5Column::CheckStorage(const Hdf5Handle& properties) {
  const uint64_t element_bytes = H5Tget_size(element_type_.id());
  hsize_t stored_rows = 0;
  if (H5Pget_layout(properties.id()) != H5D_CHUNKED) {
    stored_rows = H5Dget_storage_size(dataset_.id()) / std::max<uint64_t>(1, element_bytes);
  } else {
    hsize_t num_chunks = 0, chunk_size = 0;
    const Hdf5Handle space(H5Dget_space(dataset_.id()), H5Sclose);
    if (H5Pget_chunk(properties.id(), 1, &chunk_size) != 1 || chunk_size == 0 || element_bytes > kMaxChunkBytes ||
        chunk_size > kMaxChunkBytes / element_bytes) {
      return Error(absl::StrCat("has chunks of more than ", kMaxChunkBytes >> 20,
                                " MiB: write the file again with "
                                "smaller ones (h5repack -l CHUNK=16384)"));
    }
    if (size_ > 0 && H5Dget_num_chunks(dataset_.id(), space.id(), &num_chunks) < 0) {
      return Error(absl::StrCat("has a damaged index of its chunks", LibraryError()));
    }
    chunk_size_ = chunk_size;
    stored_rows = (2 * num_chunks + (num_chunks > 0 ? kMaxMissingChunks : 0)) * chunk_size;
  }
  if (size_ <= stored_rows) return absl::OkStatus();
  return Error(absl::StrCat("states ", size_, " rows, but the file does not hold them: it is damaged or incomplete"));
}

bool Hdf5Column::AreChunksStored(uint64_t begin, uint64_t count) const {
  if (chunk_size_ == 0) return true;
  for (hsize_t chunk = begin - begin % chunk_size_; chunk < begin + count; chunk += chunk_size_) {
    hsize_t bytes = 0;
    if (H5Dget_chunk_storage_size(dataset_.id(), &chunk, &bytes) < 0 || bytes == 0) return false;
  }
  return true;
}

bool Hdf5Column::Read(uint64_t begin, uint64_t count, const Hdf5Handle& type, void* rows) const {
  if (!AreChunksStored(begin, count)) return false;  // HDF5 would read zeros
  const hsize_t start = begin, length = count;
  const Hdf5Handle file_space(H5Dget_space(dataset_.id()), H5Sclose);
  const Hdf5Handle memory_space(H5Screate_simple(1, &length, nullptr), H5Sclose);
  return H5Sselect_hyperslab(file_space.id(), H5S_SELECT_SET, &start, nullptr, &length, nullptr) >= 0 &&
         H5Dread(dataset_.id(), type.id(), memory_space.id(), file_space.id(), H5P_DEFAULT, rows) >= 0;
}

void Hdf5Column::ReadEcfChunk(uint64_t begin, uint64_t count, std::vector<Event>& events) {
  const hsize_t offset = begin;
  hsize_t bytes = 0;
  uint32_t filters_left_out = 0;
  if (H5Dget_chunk_storage_size(dataset_.id(), &offset, &bytes) < 0 || bytes == 0 || bytes > kMaxChunkBytes) return;
  chunk_.resize(bytes);
  if (H5Dread_chunk(dataset_.id(), H5P_DEFAULT, &offset, &filters_left_out, chunk_.data()) < 0) return;
  if ((filters_left_out & 1) != 0) {
    AppendPlainChunk(count, events);
    return;
  }
  decoded_.clear();
  if (!DecodeEcfChunk(chunk_, decoded_).ok()) return;
  events.insert(events.end(), decoded_.begin(),
                decoded_.begin() + static_cast<int64_t>(std::min<uint64_t>(count, decoded_.size())));
}

void Hdf5Column::AppendPlainChunk(uint64_t count, std::vector<Event>& events) {
  const size_t row_bytes = H5Tget_size(element_type_.id());
  if (row_bytes == 0) return;
  count = std::min<uint64_t>(count, chunk_.size() / row_bytes);
  chunk_.resize(count * std::max(row_bytes, sizeof(CdRow)));  // the conversion takes place in it
  if (H5Tconvert(element_type_.id(), CdRowType().id(), count, chunk_.data(), nullptr, H5P_DEFAULT) < 0) return;
  for (size_t i = 0; i < count; ++i) {
    CdRow row;
    std::copy_n(chunk_.data() + i * sizeof(CdRow), sizeof(CdRow), reinterpret_cast<uint8_t*>(&row));
    Event event;
    if (ToEvent(row, event)) events.push_back(event);
  }
}

}  // namespace evpose::client
