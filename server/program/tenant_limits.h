// SPDX-License-Identifier: Apache-2.0

// Default limits of tenants.
#pragma once

#include "server/rpc/server.h"

namespace evpose::server {

// The limits of each tenant, with the defaults of those that are not given. With tokens or client certificates a server
// may have several tenants; then each has at most half of the server, so that no tenant can take all of it. Otherwise
// there is one tenant, and only the limits of the server apply. 0 means no own limit, also if it was given.
ServerOptions::TenantLimits EffectiveTenantLimits(const ServerOptions& options);

// True if callers have tenants: tokens or client certificates are required.
bool HasTenants(const ServerOptions& options);

}  // namespace evpose::server
