// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/connection_messages.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

// Time at the start of an outage in which every attempt is described; later, one line is printed in each kLaterEvery,
// so that a log of a long outage stays short.
constexpr absl::Duration kOftenAtFirst = absl::Seconds(15);
constexpr absl::Duration kLaterEvery = absl::Seconds(60);

std::string Seconds(absl::Duration duration) { return absl::StrFormat("%.1f s", absl::ToDoubleSeconds(duration)); }

// The IDs as the log of the server writes them.
std::string Names(const StreamTrace& trace) {
  if (trace.span_id.empty()) return "";  // no stream was begun yet
  return absl::StrCat("; trace_id=", trace.trace_id, " span_id=", trace.span_id);
}

}  // namespace

std::string ConnectionMessages::Describe(const ConnectionChange& change) {
  const std::string kept = absl::StrFormat("%.1f MB kept", static_cast<double>(change.kept_bytes) * 1e-6);
  if (!change.is_unreachable) {
    is_away_ = false;
    away_for_ += change.outage;
    return absl::StrCat(change.server, ": connected again after ", Seconds(change.outage), "; ", kept,
                        Names(change.trace));
  }
  const bool is_new = !is_away_;
  if (is_new) ++outages_;
  is_away_ = true;
  if (!is_new && change.outage > kOftenAtFirst && change.outage - described_at_ < kLaterEvery) return "";
  described_at_ = change.outage;
  std::string text = absl::StrCat("no connection for ", Seconds(change.outage));
  if (!change.cause.ok()) absl::StrAppend(&text, " (", change.cause.message(), ")");
  absl::StrAppend(&text, "; ", kept);
  if (change.source_waits) absl::StrAppend(&text, ", no room for more: the source waits");
  absl::StrAppend(&text, "; next try in ", Seconds(change.next_try_in), " at ", change.server);
  if (is_new) absl::StrAppend(&text, Names(change.trace));
  return text;
}

}  // namespace evpose::client
