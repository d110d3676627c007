// SPDX-License-Identifier: Apache-2.0

// copy_sessions STORE DATA_DIR SESSION COUNT: copies a stored session under COUNT new names, to measure full stores.
// STORE as --store of evpose-server; DATA_DIR is used by "sqlite". The copies have the tenant of the session, and no
// request_id. No server may have opened the store in DATA_DIR.
#include <cstdio>
#include <cstdlib>
#include <future>
#include <string>

#include "absl/strings/numbers.h"
#include "core/base/status_macros.h"
#include "server/stores/open_store.h"
#include "tests/bench/stores/in_parallel.h"

namespace evpose::server {
namespace {

absl::Status Copy(Store& store, StoredSession session) {
  EVPOSE_ASSIGN_OR_RETURN(session.record.name, store.NewSessionName(session.record.tenant, /*request_id=*/""));
  session.record.request_id.clear();
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<SessionLease> lease,
                          store.CreateSession(session.record, session.lifecycle));
  if (session.checkpoint.empty() && session.poses.empty()) return absl::OkStatus();
  std::promise<absl::Status> done;
  lease->Commit({.checkpoint = std::move(session.checkpoint), .poses = std::move(session.poses)},
                [&done](absl::Status status) { done.set_value(std::move(status)); });
  return done.get_future().get();
}

absl::Status Run(const StoreOptions& options, const std::string& name, int count) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Store> store, OpenStore(options));
  EVPOSE_ASSIGN_OR_RETURN(const StoredSession session, store->ReadSession(name));
  return InParallel(static_cast<size_t>(count), [&](size_t) { return Copy(*store, session); });
}

}  // namespace
}  // namespace evpose::server

int main(int argc, char** argv) {
  int count = 0;
  if (argc != 5 || !absl::SimpleAtoi(argv[4], &count)) {
    std::fprintf(stderr, "usage: copy_sessions STORE DATA_DIR SESSION COUNT\n");
    return 2;
  }
  const absl::Status status = evpose::server::Run({.store = argv[1], .data_dir = argv[2]}, argv[3], count);
  if (status.ok()) return 0;
  std::fprintf(stderr, "copy_sessions: %s\n", status.ToString().c_str());
  return 1;
}
