// SPDX-License-Identifier: Apache-2.0
#include "server/program/tenant_limits.h"

#include <algorithm>
#include <optional>

namespace evpose::server {
namespace {

template <typename Limit>
Limit HalfOf(Limit of_server) {
  return std::max<Limit>(of_server / 2, 1);
}

template <typename Limit>
void SetDefault(std::optional<Limit>& limit, Limit value) {
  if (!limit.has_value()) limit = value;
}

}  // namespace

bool HasTenants(const ServerOptions& options) { return !options.token_file.empty() || !options.tls.client_ca.empty(); }

ServerOptions::TenantLimits EffectiveTenantLimits(const ServerOptions& options) {
  ServerOptions::TenantLimits limits = options.tenant;
  if (!HasTenants(options)) return limits;
  SetDefault(limits.max_sessions, HalfOf(options.max_sessions));
  // Every model that the server admits must fit.
  SetDefault(limits.max_model_bytes, std::max(HalfOf(options.max_model_store_bytes), options.max_model_bytes));
  SetDefault(limits.max_session_memory, HalfOf(options.max_session_memory));
  SetDefault(limits.max_uploads, HalfOf(options.max_uploads));
  SetDefault(limits.max_streams, HalfOf(options.max_streams));
  SetDefault(limits.max_watchers, HalfOf(options.max_streams));
  SetDefault(limits.max_bytes_per_s, uint64_t{0});  // the server has no limit of bytes per second
  return limits;
}

}  // namespace evpose::server
