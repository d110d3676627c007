// SPDX-License-Identifier: Apache-2.0
#include "evpose/client.h"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <random>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "client/lib/channel.h"
#include "client/lib/client_access.h"
#include "client/lib/client_impl.h"
#include "client/lib/messages/conversion.h"
#include "client/lib/messages/status_details.h"
#include "client/lib/server_choice.h"
#include "client/lib/stream/retry.h"
#include "client/lib/tcp_probe.h"
#include "client/lib/tls_probe.h"
#include "core/base/byte_order.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"

namespace evpose::client {
namespace {

constexpr size_t kUploadPieceBytes = size_t{256} * 1024;  // as the chunks of a recording
constexpr size_t kMaxModelBytes = size_t{64} << 20;       // the default limit of a server, for one that states none
// Time for which each server is waited for in turn. If the first server of the list cannot be reached, a longer time
// delays the use of the next one.
constexpr absl::Duration kConnectSlice = absl::Milliseconds(100);
// ServerInfo::store of a server that loses its sessions when it ends.
constexpr char kMemoryStore[] = "memory";

std::chrono::system_clock::time_point DeadlineIn(absl::Duration duration) {
  return absl::ToChronoTime(absl::Now() + duration);
}

// Returns the options with a token if only `renew_token` has one.
absl::StatusOr<ClientOptions> WithToken(ClientOptions options) {
  if (!options.token.empty() || !options.renew_token) return options;
  EVPOSE_ASSIGN_OR_RETURN(options.token, options.renew_token());
  return options;
}

// Returns the refusal of a session after `num_waits` delays.
absl::Status WithWaits(const absl::Status& refusal, int num_waits, absl::Duration waited) {
  if (num_waits == 0) return refusal;
  return WithMessage(refusal, absl::StrCat(refusal.message(), "; gave up after ", num_waits, " more tries in ",
                                           absl::FormatDuration(absl::Trunc(waited, absl::Milliseconds(100)))));
}

// Time after which the client checks whether TLS prevents the connection: a handshake that succeeds takes less.
constexpr absl::Duration kFirstWait = absl::Seconds(1);

}  // namespace

absl::StatusOr<ModelFormat> ModelFormatFromPath(const std::string& path) {
  const std::string extension = absl::AsciiStrToLower(std::filesystem::path(path).extension().string());
  if (extension == ".obj") return ModelFormat::kObj;
  if (extension == ".ply") return ModelFormat::kPly;
  if (extension == ".stl") return ModelFormat::kStl;
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": unknown model format; the name must end in .obj, .ply or .stl"));
}

std::string RandomRequestId() {
  std::random_device random;
  std::string id;
  for (int i = 0; i < 4; ++i) absl::StrAppend(&id, absl::Hex(random(), absl::kZeroPad8));
  return id;
}

// The characters that gRPC accepts in metadata.
bool IsToken(absl::string_view text) { return std::all_of(text.begin(), text.end(), absl::ascii_isgraph); }

absl::Status ClientOptions::Validate() const {
  if (connect_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("connect_timeout must be positive");
  if (call_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("call_timeout must be positive");
  if (tls.certificate_file.empty() != tls.key_file.empty()) {
    return absl::InvalidArgumentError("tls: a certificate needs its key, and a key its certificate");
  }
  if (!IsToken(token)) {
    return absl::InvalidArgumentError("token: has spaces, line feeds or other characters that are invalid in a token");
  }
  return absl::OkStatus();
}

Client::Client(const ClientOptions& options) : impl_(std::make_unique<Impl>()) { impl_->options = options; }
Client::~Client() = default;

absl::StatusOr<std::unique_ptr<Client>> Client::Connect(const std::string& addresses, const ClientOptions& given) {
  EVPOSE_ASSIGN_OR_RETURN(const ClientOptions options, WithToken(given));
  EVPOSE_RETURN_IF_ERROR(options.Validate());
  std::unique_ptr<Client> client(new Client(options));
  for (const absl::string_view part : absl::StrSplit(addresses, ',')) {
    const std::string address(part);
    EVPOSE_ASSIGN_OR_RETURN(std::shared_ptr<grpc::Channel> channel, MakeChannel(address, options));
    // Reads the certificates again, which may have been replaced.
    const auto make_channel = [address, options]() {
      return MakeChannel(address, options, /*shares_connection=*/false).value_or(nullptr);
    };
    client->impl_->endpoints.emplace_back(address, std::move(channel), make_channel);
  }
  const absl::Time deadline = absl::Now() + options.connect_timeout;
  EVPOSE_ASSIGN_OR_RETURN(bool is_connected, client->impl_->WaitForServer());
  const auto get_info = [&client] { return client->impl_->UnaryOnce(&Connection::admin, &Admin::GetServerInfo, {}); };
  absl::StatusOr<v1::ServerInfo> info = get_info();
  // If a server ends, or its connection breaks, before it responds, the next reachable server is used.
  while (is_connected && absl::IsUnavailable(info.status()) && absl::Now() < deadline) {
    absl::SleepFor(std::min(kConnectSlice, deadline - absl::Now()));
    is_connected = client->impl_->WaitForServerUntil(deadline);
    info = get_info();  // also without a connection: the status of the call then has the cause
  }
  if (!is_connected && client->impl_->IsCancelled()) {
    return absl::CancelledError(absl::StrCat("interrupted before a server responded at ", addresses));
  }
  if (info.ok()) {
    client->impl_->sessions_outlive_server = FromProto(*info).store != kMemoryStore;
    client->impl_->max_model_bytes = info->max_model_bytes();
    return client;
  }
  const std::string& name = client->impl_->endpoint().name;
  if (info.status().code() == absl::StatusCode::kUnimplemented) {
    return absl::UnimplementedError(absl::StrCat("the server at ", name, " is not an evpose server"));
  }
  if (is_connected) return info.status();
  // gRPC's description of an unknown name is that of its resolver.
  if (absl::StrContains(info.status().message(), "DNS resolution failed")) {
    const std::optional<TcpFailure> failure = ExplainUnreachable(name, kConnectSlice);
    if (failure)
      return absl::UnavailableError(absl::StrCat("no server at ", name, ": ", failure->cause, ": ", failure->remedy));
  }
  return absl::UnavailableError(absl::StrCat("no server at ", addresses, ": tried to connect for ",
                                             absl::ToDoubleSeconds(options.connect_timeout),
                                             " s; is evpose-server running there? (", info.status().message(), ")"));
}

std::unique_ptr<Client> ClientAccess::OverChannel(std::shared_ptr<grpc::Channel> channel, const std::string& name,
                                                  Clock& clock) {
  return OverChannels({{name, std::move(channel)}}, clock);
}

std::unique_ptr<Client> ClientAccess::OverChannels(
    const std::vector<std::pair<std::string, std::shared_ptr<grpc::Channel>>>& servers, Clock& clock) {
  std::unique_ptr<Client> client(new Client(ClientOptions()));
  client->impl_->clock = &clock;
  for (const auto& [name, channel] : servers) client->impl_->endpoints.emplace_back(name, channel);
  return client;
}

void ClientAccess::SetClock(Client& client, Clock& clock) { client.impl_->clock = &clock; }

absl::StatusOr<bool> Client::Impl::WaitForServer() {
  const absl::Time begin = absl::Now();
  const absl::Time deadline = begin + options.connect_timeout;
  for (const Endpoint& endpoint : endpoints) endpoint.connection()->channel->GetState(true);  // starts to connect
  if (WaitForServerUntil(std::min(deadline, begin + kFirstWait))) return true;
  if (IsCancelled()) return false;
  for (const Endpoint& endpoint : endpoints) {
    const std::string why = ExplainTls(endpoint.name, options.tls, kFirstWait);
    if (!why.empty()) return absl::FailedPreconditionError(absl::StrCat("server at ", endpoint.name, ": ", why));
  }
  return WaitForServerUntil(deadline);
}

bool Client::Impl::WaitForServerUntil(absl::Time deadline) {
  for (absl::Time now = absl::Now(); now < deadline; now = absl::Now()) {
    const absl::Duration wait = std::min(deadline - now, kConnectSlice);
    for (size_t i = 0; i < endpoints.size(); ++i) {
      current = i;
      if (endpoints[i].connection()->channel->WaitForConnected(DeadlineIn(wait))) return true;
    }
    if (IsCancelled()) return false;
  }
  return false;
}

absl::StatusOr<ServerInfo> Client::GetServerInfo() {
  EVPOSE_ASSIGN_OR_RETURN(const v1::ServerInfo info, impl_->Unary(&Connection::admin, &Admin::GetServerInfo, {}));
  return FromProto(info);
}

absl::StatusOr<uint32_t> Client::Drain(std::optional<absl::Duration> timeout) {
  v1::DrainRequest request;
  if (timeout) *request.mutable_timeout() = ToProto(*timeout);
  EVPOSE_ASSIGN_OR_RETURN(const v1::DrainResponse response,
                          impl_->UnaryOnce(&Connection::admin, &Admin::Drain, request));
  return response.remaining_sessions();
}

absl::StatusOr<LogLevel> Client::SetLogLevel(LogLevel level) {
  v1::SetLogLevelRequest request;
  request.set_level(ToProto(level));
  EVPOSE_ASSIGN_OR_RETURN(const v1::SetLogLevelResponse response,
                          impl_->UnaryOnce(&Connection::admin, &Admin::SetLogLevel, request));
  return FromProto(response.previous_level());
}

absl::StatusOr<ModelInfo> Client::UploadModel(absl::Span<const uint8_t> bytes, const UploadOptions& options) {
  absl::StatusOr<ModelInfo> model = impl_->TryUpload(bytes, options);
  // The server had the model and did not read the bytes, but another server has deleted the model since: the second
  // upload is read.
  if (absl::IsAborted(model.status())) model = impl_->TryUpload(bytes, options);
  return model;
}

absl::StatusOr<ModelInfo> Client::Impl::TryUpload(absl::Span<const uint8_t> bytes, const UploadOptions& upload) {
  v1::UploadModelRequest::Header header;
  header.set_format(ToProto(upload.format));
  header.set_metres_per_unit(upload.metres_per_unit);
  header.set_crease_angle_deg(upload.crease_angle_deg);
  header.set_surface(ToProto(upload.surface));
  header.set_file_name(upload.file_name);
  header.set_size_bytes(bytes.size());
  header.set_sha256(absl::HexStringToBytes(Sha256Hex(bytes)));
  // A model has the same name at all servers, and uploading it again has no effect.
  return AtAnyServer([&](const Endpoint& endpoint, absl::Time deadline) -> absl::StatusOr<ModelInfo> {
    grpc::ClientContext context;
    context.set_deadline(absl::ToChronoTime(deadline));
    v1::Model model;
    const std::shared_ptr<const Connection> connection = endpoint.connection();
    const std::unique_ptr<grpc::ClientWriterInterface<v1::UploadModelRequest>> writer =
        connection->models->UploadModel(&context, &model);
    v1::UploadModelRequest request;
    *request.mutable_header() = header;
    bool is_open = writer->Write(request);
    for (size_t begin = 0; is_open && begin < bytes.size(); begin += kUploadPieceBytes) {
      const absl::Span<const uint8_t> piece = bytes.subspan(begin, kUploadPieceBytes);
      request.set_chunk(piece.data(), piece.size());
      is_open = writer->Write(request);
    }
    if (is_open) writer->WritesDone();
    const grpc::Status status = writer->Finish();
    if (!status.ok()) return FromGrpc(status, endpoint.name);
    return FromProto(model);
  });
}

absl::StatusOr<ModelInfo> Client::UploadModelFile(const std::string& path, double metres_per_unit) {
  UploadOptions options;
  options.metres_per_unit = metres_per_unit;
  EVPOSE_ASSIGN_OR_RETURN(options.format, ModelFormatFromPath(path));
  const uint64_t max_bytes = impl_->max_model_bytes > 0 ? impl_->max_model_bytes : kMaxModelBytes;
  std::error_code error;
  if (const uint64_t size = std::filesystem::file_size(path, error); !error && size > max_bytes) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": has ", size, " bytes, but the server accepts models of at most ", max_bytes));
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path, max_bytes));
  return UploadModel(AsBytes(bytes), options);
}

absl::StatusOr<ModelInfo> Client::GetModel(const std::string& name, const std::stop_token& stop) {
  v1::GetModelRequest request;
  request.set_name(name);
  EVPOSE_ASSIGN_OR_RETURN(const v1::Model model, impl_->Unary(&Connection::models, &Models::GetModel, request, stop));
  return FromProto(model);
}

absl::StatusOr<std::vector<ModelInfo>> Client::ListModels() {
  std::vector<ModelInfo> models;
  const auto append = [&models](const v1::ListModelsResponse& page) {
    for (const v1::Model& model : page.models()) models.push_back(FromProto(model));
    return absl::OkStatus();
  };
  EVPOSE_RETURN_IF_ERROR(impl_->AllPages(&Connection::models, &Models::ListModels, append));
  return models;
}

absl::StatusOr<ModelGeometry> Client::GetModelGeometry(const std::string& name, uint32_t max_faces,
                                                       const std::stop_token& stop) {
  v1::GetModelGeometryRequest request;
  request.set_name(name);
  request.set_max_faces(max_faces);
  EVPOSE_ASSIGN_OR_RETURN(const v1::ModelGeometry message,
                          impl_->Unary(&Connection::models, &Models::GetModelGeometry, request, stop));
  absl::StatusOr<ModelGeometry> geometry = FromProto(message);
  if (geometry.ok()) return geometry;
  return absl::InternalError(absl::StrCat(impl_->endpoint().name, ": ", geometry.status().message()));
}

absl::Status Client::DeleteModel(const std::string& name) {
  v1::DeleteModelRequest request;
  request.set_name(name);
  const auto call = [&](const Endpoint& endpoint, absl::Time deadline) {
    auto deleted = Impl::UnaryAt(endpoint, deadline, &Connection::models, &Models::DeleteModel, request);
    request.set_allow_missing(true);  // the server may have deleted the model before it became unreachable
    return deleted;
  };
  return impl_->AtAnyServer(call).status();
}

absl::StatusOr<v1::CreateSessionResponse> Client::Impl::CreateWhereRoomIs(const v1::CreateSessionRequest& request,
                                                                          absl::Duration max_wait,
                                                                          const std::stop_token& stop) {
  const absl::Time begin = clock->Now();
  Backoff backoff((RetryOptions()));
  const auto create = [&](const Endpoint& endpoint, absl::Time deadline) {
    return UnaryAt(endpoint, deadline, &Connection::sessions, &Sessions::CreateSession, request, stop);
  };
  for (int num_waits = 0;; ++num_waits) {
    auto created = AtAnyServer(create, stop, /*skips_full_servers=*/true);
    const absl::Status& status = created.status();
    const absl::Duration retry_in = GetDetails(status).retry_in;
    if (!IsServerFull(status) || retry_in == absl::ZeroDuration()) return created;
    const absl::Duration delay = std::max(backoff.Next(), retry_in);
    const absl::Duration waited = clock->Now() - begin;
    if (waited + delay > max_wait) return WithWaits(status, num_waits, waited);
    if (!clock->SleepUntil(clock->Now() + delay, stop)) {
      return absl::CancelledError(absl::StrCat(endpoint().name, ": the call was cancelled"));
    }
  }
}

absl::StatusOr<Session> Client::CreateSession(const SessionConfig& config, const std::string& request_id,
                                              absl::Duration max_wait, const std::stop_token& stop) {
  v1::CreateSessionRequest request;
  // A server may have created the session before it became unreachable: the next one then returns this session.
  const bool may_repeat = impl_->endpoints.size() > 1;
  request.set_request_id(request_id.empty() && may_repeat ? RandomRequestId() : request_id);
  *request.mutable_config() = ToProto(config);
  EVPOSE_ASSIGN_OR_RETURN(const v1::CreateSessionResponse created, impl_->CreateWhereRoomIs(request, max_wait, stop));
  if (created.session().name().empty()) {
    return absl::InternalError(
        absl::StrCat(impl_->endpoint().name, ": the server violates the protocol: the new session has no name"));
  }
  return FromProto(created);
}

absl::StatusOr<Session> Client::GetSession(const std::string& name, const std::stop_token& stop) {
  v1::GetSessionRequest request;
  request.set_name(name);
  EVPOSE_ASSIGN_OR_RETURN(const v1::Session session,
                          impl_->Unary(&Connection::sessions, &Sessions::GetSession, request, stop));
  return FromProto(session);
}

absl::StatusOr<std::vector<Session>> Client::ListSessions(const std::stop_token& stop) {
  std::vector<Session> sessions;
  const auto append = [&sessions](const v1::ListSessionsResponse& page) {
    for (const v1::Session& message : page.sessions()) {
      EVPOSE_ASSIGN_OR_RETURN(Session session, FromProto(message));
      sessions.push_back(std::move(session));
    }
    return absl::OkStatus();
  };
  EVPOSE_RETURN_IF_ERROR(impl_->AllPages(&Connection::sessions, &Sessions::ListSessions, append, stop));
  return sessions;
}

absl::Status Client::DeleteSession(const std::string& name) {
  v1::DeleteSessionRequest request;
  request.set_name(name);
  request.set_allow_missing(true);
  return impl_->Unary(&Connection::sessions, &Sessions::DeleteSession, request).status();
}

}  // namespace evpose::client
