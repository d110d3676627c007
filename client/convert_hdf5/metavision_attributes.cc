// SPDX-License-Identifier: Apache-2.0
#include "client/convert_hdf5/metavision_attributes.h"

#include <algorithm>
#include <cstring>

namespace evpose::client {
namespace {

constexpr size_t kMaxTextBytes = 4096;  // bounds memory; a longer attribute is ignored

Hdf5Handle TextType(size_t size) {
  Hdf5Handle type(H5Tcopy(H5T_C_S1), H5Tclose);
  H5Tset_size(type.id(), size);
  return type;
}

}  // namespace

std::string ReadTextAttribute(const Hdf5Handle& object, const char* name) {
  if (H5Aexists(object.id(), name) <= 0) return "";
  const Hdf5Handle attribute(H5Aopen(object.id(), name, H5P_DEFAULT), H5Aclose);
  const Hdf5Handle type(H5Aget_type(attribute.id()), H5Tclose);
  const Hdf5Handle space(H5Aget_space(attribute.id()), H5Sclose);
  if (H5Tget_class(type.id()) != H5T_STRING || H5Sget_simple_extent_npoints(space.id()) != 1) return "";
  if (H5Tis_variable_str(type.id()) > 0) {
    char* value = nullptr;
    const Hdf5Handle memory_type(H5Tget_native_type(type.id(), H5T_DIR_ASCEND), H5Tclose);
    if (H5Aread(attribute.id(), memory_type.id(), &value) < 0 || value == nullptr) return "";
    const size_t length = strnlen(value, kMaxTextBytes + 1);
    std::string text(value, length <= kMaxTextBytes ? length : 0);
    H5free_memory(value);
    return text;
  }
  const size_t size = H5Tget_size(type.id());
  if (size == 0 || size > kMaxTextBytes) return "";
  std::string text(size, '\0');
  if (H5Aread(attribute.id(), type.id(), text.data()) < 0) return "";
  text.resize(std::min(size, text.find('\0')));
  return text;
}

bool WriteTextAttribute(const Hdf5Handle& object, const char* name, const std::string& value) {
  const Hdf5Handle type = TextType(H5T_VARIABLE);
  const Hdf5Handle space(H5Screate(H5S_SCALAR), H5Sclose);
  const Hdf5Handle attribute(H5Acreate2(object.id(), name, type.id(), space.id(), H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
  const char* const text = value.c_str();
  return attribute.ok() && H5Awrite(attribute.id(), type.id(), &text) >= 0;
}

}  // namespace evpose::client
