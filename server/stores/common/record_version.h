// SPDX-License-Identifier: Apache-2.0

// What distinguishes the records of this version of the server from those of others (rules of compatibility:
// proto/evpose/storage/README.md). `evpose-server-next`, with which tests upgrade a cluster, is this server with
// next_version_testing.cc in the place of record_version.cc.
#pragma once

#include <cstdint>
#include <string>

#include "absl/strings/string_view.h"
#include "google/protobuf/message.h"

namespace evpose::server {

// Version of the output of Tracker::SaveState. Incremented with every change of its contents or their meaning.
extern const uint32_t kTrackerStateVersion;

// Version of what is derived from a model's file. Incremented with every change of core/models, core/mesh,
// core/contours or core/initialization that alters the result of ParseObjectModel() or MakeSearchViews().
extern const uint32_t kPreparationVersion;

// Has yield points (core/base/yield_point.h), because a record may have many megabytes.
std::string SerializeRecord(const google::protobuf::Message& record);
// Returns false if `bytes` are damaged; `record` must then not be used.
bool ParseRecord(absl::string_view bytes, google::protobuf::Message& record);

}  // namespace evpose::server
