// SPDX-License-Identifier: Apache-2.0
#include "client/lib/client.h"

#include <grpcpp/client_context.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <optional>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/lib/channel.h"
#include "client/lib/conversion.h"
#include "client/lib/tls_probe.h"
#include "client/lib/track_loop.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "evpose/v1/admin_service.grpc.pb.h"
#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {
namespace {

constexpr size_t kUploadPieceBytes = 256 * 1024;
constexpr int kPageSize = 500;
// That each server is waited for in turn.
constexpr absl::Duration kConnectSlice = absl::Milliseconds(100);
// ServerInfo.store of one whose sessions end with it.
constexpr char kMemoryStore[] = "memory";

std::chrono::system_clock::time_point DeadlineIn(absl::Duration duration) {
  return absl::ToChronoTime(absl::Now() + duration);
}

// The longest that a connection which TLS prevents is waited for.
constexpr absl::Duration kFirstWait = absl::Seconds(1);

}  // namespace

// One of the servers.
struct Client::Endpoint {
  std::shared_ptr<grpc::Channel> channel;
  std::string name;
  std::unique_ptr<v1::AdminService::StubInterface> admin;
  std::unique_ptr<v1::ModelService::StubInterface> models;
  std::unique_ptr<v1::SessionService::StubInterface> sessions;
};

struct Client::Impl {
  std::vector<Endpoint> endpoints;
  std::atomic<size_t> current = 0;  // the one that calls go to
  bool sessions_outlive_server = false;
  ClientOptions options;

  const Endpoint& endpoint() const { return endpoints[current]; }
  bool IsCancelled() const { return options.is_cancelled && options.is_cancelled(); }

  // One call with its deadline: `call(context, response)`.
  template <typename Response, typename Call>
  absl::StatusOr<Response> Unary(const Call& call) {
    grpc::ClientContext context;
    context.set_deadline(DeadlineIn(options.call_timeout));
    Response response;
    const grpc::Status status = call(&context, &response);
    if (!status.ok()) return FromGrpc(status, endpoint().name);
    return response;
  }

  // All pages of a list. `call(context, request, response)`; `append(response)` takes what a page holds.
  template <typename Request, typename Response, typename Call, typename Append>
  absl::Status AllPages(const Call& call, const Append& append) {
    Request request;
    request.set_page_size(kPageSize);
    do {
      EVPOSE_ASSIGN_OR_RETURN(const Response response, Unary<Response>([&](auto* context, Response* page) {
                                return call(context, request, page);
                              }));
      EVPOSE_RETURN_IF_ERROR(append(response));
      request.set_page_token(response.next_page_token());
    } while (!request.page_token().empty());
    return absl::OkStatus();
  }
};

// What metadata can carry.
bool IsToken(absl::string_view text) { return std::all_of(text.begin(), text.end(), absl::ascii_isgraph); }

absl::Status ClientOptions::Validate() const {
  if (connect_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("connect_timeout must be positive");
  if (call_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("call_timeout must be positive");
  if (tls.certificate_file.empty() != tls.key_file.empty()) {
    return absl::InvalidArgumentError("tls: a certificate needs its key, and a key its certificate");
  }
  if (!IsToken(token)) {
    return absl::InvalidArgumentError("token: has spaces, line ends or other characters that no token has");
  }
  return absl::OkStatus();
}

Client::Client(const ClientOptions& options) : impl_(std::make_unique<Impl>()) { impl_->options = options; }
Client::~Client() = default;

absl::StatusOr<std::unique_ptr<Client>> Client::Connect(const std::string& addresses, const ClientOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  std::unique_ptr<Client> client(new Client(options));
  for (const absl::string_view part : absl::StrSplit(addresses, ',')) {
    const std::string address(part);
    EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<grpc::Channel> channel, MakeChannel(address, options));
    client->AddEndpoint(std::move(channel), address);
  }
  const absl::Time deadline = absl::Now() + options.connect_timeout;
  EVPOSE_ASSIGN_OR_RETURN(bool is_connected, client->WaitForServer());
  absl::StatusOr<ServerInfo> info = client->GetServerInfo();
  // One that ends, or whose connection breaks, before it has answered: the next one that is there.
  while (is_connected && absl::IsUnavailable(info.status()) && absl::Now() < deadline) {
    absl::SleepFor(std::min(kConnectSlice, deadline - absl::Now()));
    is_connected = client->WaitForServerUntil(deadline);
    info = client->GetServerInfo();  // also when it is not connected: the call then tells why
  }
  if (!is_connected && client->impl_->IsCancelled()) {
    return absl::CancelledError(absl::StrCat("interrupted before a server answered at ", addresses));
  }
  if (info.ok()) {
    client->impl_->sessions_outlive_server = info->store != kMemoryStore;
    return client;
  }
  const std::string& name = client->impl_->endpoint().name;
  if (info.status().code() == absl::StatusCode::kUnimplemented) {
    return absl::UnimplementedError(absl::StrCat("what answers at ", name, " is no evpose server"));
  }
  if (is_connected) return info.status();
  return absl::UnavailableError(absl::StrCat("no server at ", addresses, ": tried to connect for ",
                                             absl::FormatDuration(options.connect_timeout),
                                             "; is evpose-server running there? (", info.status().message(), ")"));
}

std::unique_ptr<Client> Client::OverChannel(std::shared_ptr<grpc::Channel> channel, const std::string& name,
                                            const ClientOptions& options) {
  std::unique_ptr<Client> client(new Client(options));
  client->AddEndpoint(std::move(channel), name);
  return client;
}

void Client::AddEndpoint(std::shared_ptr<grpc::Channel> channel, const std::string& name) {
  Endpoint& endpoint = impl_->endpoints.emplace_back();
  endpoint.name = name;
  endpoint.admin = v1::AdminService::NewStub(channel);
  endpoint.models = v1::ModelService::NewStub(channel);
  endpoint.sessions = v1::SessionService::NewStub(channel);
  endpoint.channel = std::move(channel);
}

absl::StatusOr<bool> Client::WaitForServer() {
  const absl::Time begin = absl::Now();
  const absl::Time deadline = begin + impl_->options.connect_timeout;
  for (const Endpoint& endpoint : impl_->endpoints) endpoint.channel->GetState(true);  // all of them try
  if (WaitForServerUntil(std::min(deadline, begin + kFirstWait))) return true;
  if (impl_->IsCancelled()) return false;
  for (const Endpoint& endpoint : impl_->endpoints) {
    const std::string why = ExplainTls(endpoint.name, impl_->options.tls, kFirstWait);
    if (!why.empty()) return absl::FailedPreconditionError(absl::StrCat("server at ", endpoint.name, ": ", why));
  }
  return WaitForServerUntil(deadline);
}

bool Client::WaitForServerUntil(absl::Time deadline) {
  const std::vector<Endpoint>& endpoints = impl_->endpoints;
  for (absl::Time now = absl::Now(); now < deadline; now = absl::Now()) {
    const absl::Duration wait = std::min(deadline - now, kConnectSlice);
    for (size_t i = 0; i < endpoints.size(); ++i) {
      impl_->current = i;
      if (endpoints[i].channel->WaitForConnected(DeadlineIn(wait))) return true;
    }
    if (impl_->IsCancelled()) return false;
  }
  return false;
}

absl::StatusOr<ServerInfo> Client::GetServerInfo() {
  EVPOSE_ASSIGN_OR_RETURN(const v1::ServerInfo info,
                          impl_->Unary<v1::ServerInfo>([this](auto* context, auto* response) {
                            return impl_->endpoint().admin->GetServerInfo(context, {}, response);
                          }));
  return FromProto(info);
}

absl::StatusOr<uint32_t> Client::Drain(std::optional<absl::Duration> timeout) {
  v1::DrainRequest request;
  if (timeout) *request.mutable_timeout() = ToProto(*timeout);
  EVPOSE_ASSIGN_OR_RETURN(const v1::DrainResponse response,
                          impl_->Unary<v1::DrainResponse>([this, &request](auto* context, auto* answer) {
                            return impl_->endpoint().admin->Drain(context, request, answer);
                          }));
  return response.remaining_sessions();
}

absl::StatusOr<LogLevel> Client::SetLogLevel(LogLevel level) {
  v1::SetLogLevelRequest request;
  request.set_level(ToProto(level));
  EVPOSE_ASSIGN_OR_RETURN(const v1::SetLogLevelResponse response,
                          impl_->Unary<v1::SetLogLevelResponse>([this, &request](auto* context, auto* answer) {
                            return impl_->endpoint().admin->SetLogLevel(context, request, answer);
                          }));
  return FromProto(response.previous_level());
}

absl::StatusOr<ModelInfo> Client::UploadModel(absl::Span<const uint8_t> bytes, const UploadOptions& options) {
  absl::StatusOr<ModelInfo> model = TryUpload(bytes, options);
  // The server had it, and only at the end found that another one has deleted it: now it takes the bytes.
  if (absl::IsAborted(model.status())) model = TryUpload(bytes, options);
  return model;
}

absl::StatusOr<ModelInfo> Client::TryUpload(absl::Span<const uint8_t> bytes, const UploadOptions& options) {
  grpc::ClientContext context;
  context.set_deadline(DeadlineIn(impl_->options.call_timeout));
  v1::Model model;
  const std::unique_ptr<grpc::ClientWriterInterface<v1::UploadModelRequest>> writer =
      impl_->endpoint().models->UploadModel(&context, &model);
  v1::UploadModelRequest request;
  v1::UploadModelRequest::Header& header = *request.mutable_header();
  header.set_format(ToProto(options.format));
  header.set_metres_per_unit(options.metres_per_unit);
  header.set_size_bytes(bytes.size());
  header.set_sha256(absl::HexStringToBytes(Sha256Hex(bytes)));
  bool is_open = writer->Write(request);
  for (size_t begin = 0; is_open && begin < bytes.size(); begin += kUploadPieceBytes) {
    const absl::Span<const uint8_t> piece = bytes.subspan(begin, kUploadPieceBytes);
    request.set_chunk(piece.data(), piece.size());
    is_open = writer->Write(request);
  }
  if (is_open) writer->WritesDone();
  const grpc::Status status = writer->Finish();
  if (!status.ok()) return FromGrpc(status, impl_->endpoint().name);
  return FromProto(model);
}

absl::StatusOr<ModelInfo> Client::GetModel(const std::string& name) {
  v1::GetModelRequest request;
  request.set_name(name);
  EVPOSE_ASSIGN_OR_RETURN(const v1::Model model, impl_->Unary<v1::Model>([&](auto* context, auto* response) {
    return impl_->endpoint().models->GetModel(context, request, response);
  }));
  return FromProto(model);
}

absl::StatusOr<std::vector<ModelInfo>> Client::ListModels() {
  std::vector<ModelInfo> models;
  EVPOSE_RETURN_IF_ERROR((impl_->AllPages<v1::ListModelsRequest, v1::ListModelsResponse>(
      [this](auto* context, const auto& request, auto* response) {
        return impl_->endpoint().models->ListModels(context, request, response);
      },
      [&models](const v1::ListModelsResponse& page) {
        for (const v1::Model& model : page.models()) models.push_back(FromProto(model));
        return absl::OkStatus();
      })));
  return models;
}

absl::Status Client::DeleteModel(const std::string& name) {
  v1::DeleteModelRequest request;
  request.set_name(name);
  return impl_
      ->Unary<google::protobuf::Empty>([&](auto* context, auto* response) {
        return impl_->endpoint().models->DeleteModel(context, request, response);
      })
      .status();
}

absl::StatusOr<Session> Client::CreateSession(const SessionConfig& config, const std::string& request_id) {
  EVPOSE_RETURN_IF_ERROR(CheckEstimator(config.estimator));
  v1::CreateSessionRequest request;
  request.set_request_id(request_id);
  *request.mutable_config() = ToProto(config);
  EVPOSE_ASSIGN_OR_RETURN(const v1::CreateSessionResponse created,
                          impl_->Unary<v1::CreateSessionResponse>([&](auto* context, auto* response) {
                            return impl_->endpoint().sessions->CreateSession(context, request, response);
                          }));
  return FromProto(created);
}

absl::StatusOr<Session> Client::GetSession(const std::string& name) {
  v1::GetSessionRequest request;
  request.set_name(name);
  EVPOSE_ASSIGN_OR_RETURN(const v1::Session session, impl_->Unary<v1::Session>([&](auto* context, auto* response) {
    return impl_->endpoint().sessions->GetSession(context, request, response);
  }));
  return FromProto(session);
}

absl::StatusOr<std::vector<Session>> Client::ListSessions() {
  std::vector<Session> sessions;
  EVPOSE_RETURN_IF_ERROR((impl_->AllPages<v1::ListSessionsRequest, v1::ListSessionsResponse>(
      [this](auto* context, const auto& request, auto* response) {
        return impl_->endpoint().sessions->ListSessions(context, request, response);
      },
      [&sessions](const v1::ListSessionsResponse& page) {
        for (const v1::Session& message : page.sessions()) {
          EVPOSE_ASSIGN_OR_RETURN(Session session, FromProto(message));
          sessions.push_back(std::move(session));
        }
        return absl::OkStatus();
      })));
  return sessions;
}

absl::Status Client::DeleteSession(const std::string& name) {
  v1::DeleteSessionRequest request;
  request.set_name(name);
  request.set_allow_missing(true);
  return impl_
      ->Unary<google::protobuf::Empty>([&](auto* context, auto* response) {
        return impl_->endpoint().sessions->DeleteSession(context, request, response);
      })
      .status();
}

absl::StatusOr<TrackSummary> Client::Track(const Session& session, const ChunkSource& source,
                                           const TrackCallbacks& callbacks, const TrackOptions& options) {
  FeedOptions feed_options;
  feed_options.rate = options.rate;
  feed_options.clock = options.clock;
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventFeed> feed, EventFeed::Open(source, feed_options));
  TrackPosition position;
  position.session = session.name;
  position.resume_token = session.resume_token;
  return Track(position, *feed, callbacks, options);
}

absl::StatusOr<TrackSummary> Client::Track(const TrackPosition& position, EventFeed& feed,
                                           const TrackCallbacks& callbacks, const TrackOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  std::vector<TrackServer> servers;
  for (const Endpoint& endpoint : impl_->endpoints) {
    servers.push_back({endpoint.name, endpoint.sessions.get(), [channel = endpoint.channel.get()] {
                         grpc::experimental::ChannelResetConnectionBackoff(channel);
                       }});
  }
  TrackLoop loop(servers, impl_->current, impl_->sessions_outlive_server, position, feed, callbacks, options);
  absl::StatusOr<TrackSummary> summary = loop.Run();
  std::stop_source stop = options.stop;
  stop.request_stop();
  feed.Stop();
  return summary;
}

absl::Status Client::WatchPoses(const std::string& session, uint64_t after_pose_seq, const PosesCallback& on_poses,
                                std::stop_token stop) {
  absl::Status status;
  do {
    status = WatchUntilEnd(session, after_pose_seq, on_poses, stop);
  } while (ReasonOf(status) == v1::FENCED && !stop.stop_requested());
  return status;
}

absl::Status Client::WatchUntilEnd(const std::string& session, uint64_t& after_pose_seq, const PosesCallback& on_poses,
                                   const std::stop_token& stop) {
  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session);
  request.set_after_pose_seq(after_pose_seq);
  const std::unique_ptr<grpc::ClientReaderInterface<v1::WatchPosesResponse>> reader =
      impl_->endpoint().sessions->WatchPoses(&context, request);
  const std::stop_callback cancel_on_stop(stop, [&context] { context.TryCancel(); });
  v1::WatchPosesResponse response;
  absl::Status malformed;
  while (reader->Read(&response)) {
    std::vector<Pose> poses;
    for (const v1::Pose& message : response.poses()) {
      absl::StatusOr<Pose> pose = FromProto(message);
      malformed.Update(pose.status());
      if (pose.ok()) poses.push_back(*std::move(pose));
    }
    if (!malformed.ok()) break;
    on_poses(poses, response.num_skipped());
    if (!poses.empty()) after_pose_seq = poses.back().seq;
  }
  if (!malformed.ok()) context.TryCancel();
  const grpc::Status status = reader->Finish();
  if (!malformed.ok()) return absl::InternalError(absl::StrCat(impl_->endpoint().name, ": ", malformed.message()));
  return FromGrpc(status, impl_->endpoint().name);
}

}  // namespace evpose::client
