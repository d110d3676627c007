// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/impl/server_builder_option.h>
#include <grpcpp/resource_quota.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <mutex>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/auth/authenticator.h"
#include "server/auth/server_credentials.h"
#include "server/connections/connection_acceptor.h"
#include "server/connections/listen_address.h"
#include "server/models/model_registry.h"
#include "server/models/outdated_models.h"
#include "server/rpc/admin_service.h"
#include "server/rpc/common/service_context.h"
#include "server/rpc/common/stream_registry.h"
#include "server/rpc/model_service.h"
#include "server/rpc/server_impl.h"
#include "server/rpc/session_service.h"
#include "server/rpc/store_check.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"
#include "server/runtime/server_clock.h"
#include "server/runtime/worker_pool.h"
#include "server/scheduling/load_monitor.h"
#include "server/sessions/memory/memory_budget.h"
#include "server/sessions/session_manager.h"
#include "server/sessions/tracker_factory.h"
#include "server/stores/open_store.h"
#include "server/telemetry/log.h"
#include "server/telemetry/process_usage.h"
#include "server/telemetry/session_log.h"

namespace evpose::server {
namespace {

// Time for calls in progress; main() calls Shutdown() earlier, with the timeout of the drain.
constexpr absl::Duration kDestructorDeadline = absl::Seconds(1);
// Time after the deadline for the last status of a stream, and for calls in progress, such as an upload.
constexpr absl::Duration kCallGrace = absl::Milliseconds(500);
// Upper bound of the size of the other fields of a message with a chunk.
constexpr uint32_t kMessageOverheadBytes = 64 * 1024;

// Clients send a ping every 20 s, also without calls. The server tolerates pings at half that interval, and itself
// pings a silent client every 20 s: a connection that a network has dropped is noticed within this time, and before
// firewalls forget idle connections, which they do after some minutes.
constexpr int kMinPingIntervalMs = 10'000;
constexpr int kKeepaliveMs = 20'000;
// A connection that has not completed TLS and the beginning of HTTP/2 is closed after this time. A handshake needs a
// few round trips; connections that only occupy a descriptor end soon.
constexpr int kHandshakeTimeoutMs = 20'000;
// A connection without calls is closed after this time and leaves its place to others; gRPC clients reconnect.
constexpr int kMaxConnectionIdleMs = 300'000;

int NumWorkers(const ServerOptions& options) {
  if (options.worker_threads > 0) return options.worker_threads;
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

// Time after which open streams of a caller that is no longer admitted end, at most. Each check compares the version of
// the list of tokens for every stream.
constexpr absl::Duration kAccessCheckPeriod = absl::Seconds(1);

// Deletes expired sessions, so that they are deleted also when no client calls.
void DeleteOldSessions(SessionManager& sessions) {
  sessions.DeleteExpired();
  sessions.DeleteEnded();
  sessions.MaintainStore();
}

// Calls a function periodically.
class PeriodicTimer {
 public:
  PeriodicTimer(WorkerPool& pool, absl::Duration period, std::function<void()> work)
      : period_(period), work_(std::move(work)) {
    const std::lock_guard lock(mutex_);
    timer_ = pool.MakeTimer([this] { OnTimer(); });
    timer_->Arm(period_);
  }

  // No call starts after Stop().
  void Stop() {
    const std::lock_guard lock(mutex_);
    timer_.reset();
  }

 private:
  void OnTimer() {
    RunUnlessOutOfMemory(work_);
    const std::lock_guard lock(mutex_);
    if (timer_ != nullptr) timer_->Arm(period_);
  }

  const absl::Duration period_;
  const std::function<void()> work_;
  std::mutex mutex_;
  std::unique_ptr<ReusableTimer> timer_ ABSL_GUARDED_BY(mutex_);  // null after Stop()
};

// A limit of each tenant; 0 or absent: only the limit of the server applies.
template <typename Limit>
Limit TenantLimit(const std::optional<Limit>& of_tenant, Limit of_server) {
  return of_tenant.value_or(0) == 0 ? of_server : *of_tenant;
}

SessionManager::Options ManagerOptions(const ServerOptions& options, TrackerFactory make_tracker, const Store& store,
                                       std::shared_ptr<ServerMetrics> metrics, const LoadMonitor& load) {
  const uint64_t tenant_memory = TenantLimit(options.tenant.max_session_memory, options.max_session_memory);
  const auto memory = MemoryBudget::Create(
      {.max_bytes = options.max_session_memory, .max_tenant_bytes = tenant_memory, .metrics = metrics});
  return {.max_sessions = options.max_sessions,
          .max_tenant_sessions = TenantLimit(options.tenant.max_sessions, options.max_sessions),
          .limits = {.credit_bytes = options.credit_bytes,
                     .max_chunk_bytes = options.max_chunk_bytes,
                     .pose_log_capacity = options.pose_log_capacity,
                     .pose_log_bytes = options.pose_log_bytes,
                     .expiry = options.session_expiry,
                     .writes_checkpoints = store.outlives_process(),
                     .log_limiter = SessionLog::MakeLimiter()},
          .make_tracker = std::move(make_tracker),
          .shares_store = store.is_shared(),
          .load = &load,
          .now = MakeServerClock(),
          .metrics = std::move(metrics),
          .memory = memory};
}

// Enables server reflection only if the server has no authentication: reflection is a service of gRPC without
// authentication, and each of its streams occupies a thread. Its contents, the definitions in proto/, are public.
class ReflectionOption : public grpc::ServerBuilderOption {
 public:
  explicit ReflectionOption(bool is_on) : is_on_(is_on) {}
  void UpdateArguments(grpc::ChannelArguments*) override {}
  void UpdatePlugins(std::vector<std::unique_ptr<grpc::ServerBuilderPlugin>>* plugins) override {
    // When linked, the reflection plugin adds itself to every server.
    const std::string name = grpc::reflection::ProtoServerReflectionPlugin().name();
    if (!is_on_) std::erase_if(*plugins, [&name](const auto& plugin) { return plugin->name() == name; });
  }

 private:
  const bool is_on_;
};

// Authentication and transport security of the server.
struct Access {
  std::unique_ptr<Authenticator> authenticator;
  std::shared_ptr<grpc::ServerCredentials> credentials;
};

absl::StatusOr<Access> MakeAccess(const ServerOptions& options, const std::shared_ptr<ServerMetrics>& metrics) {
  Access access;
  const bool has_client_certificates = !options.tls.client_ca.empty();
  EVPOSE_ASSIGN_OR_RETURN(access.authenticator,
                          Authenticator::Create({.token_file = options.token_file,
                                                 .has_client_certificates = has_client_certificates,
                                                 .revocations = options.tls.client_crl,
                                                 .metrics = metrics}));
  if (options.tls.has_tls()) {
    EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<TlsFiles> files, TlsFiles::Open(options.tls));
    access.credentials = MakeTlsServerCredentials(std::move(files), has_client_certificates);
  } else {
    access.credentials = grpc::InsecureServerCredentials();
  }
  return access;
}

ModelRegistry::Options RegistryOptions(const ServerOptions& options, const Store& store,
                                       std::shared_ptr<ServerMetrics> metrics) {
  ModelRegistry::Options registry = {
      .limits = {.max_model_bytes = options.max_model_bytes,
                 .max_store_bytes = options.max_model_store_bytes,
                 .max_tenant_bytes = TenantLimit(options.tenant.max_model_bytes, options.max_model_store_bytes),
                 .max_uploads = options.max_uploads,
                 .max_tenant_uploads = TenantLimit(options.tenant.max_uploads, options.max_uploads),
                 .metrics = std::move(metrics)},
      .shares_store = store.is_shared()};
  if (!options.model_preparer.empty()) {
    registry.preparer = MakeChildModelPreparer(options.model_preparer, options.model_budget);
  }
  return registry;
}

TenantQuotas::Options QuotaOptions(const ServerOptions& options, std::shared_ptr<ServerMetrics> metrics) {
  const uint64_t max_bytes_per_s = options.tenant.max_bytes_per_s.value_or(0);
  return {.max_streams = TenantLimit(options.tenant.max_streams, options.max_streams),
          .max_streams_of_server = options.max_streams,
          .max_watchers = TenantLimit(options.tenant.max_watchers, options.max_streams),
          .max_response_bytes = options.max_transport_bytes / 8,
          .max_health_per_s = options.tenant.max_health_per_s,
          .max_bytes_per_s = max_bytes_per_s,
          // The bytes of one second, but at least one chunk.
          .burst_bytes = std::max<uint64_t>(max_bytes_per_s, options.max_chunk_bytes),
          .now = MakeServerClock(),
          .metrics = std::move(metrics)};
}

FairScheduler::Options SchedulerOptions(const ServerOptions& options, const std::shared_ptr<ServerMetrics>& metrics) {
  return {.limits = {.session = options.max_session_cpu, .tenant = options.tenant.max_cpu.value_or(0.0)},
          .on_turn = [metrics](std::chrono::nanoseconds cpu, const std::string& trace_id) {
            metrics->turn_time.Add(cpu, trace_id);
            metrics->turn_ns.Add(static_cast<uint64_t>(std::max<int64_t>(cpu.count(), 0)));
          }};
}

LoadMonitor::Options LoadOptions(const ServerOptions& options, const std::shared_ptr<ServerMetrics>& metrics) {
  return {.num_workers = NumWorkers(options),
          .cpu = [metrics] { return std::chrono::nanoseconds(metrics->turn_ns.value()); },
          .max_ratio = options.max_load};
}

double RatioOf(double value, double limit) { return limit > 0.0 ? value / limit : 0.0; }

// The life of a server, in order: it never returns to an earlier stage.
enum class ServerStage {
  kServing,
  kAnnounced,  // its health is NOT_SERVING, so that clients and balancers choose other servers
  kDraining,   // it accepts no new sessions and streams, and the present streams are told to leave
  kShutDown,   // Shutdown() has been called
};

class ServerImpl : public Server, public Drainer {
 public:
  ServerImpl(const ServerOptions& options, TrackerFactory make_tracker, Access access, std::unique_ptr<Store> store,
             std::shared_ptr<ServerMetrics> metrics, std::unique_ptr<ModelRegistry> models)
      : metrics_(std::move(metrics)),
        access_(std::move(access)),
        num_workers_(NumWorkers(options)),
        load_(LoadOptions(options, metrics_)),
        pool_(num_workers_, options.slow_threads, SchedulerOptions(options, metrics_)),
        store_(std::move(store)),
        models_(std::move(models)),
        sessions_(ManagerOptions(options, std::move(make_tracker), *store_, metrics_, load_), *store_, *models_, pool_),
        quotas_(QuotaOptions(options, metrics_)),
        expiry_timer_(pool_, std::clamp(options.session_expiry / 4, absl::Seconds(1), absl::Minutes(1)),
                      [this] { DeleteOldSessions(sessions_); }),
        access_timer_(pool_, kAccessCheckPeriod, [this] { streams_.CheckAccess(access_.authenticator->BeginCheck()); }),
        load_timer_(pool_, absl::FromChrono(LoadMonitor::kPeriod),
                    [this] {
                      load_.Update();
                      load_ratio_ = MakeLoadRatio();
                    }),
        store_check_(*store_, pool_, options.store_check_period, [this](bool is_healthy) { SetHealth(is_healthy); }),
        on_drain_(options.on_drain),
        context_{*store_,
                 *models_,
                 sessions_,
                 pool_,
                 streams_,
                 *access_.authenticator,
                 quotas_,
                 *this,
                 options.attach_timeout,
                 options.stream_idle_timeout,
                 options.upload_timeout,
                 options.response_timeout,
                 options.max_model_bytes,
                 options.serves_event_images,
                 options.drain_timeout,
                 *metrics_,
                 log_limiter_},
        session_service_(context_),
        model_service_(context_),
        admin_service_(context_) {}

  // NOLINTNEXTLINE(bugprone-exception-escape): an exception ends the process, as in every thread
  ~ServerImpl() override { Shutdown(kDestructorDeadline); }

  absl::Status FindStored() { return sessions_.FindStored(); }

  void PrepareOutdatedModels() { server::PrepareOutdatedModels(*models_, pool_.preparations()); }

  absl::Status Listen(const ServerOptions& options) {
    grpc::ServerBuilder builder;
    builder.RegisterService(&session_service_);
    builder.RegisterService(&model_service_);
    builder.RegisterService(&admin_service_);
    builder.SetOption(std::make_unique<ReflectionOption>(access_.authenticator->is_open()));
    builder.SetMaxReceiveMessageSize(static_cast<int>(options.max_chunk_bytes + kMessageOverheadBytes));
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, kKeepaliveMs);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, kKeepaliveMs);
    builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_PERMIT_WITHOUT_CALLS, 1);
    builder.AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, kMaxConnectionIdleMs);
    builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, static_cast<int>(options.max_calls_per_connection));
    builder.AddChannelArgument(GRPC_ARG_HTTP2_MIN_RECV_PING_INTERVAL_WITHOUT_DATA_MS, kMinPingIntervalMs);
    builder.AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, kHandshakeTimeoutMs);
    grpc::ResourceQuota quota("evpose-server");
    quota.Resize(options.max_transport_bytes);
    builder.SetResourceQuota(quota);
    if (!options.listen_address.empty()) EVPOSE_RETURN_IF_ERROR(OpenSocket(options, builder));
    server_ = builder.BuildAndStart();
    if (server_ == nullptr) return absl::InternalError("gRPC did not start; --log-level debug has its log");
    if (acceptor_ != nullptr) acceptor_->Start([this](int descriptor) { HandToGrpc(descriptor); });
    store_check_.Start();
    return absl::OkStatus();
  }

  int port() const override { return acceptor_ == nullptr ? 0 : acceptor_->port(); }

  std::shared_ptr<grpc::Channel> InProcessChannel() override {
    grpc::ChannelArguments arguments;
    arguments.SetMaxReceiveMessageSize(-1);
    return server_->InProcessChannel(arguments);
  }

  const ServerMetrics& metrics() const override { return *metrics_; }

  ServerState state() const override {
    ServerState state = {.sessions = sessions_.totals(),
                         .max_sessions = sessions_.options().max_sessions,
                         .num_workers = static_cast<uint32_t>(num_workers_),
                         .session_memory_bytes = sessions_.options().memory->charged_bytes(),
                         .max_session_memory_bytes = sessions_.options().memory->max_bytes(),
                         .num_tokens = access_.authenticator->num_tokens(),
                         .readiness = sessions_.CheckNotDraining()};
    state.readiness.Update(FromStore(store_check_.health()));
    if (const std::optional<StoreUsage> usage = store_check_.usage(); usage.has_value()) {
      state.store_bytes = usage->bytes;
      if (usage->max_bytes != 0) state.store_max_bytes = usage->max_bytes;
      state.store_cpu_s = usage->cpu_s;
    }
    state.unreplicated_commits = store_->unreplicated_commits();
    state.store_groups = store_->Groups();
    if (acceptor_ != nullptr) {
      state.connections = acceptor_->num_connections();
      state.listening = acceptor_->status();
      state.readiness.Update(state.listening);
    }
    state.load_ratio = MakeLoadRatio();
    state.process_cpu_s = ProcessCpuSeconds();
    state.process_resident_bytes = ProcessResidentBytes();
    if (stage_ >= ServerStage::kAnnounced) {
      state.readiness.Update(absl::UnavailableError("the server is about to shut down"));
    }
    return state;
  }

  double load_ratio() const override { return load_ratio_; }

  void AnnounceShutdown() override {
    Enter(ServerStage::kAnnounced);
    if (server_ != nullptr) SetHealth(false);
  }

  void Drain(absl::Duration deadline) override {
    if (BeginShutdown(deadline) && on_drain_ != nullptr) on_drain_(deadline);
  }

  void Shutdown(absl::Duration deadline) override {
    if (stage_ == ServerStage::kShutDown) return;
    deadline = std::min(deadline, kLongestDuration);
    const absl::Time end = absl::Now() + deadline - std::min(3 * kCallGrace, deadline / 2);
    BeginShutdown(deadline);
    Enter(ServerStage::kShutDown);
    if (server_ != nullptr) streams_.WaitForTracks(end);
    sessions_.FlushAll(absl::Now() + kCallGrace);
    const absl::Status leaving = WithReason(absl::UnavailableError("the server has shut down"), v1::DRAINING);
    streams_.EndAll(leaving);
    // All streams have ended or are ending. Processed chunks are stored now; clients send the others again.
    if (!sessions_.FlushAll(absl::Now() + kCallGrace)) {
      Log(LogLevel::kWarning, "shutdown_not_durable",
          {{"message", "not all processed chunks could be stored; clients that attach again send them again"}});
    }
    pool_.slow().Stop();
    pool_.preparations().Stop();
    sessions_.CloseAll(leaving);
    if (server_ != nullptr) {
      streams_.WaitForAll(absl::Now() + kCallGrace);
      if (acceptor_ != nullptr) acceptor_->Stop();
      server_->Shutdown(absl::ToChronoTime(absl::Now() + kCallGrace));
    }
    expiry_timer_.Stop();
    access_timer_.Stop();
    load_timer_.Stop();
    pool_.Join();
  }

 private:
  double MakeLoadRatio() const {
    const MemoryBudget& memory = *sessions_.options().memory;
    return std::max({load_.ratio(), RatioOf(sessions_.num_sessions(), sessions_.options().max_sessions),
                     RatioOf(static_cast<double>(memory.charged_bytes()), static_cast<double>(memory.max_bytes()))});
  }

  absl::Status OpenSocket(const ServerOptions& options, grpc::ServerBuilder& builder) {
    EVPOSE_ASSIGN_OR_RETURN(const ListenAddress address, ParseListenAddress(options.listen_address));
    const auto on_stalled = [this, call = options.on_stalled] {
      if (stage_ >= ServerStage::kDraining) return;
      AnnounceShutdown();  // health is NOT_SERVING for clients that are connected already
      if (call != nullptr) call();
    };
    EVPOSE_ASSIGN_OR_RETURN(
        acceptor_, ConnectionAcceptor::Listen(address, {.max_connections = options.max_connections,
                                                        .max_connections_per_peer = options.max_connections_per_peer,
                                                        .listener_timeout = options.listener_timeout,
                                                        .on_stalled = on_stalled,
                                                        .metrics = metrics_}));
    grpc_entrance_ = builder.experimental().AddExternalConnectionAcceptor(
        grpc::ServerBuilder::experimental_type::ExternalConnectionType::FROM_FD, access_.credentials);
    return absl::OkStatus();
  }

  void HandToGrpc(int descriptor) {
    grpc::experimental::ExternalConnectionAcceptor::NewConnectionParameters connection;
    connection.fd = descriptor;
    grpc_entrance_->HandleNewConnection(&connection);
  }

  // Enters the stage unless the server is in it or in a later one already. Returns whether the stage has changed. No
  // other function changes the stage.
  bool Enter(ServerStage stage) {
    ServerStage now = stage_;
    while (now < stage) {
      if (stage_.compare_exchange_weak(now, stage)) return true;
    }
    return false;
  }

  // From kAnnounced on the health stays NOT_SERVING, independent of the store.
  void SetHealth(bool serves) {
    const std::lock_guard lock(health_mutex_);
    server_->GetHealthCheckService()->SetServingStatus(serves && stage_ == ServerStage::kServing);
  }

  // Starts draining. Returns false if it has started before.
  bool BeginShutdown(absl::Duration deadline) {
    if (!Enter(ServerStage::kDraining)) return false;
    sessions_.Drain();
    store_check_.Stop();
    if (server_ != nullptr) {
      SetHealth(false);
      streams_.GoAway(deadline);
    }
    return true;
  }

  const std::shared_ptr<ServerMetrics> metrics_;
  const Access access_;
  const int num_workers_;
  LoadMonitor load_;
  std::atomic<double> load_ratio_ = 0.0;  // of the latest measurement
  WorkerPool pool_;                       // outlives the store: its last callback may post to the pool
  const std::unique_ptr<Store> store_;
  const std::unique_ptr<ModelRegistry> models_;
  SessionManager sessions_;
  StreamRegistry streams_;
  TenantQuotas quotas_;
  LogLimiter log_limiter_;
  PeriodicTimer expiry_timer_;
  PeriodicTimer access_timer_;
  PeriodicTimer load_timer_;
  StoreCheck store_check_;
  const std::function<void(absl::Duration)> on_drain_;
  const ServiceContext context_;
  SessionServiceImpl session_service_;
  ModelServiceImpl model_service_;
  AdminServiceImpl admin_service_;
  std::unique_ptr<grpc::Server> server_;
  std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> grpc_entrance_;
  std::unique_ptr<ConnectionAcceptor> acceptor_;  // null without a socket
  std::mutex health_mutex_;
  std::atomic<ServerStage> stage_ = ServerStage::kServing;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Server>> StartServer(const ServerOptions& options, TrackerFactory make_tracker,
                                                    std::unique_ptr<Store> store) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  if (store == nullptr) {
    EVPOSE_ASSIGN_OR_RETURN(store, OpenStore(options.store));
  }
  grpc::EnableDefaultHealthCheckService(true);
  const auto metrics = std::make_shared<ServerMetrics>();
  EVPOSE_ASSIGN_OR_RETURN(Access access, MakeAccess(options, metrics));
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<ModelRegistry> models,
                          ModelRegistry::Create(RegistryOptions(options, *store, metrics), *store));
  auto server = std::make_unique<ServerImpl>(options, std::move(make_tracker), std::move(access), std::move(store),
                                             metrics, std::move(models));
  EVPOSE_RETURN_IF_ERROR(server->FindStored());
  EVPOSE_RETURN_IF_ERROR(server->Listen(options));
  server->PrepareOutdatedModels();
  return server;
}

absl::StatusOr<std::unique_ptr<Server>> Server::Start(const ServerOptions& options) {
  return StartServer(options, MakeTrackerFactory());
}

}  // namespace evpose::server
