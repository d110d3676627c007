// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/hdf5_writer.h"

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "client/containers/hdf5/ecf_codec.h"
#include "client/convert_hdf5/metavision_attributes.h"
#include "core/base/status_macros.h"
#include "core/base/temporary_files.h"

namespace evpose::client {
namespace {

// The values of OpenEB's writer.
constexpr hsize_t kChunkRows = 16384;
constexpr int64_t kIndexPeriodUs = 2000;
constexpr char kFormatVersion[] = "1.0";

// The index has a row for each period, also of a gap: 43 million rows for a day.
constexpr int64_t kMaxGapUs = int64_t{24} * 3600 * 1000000;

Hdf5Handle MakeDataset(const Hdf5Handle& file, const std::string& path, const Hdf5Handle& type, bool is_compressed) {
  const hsize_t size = 0, max_size = H5S_UNLIMITED;
  const Hdf5Handle space(H5Screate_simple(1, &size, &max_size), H5Sclose);
  const Hdf5Handle properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
  H5Pset_chunk(properties.id(), 1, &kChunkRows);
  if (is_compressed) H5Pset_filter(properties.id(), kEcfFilter, H5Z_FLAG_OPTIONAL, 0, nullptr);
  return {H5Dcreate2(file.id(), path.c_str(), type.id(), space.id(), H5P_DEFAULT, properties.id(), H5P_DEFAULT),
          H5Dclose};
}

bool AppendRows(const Hdf5Handle& dataset, const Hdf5Handle& type, const void* rows, hsize_t count, uint64_t& size) {
  const hsize_t begin = size, new_size = size + count;
  if (H5Dset_extent(dataset.id(), &new_size) < 0) return false;
  const Hdf5Handle file_space(H5Dget_space(dataset.id()), H5Sclose);
  const Hdf5Handle memory_space(H5Screate_simple(1, &count, nullptr), H5Sclose);
  size = new_size;
  return H5Sselect_hyperslab(file_space.id(), H5S_SELECT_SET, &begin, nullptr, &count, nullptr) >= 0 &&
         H5Dwrite(dataset.id(), type.id(), memory_space.id(), file_space.id(), H5P_DEFAULT, rows) >= 0;
}

}  // namespace

bool PeriodIndex::Add(int64_t t_us, size_t max_rows, std::vector<IndexRow>& rows) {
  if (num_events_ == 0) first_us_ = t_us;
  const int64_t since_first_us = t_us - first_us_;
  for (; since_first_us >= num_rows_ * kIndexPeriodUs; ++num_rows_) {
    if (rows.size() >= max_rows) return false;
    if (num_events_ != current_.id) before_ = current_;
    rows.push_back(before_);
    current_ = {num_events_, since_first_us};
  }
  ++num_events_;
  return true;
}

void PeriodIndex::Finish(std::vector<IndexRow>& rows) const {
  if (num_events_ > 0) rows.push_back(current_);
}

absl::StatusOr<std::unique_ptr<Hdf5Writer>> Hdf5Writer::Create(const std::string& path, const PipeHeader& header) {
  SetUpLibrary();
  std::error_code error;
  if (std::filesystem::exists(path, error) && !std::filesystem::is_regular_file(path, error)) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": is not a regular file; HDF5 cannot be written to a stream"));
  }
  constexpr int kMaxSizePx = kEcfMaxCoordinatePx + 1;
  if (header.geometry.width_px > kMaxSizePx || header.geometry.height_px > kMaxSizePx) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ECF holds events of sensors of up to ", kMaxSizePx, "x",
                                                   kMaxSizePx, " pixels, not of ", header.geometry.width_px, "x",
                                                   header.geometry.height_px, "; write CSV or DAT"));
  }
  const std::string temporary_path = absl::StrCat(path, ".partial");
  RegisterTemporaryFile(temporary_path);
  Hdf5Handle file(H5Fcreate(temporary_path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT), H5Fclose);
  if (!file.ok()) {
    const absl::Status failed = absl::UnavailableError(absl::StrCat(path, ": cannot be created", LibraryError()));
    std::filesystem::remove(temporary_path, error);
    UnregisterTemporaryFile(temporary_path);
    return failed;
  }
  std::unique_ptr<Hdf5Writer> writer(new Hdf5Writer(path, temporary_path, std::move(file)));
  const std::string geometry = absl::StrCat(header.geometry.width_px, "x", header.geometry.height_px);
  const bool is_complete =
      WriteTextAttribute(writer->file_, kVersionAttribute, kFormatVersion) &&
      WriteTextAttribute(writer->file_, kGeometryAttribute, geometry) &&
      (header.time_offset_us == 0 ||
       WriteTextAttribute(writer->file_, kTimeOffsetAttribute, absl::StrCat(header.time_offset_us))) &&
      (header.metavision_zero_us <= 0 ||
       WriteTextAttribute(writer->file_, kTimeShiftAttribute, absl::StrCat(header.metavision_zero_us))) &&
      writer->MakeTable("/CD", writer->cd_type_, true, writer->cd_) &&
      writer->MakeTable("/EXT_TRIGGER", writer->trigger_type_, false, writer->triggers_);
  if (!is_complete) return writer->Fail();
  return writer;
}

Hdf5Writer::~Hdf5Writer() {
  if (phase_ == Phase::kClosed) return;
  // After a failed write, as on a full disk, closing would write again what the library has cached. HDF5 1.10 then ends
  // the process with SIGSEGV.
  if (phase_ == Phase::kFailed) {
    for (Hdf5Handle* const handle : {&cd_.rows, &cd_.indexes, &triggers_.rows, &triggers_.indexes, &file_}) {
      handle->Leak();
    }
  }
  cd_ = {};
  triggers_ = {};
  (void)file_.Close();
  std::error_code error;
  std::filesystem::remove(temporary_path_, error);
  UnregisterTemporaryFile(temporary_path_);
}

bool Hdf5Writer::MakeTable(const char* group, const Hdf5Handle& row_type, bool is_compressed, Table& table) {
  const Hdf5Handle made(H5Gcreate2(file_.id(), group, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT), H5Gclose);
  table.rows = MakeDataset(file_, absl::StrCat(group, "/events"), row_type, is_compressed);
  table.indexes = MakeDataset(file_, absl::StrCat(group, "/indexes"), index_type_, false);
  return made.ok() && table.rows.ok() && table.indexes.ok();
}

absl::Status Hdf5Writer::Fail() {
  phase_ = Phase::kFailed;
  return absl::UnavailableError(absl::StrCat(path_, ": cannot be written", LibraryError()));
}

absl::Status Hdf5Writer::AddIndex(int64_t t_us, Table& table) {
  if (table.last_us >= 0 && t_us - table.last_us > kMaxGapUs) {
    return absl::InvalidArgumentError(absl::StrCat(path_, ": between ", table.last_us, " us and ", t_us,
                                                   " us nothing happens for more than a day; convert the parts "
                                                   "before and after it with --start and --duration"));
  }
  table.last_us = t_us;
  while (!table.index.Add(t_us, kChunkRows, table.pending_indexes)) EVPOSE_RETURN_IF_ERROR(FlushIndexes(table));
  return absl::OkStatus();
}

absl::Status Hdf5Writer::FlushIndexes(Table& table) {
  const bool is_written = AppendRows(table.indexes, index_type_, table.pending_indexes.data(),
                                     table.pending_indexes.size(), table.num_indexes);
  table.pending_indexes.clear();
  return is_written ? absl::OkStatus() : Fail();
}

absl::Status Hdf5Writer::Write(absl::Span<const Event> events) {
  while (!events.empty()) {
    const auto part = events.first(std::min<size_t>(events.size(), kChunkRows - pending_events_.size()));
    events.remove_prefix(part.size());
    for (const Event& event : part) EVPOSE_RETURN_IF_ERROR(AddIndex(event.t_us, cd_));
    pending_events_.insert(pending_events_.end(), part.begin(), part.end());
    if (pending_events_.size() == kChunkRows) EVPOSE_RETURN_IF_ERROR(FlushEvents());
  }
  return absl::OkStatus();
}

absl::Status Hdf5Writer::FlushEvents() {
  chunk_.clear();
  const absl::Status encoded = EncodeEcfChunk(pending_events_, chunk_);
  if (!encoded.ok()) return absl::Status(encoded.code(), absl::StrCat(path_, ": ", encoded.message()));
  const hsize_t begin = cd_.num_rows;
  cd_.num_rows += pending_events_.size();
  const hsize_t size = cd_.num_rows;
  pending_events_.clear();
  const bool is_written = H5Dset_extent(cd_.rows.id(), &size) >= 0 &&
                          H5Dwrite_chunk(cd_.rows.id(), H5P_DEFAULT, 0, &begin, chunk_.size(), chunk_.data()) >= 0;
  return is_written ? absl::OkStatus() : Fail();
}

absl::Status Hdf5Writer::Write(absl::Span<const Trigger> triggers) {
  std::vector<TriggerRow> rows;
  for (const Trigger& trigger : triggers) {
    EVPOSE_RETURN_IF_ERROR(AddIndex(trigger.t_us, triggers_));
    rows.push_back({trigger.polarity, trigger.t_us, trigger.id});
  }
  const bool is_written =
      rows.empty() || AppendRows(triggers_.rows, trigger_type_, rows.data(), rows.size(), triggers_.num_rows);
  return is_written ? absl::OkStatus() : Fail();
}

absl::Status Hdf5Writer::Close() {
  if (!pending_events_.empty()) EVPOSE_RETURN_IF_ERROR(FlushEvents());
  for (Table* const table : {&cd_, &triggers_}) {
    table->index.Finish(table->pending_indexes);
    if (table->pending_indexes.empty()) continue;
    EVPOSE_RETURN_IF_ERROR(FlushIndexes(*table));
    const std::string offset = absl::StrCat(table->index.offset_us());
    if (!WriteTextAttribute(table->indexes, "offset", offset)) return Fail();
  }
  // All data are written before the first object is closed, because a failure can be handled only until then.
  if (H5Fflush(file_.id(), H5F_SCOPE_LOCAL) < 0) return Fail();
  bool is_written = true;
  for (Table* const table : {&cd_, &triggers_}) {
    is_written = table->rows.Close() && is_written;
    is_written = table->indexes.Close() && is_written;
  }
  if (!file_.Close() || !is_written) return Fail();
  std::error_code error;
  std::filesystem::rename(temporary_path_, path_, error);
  if (error) return absl::UnavailableError(absl::StrCat(path_, ": cannot be written: ", error.message()));
  UnregisterTemporaryFile(temporary_path_);
  phase_ = Phase::kClosed;
  return absl::OkStatus();
}

}  // namespace evpose::client
