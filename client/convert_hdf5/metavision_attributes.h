// SPDX-License-Identifier: Apache-2.0

// The attributes of the root of Metavision's files: strings.
#pragma once

#include <string>

#include "client/convert_hdf5/hdf5_handle.h"

namespace evpose::client {

inline constexpr char kVersionAttribute[] = "version";
inline constexpr char kGeometryAttribute[] = "geometry";  // "1280x720"
// The time at which Metavision's clock is 0, in microseconds: OpenEB subtracts it from all times if it is above 0.
inline constexpr char kTimeShiftAttribute[] = "time_shift";
// An attribute that only evpose writes: RecordingHeader::time_offset_us.
inline constexpr char kTimeOffsetAttribute[] = "evpose_time_offset_us";

// The value; empty if there is none, or if it is no string or one of more than 4 KiB.
std::string ReadTextAttribute(const Hdf5Handle& object, const char* name);
bool WriteTextAttribute(const Hdf5Handle& object, const char* name, const std::string& value);

}  // namespace evpose::client
