// What the services share. Everything in it outlives them.
#pragma once

#include "server/rpc/stream_registry.h"
#include "server/sessions/model_registry.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/worker_pool.h"
#include "server/stores/store.h"

namespace evpose::server {

struct ServiceContext {
  Store& store;
  ModelRegistry& models;
  SessionManager& sessions;
  WorkerPool& pool;
  StreamRegistry& streams;
  uint64_t max_model_bytes;
};

}  // namespace evpose::server
