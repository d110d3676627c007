// A Track stream, sent any sequence of messages by the raw stub: the server answers with poses, acks and notices in
// their order, ends with a status that the API promises, and goes on serving.
#include <grpcpp/grpcpp.h>

#include <memory>
#include <set>
#include <string>
#include <thread>

#include "evpose/v1/models.grpc.pb.h"
#include "evpose/v1/sessions.grpc.pb.h"
#include "server/rpc/raw_requests.h"
#include "server/rpc/server_impl.h"
#include "server/sessions/testing.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"

namespace evpose {
namespace {

// One server for all inputs, with trackers that cost nothing.
class FuzzedServer {
 public:
  static FuzzedServer& Get() {
    static FuzzedServer server;  // ends before what its threads use: the log was gone when one of them wrote
    return server;
  }

  v1::SessionService::Stub& sessions() { return *sessions_; }

  v1::Session Create() {
    grpc::ClientContext context;
    v1::Session session;
    EVPOSE_FUZZ_REQUIRE(sessions_->CreateSession(&context, request_, &session).ok());
    return session;
  }
  void Delete(const std::string& name) {
    grpc::ClientContext context;
    v1::DeleteSessionRequest request;
    request.set_name(name);
    v1::DeleteSessionResponse response;
    EVPOSE_FUZZ_REQUIRE(sessions_->DeleteSession(&context, request, &response).ok());
  }

 private:
  FuzzedServer() {
    server::ServerOptions options;
    options.listen_address = "";
    options.worker_threads = 1;
    options.max_chunk_bytes = 1024;
    options.credit_bytes = 4096;
    server_ = server::StartServer(options, server::FakeTrackers()).value();
    const auto channel = server_->InProcessChannel();
    sessions_ = v1::SessionService::NewStub(channel);
    MakeRequest(*v1::ModelService::NewStub(channel));
  }

  void MakeRequest(v1::ModelService::Stub& models) {
    v1::Model model;
    EVPOSE_FUZZ_REQUIRE(server::UploadModel(models, server::UploadRequests(server::kCubeObj), &model).ok());
    request_ = server::CubeSessionRequest(model.name());
  }

  std::unique_ptr<server::Server> server_;
  std::unique_ptr<v1::SessionService::Stub> sessions_;
  v1::CreateSessionRequest request_;
};

void FillAttach(const v1::Session& session, const std::string& token, FuzzInput& input, v1::Attach& attach) {
  attach.set_session(input.Choice(16) == 0 ? "sessions/none" : session.name());
  attach.set_resume_token(input.Choice(16) == 0 ? input.Text(32) : token);
  if (input.Choice(8) == 0) attach.set_last_pose_seq(input.Byte());
}

void FillEvents(FuzzInput& input, uint64_t& next_seq, v1::EventChunk& events) {
  const int kind = input.Choice(8);
  events.set_seq(kind == 0 ? input.Byte() : next_seq);
  if (kind != 0) ++next_seq;
  events.set_discontinuity(input.Choice(8) == 0);
  if (input.Choice(8) == 0) events.set_crc32c(input.Byte());
  const size_t words = input.Byte();
  events.set_payload(input.Text(words * 8 + (input.Choice(16) == 0 ? 3 : 0)));
}

void FillReset(FuzzInput& input, v1::ResetPose& reset) {
  reset.set_object_id(input.Choice(4) == 0 ? input.Text(4) : "cube");
  reset.mutable_camera_from_object()->mutable_translation_m()->set_z(input.Byte());
  reset.mutable_camera_from_object()->mutable_rotation()->set_w(input.Choice(4) == 0 ? 0.5 : 1.0);
}

v1::TrackRequest NextRequest(const v1::Session& session, const std::string& token, FuzzInput& input,
                             uint64_t& next_seq) {
  v1::TrackRequest request;
  switch (input.Choice(8)) {
    case 0:
      FillAttach(session, token, input, *request.mutable_attach());
      break;
    case 1:
      FillReset(input, *request.mutable_reset_pose());
      break;
    case 2:
      request.mutable_end();
      break;
    case 3:
      (void)request.ParseFromString(input.Text(input.Byte()));
      break;
    default:
      FillEvents(input, next_seq, *request.mutable_events());
  }
  return request;
}

// What the server said on one stream.
struct Heard {
  std::string token;  // the newest
  uint64_t next_pose_seq = 1;
};

// Poses continue each other, acks never fall, `summary` is the last.
void Listen(grpc::ClientReaderWriter<v1::TrackRequest, v1::TrackResponse>& stream, Heard& heard) {
  v1::TrackResponse response;
  uint64_t processed_seq = 0;
  bool is_summarised = false;
  while (stream.Read(&response)) {
    EVPOSE_FUZZ_REQUIRE(!is_summarised);
    switch (response.message_case()) {
      case v1::TrackResponse::kAttached:
        heard.token = response.attached().resume_token();
        heard.next_pose_seq = response.attached().first_pose_seq();
        break;
      case v1::TrackResponse::kPose:
        EVPOSE_FUZZ_REQUIRE(response.pose().pose_seq() == heard.next_pose_seq);
        ++heard.next_pose_seq;
        break;
      case v1::TrackResponse::kAck:
        EVPOSE_FUZZ_REQUIRE(response.ack().processed_seq() >= processed_seq);
        EVPOSE_FUZZ_REQUIRE(response.ack().durable_seq() <= response.ack().processed_seq());
        processed_seq = response.ack().processed_seq();
        break;
      case v1::TrackResponse::kSummary:
        is_summarised = true;
        break;
      default:
        EVPOSE_FUZZ_REQUIRE(response.has_notice());
    }
  }
}

bool IsPromised(grpc::StatusCode code) {
  static const std::set<grpc::StatusCode> kPromised = {
      grpc::StatusCode::OK,        grpc::StatusCode::INVALID_ARGUMENT,  grpc::StatusCode::FAILED_PRECONDITION,
      grpc::StatusCode::NOT_FOUND, grpc::StatusCode::PERMISSION_DENIED, grpc::StatusCode::DATA_LOSS,
      grpc::StatusCode::ABORTED,   grpc::StatusCode::CANCELLED};
  return kPromised.count(code) > 0;
}

void RunStream(const v1::Session& session, FuzzInput& input, Heard& heard) {
  grpc::ClientContext context;
  const auto stream = FuzzedServer::Get().sessions().Track(&context);
  const std::string token = heard.token;
  std::thread listener([&] { Listen(*stream, heard); });  // who does not listen stops its own stream
  uint64_t next_seq = 1;
  const int num_messages = input.Choice(16);
  for (int i = 0; i < num_messages && !input.empty(); ++i) {
    if (!stream->Write(NextRequest(session, token, input, next_seq))) break;
  }
  if (input.Choice(8) == 0) context.TryCancel();
  stream->WritesDone();
  listener.join();
  EVPOSE_FUZZ_REQUIRE(IsPromised(stream->Finish().error_code()));
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  FuzzInput input(data, size);
  const v1::Session session = FuzzedServer::Get().Create();
  Heard heard{session.resume_token()};
  for (int i = 0; i < 3 && !input.empty(); ++i) RunStream(session, input, heard);
  FuzzedServer::Get().Delete(session.name());
  return 0;
}
