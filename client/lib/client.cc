#include "client/lib/client.h"

#include <grpcpp/client_context.h>
#include <grpcpp/create_channel.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/lib/conversion.h"
#include "client/lib/track_call.h"
#include "core/base/hash.h"
#include "core/base/status_macros.h"
#include "evpose/v1/admin.grpc.pb.h"
#include "evpose/v1/models.grpc.pb.h"
#include "evpose/v1/sessions.grpc.pb.h"

namespace evpose::client {
namespace {

constexpr size_t kUploadPieceBytes = 256 * 1024;
constexpr int kPageSize = 500;

std::chrono::system_clock::time_point DeadlineIn(absl::Duration duration) {
  return absl::ToChronoTime(absl::Now() + duration);
}

absl::Status CheckAddress(const std::string& address) {
  const size_t colon = address.rfind(':');
  uint32_t port = 0;
  const bool is_address = colon != std::string::npos && colon > 0 &&
                          absl::SimpleAtoi(address.substr(colon + 1), &port) && port >= 1 && port <= 65535;
  if (is_address) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("\"", address, "\" is no server address: HOST:PORT is needed"));
}

std::shared_ptr<grpc::Channel> MakeChannel(const std::string& address) {
  grpc::ChannelArguments arguments;
  // A server that is just starting is found within a fraction of a second.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 1000);
  // A dead link is noticed within 30 s; the server permits a ping every 10 s.
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
}

}  // namespace

struct Client::Impl {
  std::shared_ptr<grpc::Channel> channel;
  std::string name;
  ClientOptions options;
  std::unique_ptr<v1::AdminService::StubInterface> admin;
  std::unique_ptr<v1::ModelService::StubInterface> models;
  std::unique_ptr<v1::SessionService::StubInterface> sessions;

  // One call with its deadline: `call(context, response)`.
  template <typename Response, typename Call>
  absl::StatusOr<Response> Unary(const Call& call) {
    grpc::ClientContext context;
    context.set_deadline(DeadlineIn(options.call_timeout));
    Response response;
    const grpc::Status status = call(&context, &response);
    if (!status.ok()) return FromGrpc(status, name);
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

absl::Status ClientOptions::Validate() const {
  if (connect_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("connect_timeout must be positive");
  if (call_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("call_timeout must be positive");
  return absl::OkStatus();
}

Client::Client() = default;
Client::~Client() = default;

absl::StatusOr<std::unique_ptr<Client>> Client::Connect(const std::string& address, const ClientOptions& options) {
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  EVPOSE_RETURN_IF_ERROR(CheckAddress(address));
  std::unique_ptr<Client> client = OverChannel(MakeChannel(address), address, options);
  const bool is_connected = client->impl_->channel->WaitForConnected(DeadlineIn(options.connect_timeout));
  // Also when it is not connected: the call then tells why.
  const absl::StatusOr<ServerInfo> info = client->GetServerInfo();
  if (info.ok()) return client;
  if (info.status().code() == absl::StatusCode::kUnimplemented) {
    return absl::UnimplementedError(absl::StrCat("what answers at ", address, " is no evpose server"));
  }
  if (is_connected) return info.status();
  return absl::UnavailableError(absl::StrCat("no server at ", address, ": tried to connect for ",
                                             absl::FormatDuration(options.connect_timeout),
                                             "; is evpose-server running there? (", info.status().message(), ")"));
}

std::unique_ptr<Client> Client::OverChannel(std::shared_ptr<grpc::Channel> channel, const std::string& name,
                                            const ClientOptions& options) {
  std::unique_ptr<Client> client(new Client);
  client->impl_ = std::make_unique<Impl>();
  Impl& impl = *client->impl_;
  impl.name = name;
  impl.options = options;
  impl.admin = v1::AdminService::NewStub(channel);
  impl.models = v1::ModelService::NewStub(channel);
  impl.sessions = v1::SessionService::NewStub(channel);
  impl.channel = std::move(channel);
  return client;
}

absl::StatusOr<ServerInfo> Client::GetServerInfo() {
  EVPOSE_ASSIGN_OR_RETURN(const v1::ServerInfo info,
                          impl_->Unary<v1::ServerInfo>([this](auto* context, auto* response) {
                            return impl_->admin->GetServerInfo(context, {}, response);
                          }));
  return FromProto(info);
}

absl::StatusOr<ModelInfo> Client::UploadModel(absl::Span<const uint8_t> bytes, const UploadOptions& options) {
  grpc::ClientContext context;
  context.set_deadline(DeadlineIn(impl_->options.call_timeout));
  v1::Model model;
  const std::unique_ptr<grpc::ClientWriterInterface<v1::UploadModelRequest>> writer =
      impl_->models->UploadModel(&context, &model);
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
  if (!status.ok()) return FromGrpc(status, impl_->name);
  return FromProto(model);
}

absl::StatusOr<ModelInfo> Client::GetModel(const std::string& name) {
  v1::GetModelRequest request;
  request.set_name(name);
  EVPOSE_ASSIGN_OR_RETURN(const v1::Model model, impl_->Unary<v1::Model>([&](auto* context, auto* response) {
    return impl_->models->GetModel(context, request, response);
  }));
  return FromProto(model);
}

absl::StatusOr<std::vector<ModelInfo>> Client::ListModels() {
  std::vector<ModelInfo> models;
  EVPOSE_RETURN_IF_ERROR((impl_->AllPages<v1::ListModelsRequest, v1::ListModelsResponse>(
      [this](auto* context, const auto& request, auto* response) {
        return impl_->models->ListModels(context, request, response);
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
      ->Unary<v1::DeleteModelResponse>(
          [&](auto* context, auto* response) { return impl_->models->DeleteModel(context, request, response); })
      .status();
}

absl::StatusOr<Session> Client::CreateSession(const SessionConfig& config) {
  v1::CreateSessionRequest request;
  *request.mutable_config() = ToProto(config);
  EVPOSE_ASSIGN_OR_RETURN(const v1::Session session, impl_->Unary<v1::Session>([&](auto* context, auto* response) {
    return impl_->sessions->CreateSession(context, request, response);
  }));
  return FromProto(session);
}

absl::StatusOr<Session> Client::GetSession(const std::string& name) {
  v1::GetSessionRequest request;
  request.set_name(name);
  EVPOSE_ASSIGN_OR_RETURN(const v1::Session session, impl_->Unary<v1::Session>([&](auto* context, auto* response) {
    return impl_->sessions->GetSession(context, request, response);
  }));
  return FromProto(session);
}

absl::StatusOr<std::vector<Session>> Client::ListSessions() {
  std::vector<Session> sessions;
  EVPOSE_RETURN_IF_ERROR((impl_->AllPages<v1::ListSessionsRequest, v1::ListSessionsResponse>(
      [this](auto* context, const auto& request, auto* response) {
        return impl_->sessions->ListSessions(context, request, response);
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
  return impl_
      ->Unary<v1::DeleteSessionResponse>(
          [&](auto* context, auto* response) { return impl_->sessions->DeleteSession(context, request, response); })
      .status();
}

absl::StatusOr<TrackSummary> Client::Track(const Session& session, const ChunkSource& source,
                                           const TrackCallbacks& callbacks, const TrackOptions& options) {
  TrackCall call(*impl_->sessions, impl_->name, session, source, callbacks, options);
  return call.Run();
}

absl::Status Client::WatchPoses(const std::string& session, uint64_t after_pose_seq, const PosesCallback& on_poses,
                                std::stop_token stop) {
  grpc::ClientContext context;
  v1::WatchPosesRequest request;
  request.set_session(session);
  request.set_after_pose_seq(after_pose_seq);
  const std::unique_ptr<grpc::ClientReaderInterface<v1::WatchPosesResponse>> reader =
      impl_->sessions->WatchPoses(&context, request);
  const std::stop_callback cancel_on_stop(stop, [&context] { context.TryCancel(); });
  v1::WatchPosesResponse response;
  absl::Status malformed;
  while (malformed.ok() && reader->Read(&response)) {
    std::vector<Pose> poses;
    for (const v1::Pose& message : response.poses()) {
      absl::StatusOr<Pose> pose = FromProto(message);
      malformed.Update(pose.status());
      if (pose.ok()) poses.push_back(*std::move(pose));
    }
    if (malformed.ok()) on_poses(poses, response.num_skipped());
  }
  if (!malformed.ok()) context.TryCancel();
  const grpc::Status status = reader->Finish();
  if (!malformed.ok()) return absl::InternalError(absl::StrCat(impl_->name, ": ", malformed.message()));
  return FromGrpc(status, impl_->name);
}

}  // namespace evpose::client
