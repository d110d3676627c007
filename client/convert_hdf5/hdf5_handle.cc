// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/hdf5_handle.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

Hdf5Handle Compound(size_t size) { return {H5Tcreate(H5T_COMPOUND, size), H5Tclose}; }

// The first error of the stack is the innermost one.
herr_t TakeDescription(unsigned /*depth*/, const H5E_error2_t* error, void* text) {
  auto* const description = static_cast<std::string*>(text);
  if (description->empty() && error->desc != nullptr) *description = error->desc;
  return 0;
}

}  // namespace

Hdf5Handle CdRowType() {
  Hdf5Handle type = Compound(sizeof(CdRow));
  H5Tinsert(type.id(), "x", HOFFSET(CdRow, x), H5T_NATIVE_UINT16);
  H5Tinsert(type.id(), "y", HOFFSET(CdRow, y), H5T_NATIVE_UINT16);
  H5Tinsert(type.id(), "p", HOFFSET(CdRow, p), H5T_NATIVE_INT16);
  H5Tinsert(type.id(), "t", HOFFSET(CdRow, t), H5T_NATIVE_INT64);
  return type;
}

Hdf5Handle TriggerRowType() {
  Hdf5Handle type = Compound(sizeof(TriggerRow));
  H5Tinsert(type.id(), "p", HOFFSET(TriggerRow, p), H5T_NATIVE_INT16);
  H5Tinsert(type.id(), "t", HOFFSET(TriggerRow, t), H5T_NATIVE_INT64);
  H5Tinsert(type.id(), "id", HOFFSET(TriggerRow, id), H5T_NATIVE_INT16);
  return type;
}

Hdf5Handle IndexRowType() {
  Hdf5Handle type = Compound(sizeof(IndexRow));
  H5Tinsert(type.id(), "id", HOFFSET(IndexRow, id), H5T_NATIVE_UINT64);
  H5Tinsert(type.id(), "ts", HOFFSET(IndexRow, ts), H5T_NATIVE_INT64);
  return type;
}

void SetUpLibrary() {
  H5dont_atexit();
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
}

std::string LibraryError() {
  std::string description;
  H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, TakeDescription, &description);
  // The description of a system error also has the time, the file, addresses and sizes, in two lines. Only the error
  // message is kept.
  const std::string before = "error message = '";
  if (const size_t begin = description.find(before); begin != std::string::npos) {
    description = description.substr(begin + before.size());
    description.resize(std::min(description.size(), description.find('\'')));
  }
  return description.empty() ? "" : absl::StrCat(": ", description);
}

}  // namespace evpose::client
