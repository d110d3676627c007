// SPDX-License-Identifier: Apache-2.0

// The text at the beginning of AEDAT recordings (client/containers/aedat/README.md, section 1).
#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "core/events/event.h"

namespace evpose::client {

enum class AedatVersion { k2, k31, k4 };

// How the addresses of AEDAT 2.0 are to be read.
enum class Aedat2Layout { kUnknown, kDvs128, kDavis };

struct AedatHeader {
  AedatVersion version = AedatVersion::k2;
  std::string sensor;                            // as named; empty if the header names none
  Aedat2Layout layout = Aedat2Layout::kUnknown;  // AEDAT 2.0
  SensorGeometry geometry;                       // size of the named sensor; zero if it is not known
  size_t size_bytes = 0;                         // offset of the first byte of data
};

// Longest header, bytes; jAER writes all its settings there, 175 kB.
inline constexpr size_t kMaxAedatHeaderBytes = size_t{4} << 20;

// True if `prefix` begins with #!AER-DAT, the mark of all AEDAT recordings except those of version 1.0, which have
// none.
bool IsAedat(absl::string_view prefix);

// Parses the header at the start of `prefix`; nullopt if the header may continue beyond `prefix` and `is_whole_file` is
// false. For AEDAT 4.0 it ends after the first line. Errors: INVALID_ARGUMENT for a header that is incomplete or too
// long, another version, a sensor whose addresses are not known, or a format of packets other than RAW.
absl::StatusOr<std::optional<AedatHeader>> ParseAedatHeader(absl::string_view prefix, bool is_whole_file);

}  // namespace evpose::client
