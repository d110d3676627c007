// SPDX-License-Identifier: Apache-2.0

// Identifiers by which one session and its streams are found in the messages of clients and in the log and the metrics
// of servers, in the format of W3C Trace Context, level 1 (https://www.w3.org/TR/trace-context-1).
#pragma once

#include <optional>
#include <string>

#include "absl/strings/string_view.h"

namespace evpose {

// Key of the header, in the metadata of a gRPC call.
inline constexpr char kTraceparentKey[] = "traceparent";

struct TraceContext {
  std::string trace_id;  // of the session: 32 lower-case hexadecimal digits, not all 0
  std::string span_id;   // of the stream: 16 of them, not all 0

  friend bool operator==(const TraceContext&, const TraceContext&) = default;
};

// Returns the trace ID of a session, from its name: the first 32 hexadecimal digits of the SHA-256 of the name. Clients
// and servers compute it without exchanging or storing it. It is a digest, because the port with the metrics has no
// authentication, and must not reveal the names of sessions.
std::string TraceIdOf(absl::string_view session);

// Returns a new span ID from the machine's random source.
std::string NewSpanId();

// Returns the value of the header: version 00, sampled.
std::string Traceparent(const TraceContext& context);

// Returns the IDs in the value of a header; nullopt if it is malformed. Accepts later versions, as the standard
// demands.
std::optional<TraceContext> ParseTraceparent(absl::string_view header);

}  // namespace evpose
