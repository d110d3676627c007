// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/hdf5_reader.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/convert_hdf5/metavision_attributes.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr hsize_t kMaxListedNames = 8;  // in an error, so that it stays readable

std::string NamesInRoot(const Hdf5Handle& file) {
  std::vector<std::string> names;
  for (hsize_t i = 0; i < kMaxListedNames; ++i) {
    char name[64];
    if (H5Lget_name_by_idx(file.id(), "/", H5_INDEX_NAME, H5_ITER_INC, i, name, sizeof(name), H5P_DEFAULT) < 0) break;
    names.emplace_back(name);
  }
  return names.empty() ? "nothing" : absl::StrJoin(names, ", ");
}

absl::Status BeyondRange(const char* quantity, int64_t value_us) {
  return absl::InvalidArgumentError(
      absl::StrCat("states a ", quantity, " of ", value_us, " us, which is beyond the range of 36 thousand years"));
}

}  // namespace

absl::StatusOr<std::unique_ptr<Hdf5Reader>> Hdf5Reader::Open(const std::string& path) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<Hdf5Reader> reader, OpenShape(path));
  const int64_t shift_us = reader->header().metavision_zero_us;
  if (shift_us > kMaxStateTimeUs) return BeyondRange(kTimeShiftAttribute, shift_us);
  const int64_t offset_us = reader->header().time_offset_us;
  if (offset_us >= -kMaxStateTimeUs && offset_us <= kMaxStateTimeUs) return reader;
  return BeyondRange("time offset", offset_us);
}

absl::StatusOr<std::unique_ptr<Hdf5Reader>> Hdf5Reader::OpenShape(const std::string& path) {
  SetUpLibrary();
  EVPOSE_RETURN_IF_ERROR(CheckIsFile(path));
  Hdf5Handle file(H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
  if (!file.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("is no HDF5 file, or is damaged", LibraryError()));
  }
  if (Hdf5Column::Exists(file, "/CD/events")) return OpenMetavision(std::move(file));
  const char* const kColumns[] = {"/events/x", "/events/y", "/events/p", "/events/t"};
  const bool has_columns = std::all_of(std::begin(kColumns), std::end(kColumns),
                                       [&file](const char* column) { return Hdf5Column::Exists(file, column); });
  if (has_columns) return OpenDsec(std::move(file));
  return absl::InvalidArgumentError(
      absl::StrCat("has neither /CD/events (Metavision) nor /events/x, y, p and t (DSEC), but: ", NamesInRoot(file)));
}

}  // namespace evpose::client
