// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>

#include "client/convert_hdf5/hdf5_reader.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// The number of a dataset without dimensions; 0 if there is none.
int64_t ReadNumber(const Hdf5Handle& file, const char* path) {
  if (!Hdf5Column::Exists(file, path)) return 0;
  const Hdf5Handle dataset(H5Dopen2(file.id(), path, H5P_DEFAULT), H5Dclose);
  const Hdf5Handle space(H5Dget_space(dataset.id()), H5Sclose);
  int64_t number = 0;
  if (!dataset.ok() || H5Sget_simple_extent_npoints(space.id()) != 1 ||
      H5Dread(dataset.id(), H5T_NATIVE_INT64, H5S_ALL, H5S_ALL, H5P_DEFAULT, &number) < 0) {
    return 0;
  }
  return number;
}

class DsecReader final : public Hdf5Reader {
 public:
  DsecReader(Hdf5Handle file, std::array<Hdf5Column, 4> columns)
      : file_(std::move(file)), columns_(std::move(columns)) {
    header_.format = "HDF5 (DSEC)";
    header_.time_offset_us = ReadNumber(file_, "/t_offset");
    uint64_t longest = 0;
    size_ = columns_[0].size();
    for (const Hdf5Column& column : columns_) {
      size_ = std::min(size_, column.size());
      longest = std::max(longest, column.size());
    }
    losses_.events = longest - size_;
  }

  bool Next(std::vector<Event>& events, std::vector<Trigger>& triggers) override {
    events.clear();
    triggers.clear();
    if (next_ == size_) return false;
    const uint64_t count = std::min(kMaxRows, size_ - next_);
    bool is_complete = true;
    for (size_t i = 0; i < columns_.size(); ++i) {
      numbers_[i].resize(count);
      is_complete = is_complete && columns_[i].Read(next_, count, type_, numbers_[i].data());
    }
    next_ += count;
    if (!is_complete) {
      losses_.events += count;
      return true;
    }
    for (size_t i = 0; i < count; ++i) {
      const auto [x, y, p, t] = std::array{numbers_[0][i], numbers_[1][i], numbers_[2][i], numbers_[3][i]};
      if (x < 0 || x > UINT16_MAX || y < 0 || y > UINT16_MAX || t < 0 || t > kMaxStateTimeUs) {
        ++losses_.invalid;
        continue;
      }
      events.push_back({t, static_cast<uint16_t>(x), static_cast<uint16_t>(y), static_cast<uint8_t>(p > 0 ? 1 : 0)});
    }
    return true;
  }

 private:
  const Hdf5Handle file_;
  const Hdf5Handle type_{H5Tcopy(H5T_NATIVE_INT64), H5Tclose};
  const std::array<Hdf5Column, 4> columns_;  // x, y, p, t
  std::array<std::vector<int64_t>, 4> numbers_;
  uint64_t size_ = 0;
  uint64_t next_ = 0;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Hdf5Reader>> OpenDsec(Hdf5Handle file) {
  EVPOSE_ASSIGN_OR_RETURN(Hdf5Column x, Hdf5Column::Open(file, "/events/x", H5T_INTEGER));
  EVPOSE_ASSIGN_OR_RETURN(Hdf5Column y, Hdf5Column::Open(file, "/events/y", H5T_INTEGER));
  EVPOSE_ASSIGN_OR_RETURN(Hdf5Column p, Hdf5Column::Open(file, "/events/p", H5T_INTEGER));
  EVPOSE_ASSIGN_OR_RETURN(Hdf5Column t, Hdf5Column::Open(file, "/events/t", H5T_INTEGER));
  return std::make_unique<DsecReader>(
      std::move(file), std::array<Hdf5Column, 4>{std::move(x), std::move(y), std::move(p), std::move(t)});
}

}  // namespace evpose::client
