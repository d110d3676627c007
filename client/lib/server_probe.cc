// SPDX-License-Identifier: Apache-2.0

// The calls of ClientAccess that examine a server and the connection to it.
#include <algorithm>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "client/lib/client_access.h"
#include "client/lib/client_impl.h"
#include "client/lib/messages/status_details.h"
#include "core/numerics/random.h"
#include "grpc/health/v1/health.grpc.pb.h"

namespace evpose::client {
namespace {

// Size of a message that is below the limit of every server.
constexpr size_t kProbePieceBytes = size_t{32} * 1024;

// Bytes that a compressing link does not make smaller.
std::string RandomBytes(size_t num_bytes) {
  Random random(1);
  std::string bytes(num_bytes, '\0');
  for (char& byte : bytes) byte = static_cast<char>(random.NextU64());
  return bytes;
}

}  // namespace

absl::StatusOr<bool> ClientAccess::IsServing(Client& client) {
  using grpc::health::v1::HealthCheckResponse;
  const Client::Impl& impl = *client.impl_;
  const auto health = grpc::health::v1::Health::NewStub(impl.endpoint().connection()->channel);
  grpc::ClientContext context;
  context.set_deadline(absl::ToChronoTime(absl::Now() + impl.options.call_timeout));
  HealthCheckResponse response;
  const grpc::Status status = health->Check(&context, {}, &response);
  if (!status.ok()) return FromGrpc(status, impl.endpoint().name);
  return response.status() == HealthCheckResponse::SERVING;
}

absl::StatusOr<absl::Duration> ClientAccess::TimeUpload(Client& client, size_t num_bytes, absl::Duration timeout) {
  const Client::Impl& impl = *client.impl_;
  const std::string piece = RandomBytes(std::min(num_bytes, kProbePieceBytes));
  grpc::ClientContext context;
  const absl::Time begin = absl::Now();
  context.set_deadline(absl::ToChronoTime(begin + timeout));
  v1::Model model;
  const std::shared_ptr<const Connection> connection = impl.endpoint().connection();
  const auto writer = connection->models->UploadModel(&context, &model);
  v1::UploadModelRequest request;
  // The announced size is one byte more than is sent, so that the server refuses the file at its end, when it has
  // received and counted all bytes.
  request.mutable_header()->set_format(v1::MODEL_FORMAT_OBJ);
  request.mutable_header()->set_size_bytes(num_bytes + 1);
  bool is_open = writer->Write(request);
  for (size_t sent = 0; is_open && sent < num_bytes; sent += piece.size()) {
    request.set_chunk(piece.data(), std::min(piece.size(), num_bytes - sent));
    is_open = writer->Write(request);
  }
  if (is_open) writer->WritesDone();
  const absl::Status status = FromGrpc(writer->Finish(), impl.endpoint().name);
  const absl::Duration duration = absl::Now() - begin;
  if (absl::IsInvalidArgument(status) && GetDetails(status).field == "header.size_bytes") return duration;
  if (!status.ok()) return status;
  return absl::InternalError(absl::StrCat(impl.endpoint().name, ": accepts an incomplete file as a model"));
}

}  // namespace evpose::client
