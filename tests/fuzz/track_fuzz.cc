// SPDX-License-Identifier: Apache-2.0

// Fuzz target for the Track streams of one session, with any sequence of messages and any order of callbacks. Each
// stream receives poses, acks and notices in order, ends with a documented status and never waits forever, and the
// session remains usable. The reactor is that of the server; its callbacks, which gRPC would call, are called here one
// after the other.
#include <google/protobuf/stubs/logging.h>
#include <grpc/grpc.h>
#include <grpcpp/grpcpp.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "evpose/v1/session_service.pb.h"
#include "server/rpc/track_reactor.h"
#include "server/telemetry/log.h"
#include "tests/fuzz/fuzz_input.h"
#include "tests/fuzz/require.h"
#include "tests/fuzz/stepwise_server.h"

namespace evpose {
namespace {

// The state that the streams of a session share.
struct Shared {
  std::string session;
  std::string token;  // the newest
  int64_t t_us = 0;   // time of the newest event
  uint64_t max_seq_sent = 0;
};

void FillAttach(const Shared& shared, FuzzInput& input, v1::TrackRequest::Attach& attach) {
  attach.set_session(input.Choice(16) == 0 ? "sessions/none" : shared.session);
  attach.set_resume_token(input.Choice(16) == 0 ? input.Text(32) : shared.token);
  if (input.Choice(8) == 0) attach.set_last_pose_seq(input.Byte());
}

uint64_t NextSeq(FuzzInput& input, uint64_t& next_seq) { return input.Choice(8) == 0 ? input.Byte() : next_seq++; }

// Events made from one byte each, which determines the time since the previous event and the place; 0 is the corner of
// the image, where FakeTracker loses the object.
std::string SomeEvents(size_t count, FuzzInput& input, int64_t& t_us) {
  std::vector<Event> events;
  for (size_t i = 0; i < count; ++i) {
    const uint8_t byte = input.Byte();
    t_us += int64_t{200} * (byte % 16);
    const auto pixel = static_cast<uint16_t>(byte / 16);
    events.push_back({t_us, pixel, pixel, static_cast<uint8_t>(byte % 2)});
  }
  return server::Flat64(events);
}

// Payloads up to the maximum, or slightly larger.
void FillEvents(Shared& shared, FuzzInput& input, uint64_t& next_seq, v1::TrackRequest::EventChunk& events) {
  events.set_seq(NextSeq(input, next_seq));
  events.set_discontinuity(input.Choice(8) == 0);
  if (input.Choice(8) == 0) events.set_crc32c(input.Byte());
  const auto words = static_cast<size_t>(input.Choice(18));
  switch (input.Choice(8)) {
    case 0:
      events.set_payload(input.Text(words * 8));
      break;
    case 1:
      events.set_payload(input.Text(words));
      break;
    default:
      events.set_payload(SomeEvents(words, input, shared.t_us));
  }
}

void FillReset(FuzzInput& input, uint64_t& next_seq, v1::TrackRequest::ResetPose& reset) {
  reset.set_seq(NextSeq(input, next_seq));
  reset.set_object_id(input.Choice(4) == 0 ? input.Text(4) : "cube");
  reset.mutable_camera_from_object()->mutable_translation_m()->set_z(input.Byte());
  reset.mutable_camera_from_object()->mutable_rotation()->set_w(input.Choice(4) == 0 ? 0.5 : 1.0);
}

v1::TrackRequest NextRequest(Shared& shared, FuzzInput& input, uint64_t& next_seq) {
  v1::TrackRequest request;
  switch (input.Choice(8)) {
    case 0:
      FillAttach(shared, input, *request.mutable_attach());
      break;
    case 1:
      FillReset(input, next_seq, *request.mutable_reset_pose());
      break;
    case 2:
      request.mutable_end();
      break;
    case 3:
      (void)request.ParseFromString(input.Text(input.Byte()));
      break;
    default:
      FillEvents(shared, input, next_seq, *request.mutable_events());
  }
  return request;
}

bool IsPromised(grpc::StatusCode code) {
  static const std::set<grpc::StatusCode> kPromised = {
      grpc::StatusCode::OK,        grpc::StatusCode::INVALID_ARGUMENT,  grpc::StatusCode::FAILED_PRECONDITION,
      grpc::StatusCode::NOT_FOUND, grpc::StatusCode::PERMISSION_DENIED, grpc::StatusCode::DATA_LOSS,
      grpc::StatusCode::ABORTED,   grpc::StatusCode::CANCELLED};
  return kPromised.count(code) > 0;
}

// Checks the responses of one stream: `attached` first, consecutive poses, acks that never decrease, `summary` last.
class Listener {
 public:
  explicit Listener(Shared& shared) : shared_(shared) {}

  void Hear(const v1::TrackResponse& response) {
    EVPOSE_FUZZ_REQUIRE(!is_summarised_);
    EVPOSE_FUZZ_REQUIRE(response.has_attached() != is_attached_);
    switch (response.message_case()) {
      case v1::TrackResponse::kAttached:
        HearAttached(response.attached());
        break;
      case v1::TrackResponse::kPose:
        EVPOSE_FUZZ_REQUIRE(response.pose().pose_seq() == next_pose_seq_);
        ++next_pose_seq_;
        break;
      case v1::TrackResponse::kAck:
        HearAck(response.ack());
        break;
      case v1::TrackResponse::kSummary:
        is_summarised_ = true;
        break;
      default:
        EVPOSE_FUZZ_REQUIRE(response.has_notice());
    }
  }

  bool is_summarised() const { return is_summarised_; }

 private:
  void HearAttached(const v1::TrackResponse::Attached& attached) {
    is_attached_ = true;
    shared_.token = attached.resume_token();
    next_pose_seq_ = attached.first_pose_seq();
    send_limit_bytes_ = attached.send_limit_bytes();
  }

  void HearAck(const v1::TrackResponse::Ack& ack) {
    EVPOSE_FUZZ_REQUIRE(ack.processed_seq() >= processed_seq_);
    EVPOSE_FUZZ_REQUIRE(ack.processed_seq() <= shared_.max_seq_sent);
    EVPOSE_FUZZ_REQUIRE(ack.durable_seq() >= durable_seq_);
    EVPOSE_FUZZ_REQUIRE(ack.durable_seq() <= ack.processed_seq());
    EVPOSE_FUZZ_REQUIRE(ack.send_limit_bytes() >= send_limit_bytes_);
    processed_seq_ = ack.processed_seq();
    durable_seq_ = ack.durable_seq();
    send_limit_bytes_ = ack.send_limit_bytes();
  }

  Shared& shared_;
  bool is_attached_ = false;
  bool is_summarised_ = false;
  uint64_t next_pose_seq_ = 1;
  uint64_t processed_seq_ = 0;
  uint64_t durable_seq_ = 0;
  uint64_t send_limit_bytes_ = 0;
};

// Replaces gRPC and its client. An operation that the reactor starts is in progress until a step completes it.
class Stream : private grpc::ServerCallbackReaderWriter<v1::TrackRequest, v1::TrackResponse> {
 public:
  Stream(const server::ServiceContext& services, Shared& shared, FuzzInput& input)
      : shared_(shared),
        input_(input),
        num_messages_(input.Choice(16)),
        listener_(shared),
        reactor_(server::StartTrack(services, &context_)) {
    BindReactor(reactor_);
  }

  bool is_done() const { return reactor_ == nullptr; }
  // Breaks the connection: all further operations fail.
  void Break() { is_broken_ = true; }

  // Each completes an operation of its kind, and returns false if none is in progress.
  bool CompleteWrite() {
    if (written_ == nullptr) return false;
    EVPOSE_FUZZ_REQUIRE(std::exchange(written_, nullptr)->SerializeAsString() == written_bytes_);
    if (!is_broken_) Deliver();
    reactor_->OnWriteDone(!is_broken_);
    return true;
  }
  bool CompleteRead() {
    if (to_read_ == nullptr) return false;
    v1::TrackRequest& request = *std::exchange(to_read_, nullptr);
    has_read_all_ = is_broken_ || num_messages_-- == 0 || input_.empty() || !Receive(request);
    reactor_->OnReadDone(!has_read_all_);
    return true;
  }
  // Calls OnCancel() for a broken stream, or OnDone() for a finished one.
  bool CompleteCall() {
    if (is_done()) return false;
    if (is_broken_ && !std::exchange(is_cancelled_, true)) {
      reactor_->OnCancel();
      return true;
    }
    if (!status_.has_value() || is_under_way()) return false;
    CheckEnd();
    std::exchange(reactor_, nullptr)->OnDone();
    return true;
  }

 private:
  // Serializes and parses the message, as the transport does. False if it cannot be parsed, for example because of text
  // that is not UTF-8; gRPC treats this as the end of the stream.
  bool Receive(v1::TrackRequest& request) {
    const v1::TrackRequest next = NextRequest(shared_, input_, next_seq_);
    shared_.max_seq_sent = std::max({shared_.max_seq_sent, next.events().seq(), next.reset_pose().seq()});
    return request.ParseFromString(next.SerializeAsString());
  }
  void Deliver() {
    v1::TrackResponse response;
    EVPOSE_FUZZ_REQUIRE(response.ParseFromString(written_bytes_));
    listener_.Hear(response);
  }

  bool is_under_way() const { return to_read_ != nullptr || written_ != nullptr; }

  void CheckEnd() const {
    EVPOSE_FUZZ_REQUIRE(IsPromised(status_->error_code()));
    if (is_broken_) return;
    EVPOSE_FUZZ_REQUIRE(status_->error_code() != grpc::StatusCode::CANCELLED);
    EVPOSE_FUZZ_REQUIRE(!listener_.is_summarised() || status_->ok());
    EVPOSE_FUZZ_REQUIRE(!status_->ok() || listener_.is_summarised() || has_read_all_);
  }

  // The operations that the reactor starts. It may hold its lock, which its callbacks take; so no callback is called
  // here. At most one read and one write are in progress, and none starts after the end.
  void Read(v1::TrackRequest* request) override {
    EVPOSE_FUZZ_REQUIRE(to_read_ == nullptr && !status_.has_value());
    EVPOSE_FUZZ_REQUIRE(!has_read_all_);
    to_read_ = request;
  }
  void Write(const v1::TrackResponse* response, grpc::WriteOptions) override {
    EVPOSE_FUZZ_REQUIRE(written_ == nullptr && !status_.has_value());
    written_ = response;
    written_bytes_ = response->SerializeAsString();
  }
  void Finish(grpc::Status status) override {
    EVPOSE_FUZZ_REQUIRE(written_ == nullptr && !status_.has_value());
    status_ = std::move(status);
  }
  void WriteAndFinish(const v1::TrackResponse* response, grpc::WriteOptions options, grpc::Status status) override {
    Write(response, options);
    written_ = nullptr;
    if (!is_broken_) Deliver();
    Finish(std::move(status));
  }
  void SendInitialMetadata() override { std::abort(); }
  void CallOnDone() override { std::abort(); }
  grpc::internal::ServerReactor* reactor() override { return reactor_; }

  Shared& shared_;
  FuzzInput& input_;
  int num_messages_;  // remaining messages of the client
  uint64_t next_seq_ = 1;
  Listener listener_;
  v1::TrackRequest* to_read_ = nullptr;
  const v1::TrackResponse* written_ = nullptr;
  std::string written_bytes_;
  std::optional<grpc::Status> status_;
  bool is_broken_ = false;
  bool is_cancelled_ = false;
  bool has_read_all_ = false;
  grpc::CallbackServerContext context_;
  grpc::ServerBidiReactor<v1::TrackRequest, v1::TrackResponse>* reactor_;  // null when the call has ended
};

// A session and up to three streams. Each byte of the schedule chooses the next step among the possible ones; after the
// end of the schedule the first possible step is taken.
class Conversation {
 public:
  Conversation(StepwiseServer& server, FuzzInput schedule, FuzzInput& input)
      : server_(server), schedule_(schedule), input_(input) {
    const auto session = server.CreateSession();
    session_ = session;
    shared_ = {session->name(), session->resume_token()};
  }

  void Run() {
    while (OpenNext()) {
      while (Happens(schedule_.Byte())) {
      }
      EVPOSE_FUZZ_REQUIRE(AllAreDone());  // otherwise a stream would wait forever
    }
    server_.DeleteSession(shared_.session);
    while (server_.StepAny()) {
    }
    EVPOSE_FUZZ_REQUIRE(session_.expired());
    server_.RequireEmpty();
  }

 private:
  static constexpr size_t kMaxStreams = 3;
  static constexpr size_t kNumKinds = StepwiseServer::kNumWorkers + 3;

  // Bytes for rare incidents. Every other byte chooses an operation in progress.
  enum Incident : uint8_t { kOpen = 255, kBreak = 254, kGoAway = 253, kDelete = 252, kExpire = 251 };

  bool OpenNext() {
    if (streams_.size() == kMaxStreams || input_.empty()) return false;
    streams_.push_back(std::make_unique<Stream>(server_.context(), shared_, input_));
    return true;
  }

  bool AllAreDone() const {
    return std::all_of(streams_.begin(), streams_.end(), [](const auto& stream) { return stream->is_done(); });
  }

  // Takes the step that `byte` chooses. Returns false if no step is possible.
  bool Happens(uint8_t byte) {
    switch (byte) {
      case kOpen:
        (void)OpenNext();
        break;
      case kBreak:
        streams_[static_cast<size_t>(schedule_.Choice(static_cast<int>(streams_.size())))]->Break();
        break;
      case kGoAway:
        server_.context().streams.GoAway(absl::Seconds(1));
        break;
      case kDelete:
        server_.DeleteSession(shared_.session);
        break;
      case kExpire:
        server_.LetTimePass(absl::Hours(1));
        break;
      default:
        return AnyHappens(byte % kNumKinds, byte / kNumKinds);
    }
    return true;
  }

  bool AnyHappens(size_t first_kind, size_t first_stream) {
    for (size_t i = 0; i < kNumKinds; ++i) {
      if (KindHappens((first_kind + i) % kNumKinds, first_stream)) return true;
    }
    return false;
  }

  bool KindHappens(size_t kind, size_t first_stream) {
    if (kind < StepwiseServer::kNumWorkers) return server_.Step(kind);
    for (size_t i = 0; i < streams_.size(); ++i) {
      Stream& stream = *streams_[(first_stream + i) % streams_.size()];
      switch (kind - StepwiseServer::kNumWorkers) {
        case 0:
          if (stream.CompleteWrite()) return true;
          break;
        case 1:
          if (stream.CompleteRead()) return true;
          break;
        default:
          if (stream.CompleteCall()) return true;
      }
    }
    return false;
  }

  StepwiseServer& server_;
  FuzzInput schedule_;
  FuzzInput& input_;
  std::weak_ptr<server::Session> session_;
  Shared shared_;
  std::vector<std::unique_ptr<Stream>> streams_;
};

// Two servers: one without checkpoints, for which every processed chunk counts as durable, and one that writes
// checkpoints.
StepwiseServer& ServerFor(bool writes_checkpoints) {
  static const struct Libraries {
    Libraries() {
      grpc_init();                               // keeps gRPC initialized between the reactor's alarms, to save time
      google::protobuf::SetLogHandler(nullptr);  // would log a line for every text that is not UTF-8
    }
  } libraries;
  static StepwiseServer* const servers[] = {new StepwiseServer(false), new StepwiseServer(true)};
  return *servers[writes_checkpoints ? 1 : 0];
}

}  // namespace
}  // namespace evpose

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace evpose;
  FuzzInput input(data, size);
  const uint8_t flags = input.Byte();
  StepwiseServer& server = ServerFor(flags % 2 == 1);
  // For some inputs, lines of the log are formatted and discarded, to test that code; for all inputs it would take a
  // sixth of the time.
  server::SetLogLevel(flags / 2 % 8 == 7 ? server::LogLevel::kDebug : server::LogLevel::kOff);
  const absl::Span<const uint8_t> schedule = input.Bytes(input.Byte());
  Conversation(server, FuzzInput(schedule.data(), schedule.size()), input).Run();
  return 0;
}
