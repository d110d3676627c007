// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/transport_sink.h"

#include <grpcpp/create_channel.h>
#include <grpcpp/server_builder.h>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "client/lib/client_access.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::client {
namespace {

// The defaults of evpose-server.
constexpr uint64_t kCreditBytes = 4 << 20;
constexpr uint32_t kMaxChunkBytes = 1 << 20;

class SinkService final : public v1::SessionService::Service {
 public:
  grpc::Status Track(grpc::ServerContext*,
                     grpc::ServerReaderWriter<v1::TrackResponse, v1::TrackRequest>* stream) override {
    v1::TrackRequest request;
    if (!stream->Read(&request) || !request.has_attach()) {
      return grpc::Status(grpc::StatusCode::INVALID_ARGUMENT, "the first message is not attach");
    }
    v1::TrackResponse response;
    response.mutable_attached()->set_next_seq(1);
    response.mutable_attached()->set_first_pose_seq(1);
    response.mutable_attached()->set_send_limit_bytes(kCreditBytes);
    response.mutable_attached()->set_max_chunk_bytes(kMaxChunkBytes);
    stream->Write(response);
    uint64_t received_bytes = 0;
    while (stream->Read(&request) && request.has_events()) {
      received_bytes += request.events().payload().size();
      v1::TrackResponse::Ack& ack = *response.mutable_ack();
      ack.set_processed_seq(request.events().seq());
      ack.set_durable_seq(request.events().seq());
      ack.set_send_limit_bytes(received_bytes + kCreditBytes);
      stream->Write(response);
    }
    v1::SessionHealth& health = *response.mutable_summary()->mutable_health();
    health.set_received_bytes(received_bytes);
    health.set_processed_bytes(received_bytes);
    stream->Write(response);
    return grpc::Status::OK;
  }
};

}  // namespace

TransportSink::TransportSink() : service_(std::make_unique<SinkService>()) {}

TransportSink::~TransportSink() {
  client_.reset();
  if (server_ != nullptr) server_->Shutdown(absl::ToChronoTime(absl::Now()));
}

absl::StatusOr<std::unique_ptr<TransportSink>> TransportSink::Start() {
  std::unique_ptr<TransportSink> sink(new TransportSink());
  int port = 0;
  grpc::ServerBuilder builder;
  builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
  builder.RegisterService(sink->service_.get());
  sink->server_ = builder.BuildAndStart();
  if (sink->server_ == nullptr || port == 0) {
    return absl::UnavailableError("the server of the benchmark cannot listen on 127.0.0.1: no port is free");
  }
  const std::string address = absl::StrCat("127.0.0.1:", port);
  sink->client_ = ClientAccess::OverChannel(grpc::CreateChannel(address, grpc::InsecureChannelCredentials()), address);
  return sink;
}

Session TransportSink::session() { return {.name = "sessions/transport", .resume_token = "transport"}; }

}  // namespace evpose::client
