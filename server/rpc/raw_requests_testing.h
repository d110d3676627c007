// SPDX-License-Identifier: Apache-2.0

// The requests that create a session with raw stubs, and Track calls, for tests, benchmarks and fuzz targets.
#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.grpc.pb.h"

namespace evpose::server {

// A session with its newest resume token: the response of CreateSession.
class CreatedSession {
 public:
  const v1::Session& session() const { return response_.session(); }
  const std::string& name() const { return session().name(); }
  const v1::SessionConfig& config() const { return session().config(); }
  const v1::SessionHealth& health() const { return session().health(); }
  v1::SessionState state() const { return session().state(); }
  const google::protobuf::Timestamp& create_time() const { return session().create_time(); }
  const google::protobuf::Timestamp& expire_time() const { return session().expire_time(); }
  const std::string& resume_token() const { return response_.resume_token(); }
  void set_resume_token(const std::string& token) { response_.set_resume_token(token); }
  v1::Session* mutable_session() { return response_.mutable_session(); }
  v1::CreateSessionResponse* response() { return &response_; }

 private:
  v1::CreateSessionResponse response_;
};

// The first message of the upload of an OBJ file.
inline v1::UploadModelRequest UploadHeader(uint64_t size_bytes) {
  v1::UploadModelRequest request;
  request.mutable_header()->set_format(v1::MODEL_FORMAT_OBJ);
  request.mutable_header()->set_size_bytes(size_bytes);
  return request;
}

// Writes the header of a file of this size, and all of its bytes but one. Returns whether the stream was open.
inline bool WriteAllButOneByte(grpc::ClientWriter<v1::UploadModelRequest>& upload, uint64_t size_bytes) {
  v1::UploadModelRequest most;
  most.set_chunk(std::string(size_bytes - 1, ' '));
  return upload.Write(UploadHeader(size_bytes)) && upload.Write(most);
}

// The messages that upload an OBJ file.
inline std::vector<v1::UploadModelRequest> UploadRequests(const std::string& file) {
  std::vector<v1::UploadModelRequest> requests = {UploadHeader(file.size()), v1::UploadModelRequest()};
  requests[1].set_chunk(file);
  return requests;
}

// The messages that upload a serialized Mesh.
inline std::vector<v1::UploadModelRequest> MeshUploadRequests(const std::string& mesh) {
  std::vector<v1::UploadModelRequest> requests = UploadRequests(mesh);
  requests[0].mutable_header()->set_format(v1::MODEL_FORMAT_MESH);
  return requests;
}

inline grpc::Status UploadModel(v1::ModelService::Stub& models, const std::vector<v1::UploadModelRequest>& requests,
                                v1::Model* model) {
  grpc::ClientContext context;
  const auto stream = models.UploadModel(&context, model);
  for (const v1::UploadModelRequest& request : requests) {
    if (!stream->Write(request)) break;
  }
  stream->WritesDone();
  return stream->Finish();
}

// The request for a session with a cube one metre in front of a small camera, encoding FLAT64.
inline v1::CreateSessionRequest CubeSessionRequest(const std::string& model) {
  v1::CreateSessionRequest request;
  v1::SessionConfig& config = *request.mutable_config();
  config.set_encoding(v1::EVENT_ENCODING_FLAT64);
  v1::CameraModel& camera = *config.mutable_camera();
  camera.set_width_px(320);
  camera.set_height_px(240);
  camera.set_fx_px(300);
  camera.set_fy_px(300);
  camera.set_cx_px(160);
  camera.set_cy_px(120);
  v1::TrackedObject& object = *config.add_objects();
  object.set_object_id("cube");
  object.set_model(model);
  object.mutable_initial_camera_from_object()->mutable_translation_m()->set_z(1.0);
  object.mutable_initial_camera_from_object()->mutable_rotation()->set_w(1.0);
  return request;
}

// A Track call through the raw stub.
class RawTrack {
 public:
  // `traceparents`: values of the header of that name.
  explicit RawTrack(v1::SessionService::Stub& stub, const std::vector<std::string>& traceparents = {}) {
    for (const std::string& value : traceparents) context_.AddMetadata("traceparent", value);
    stream_ = stub.Track(&context_);
  }
  // Cancels and finishes the call, because gRPC requires every call to be finished.
  ~RawTrack() {
    context_.TryCancel();
    if (!is_finished_) Finish();
  }

  bool Write(const v1::TrackRequest& request) { return stream_->Write(request); }
  void WritesDone() { stream_->WritesDone(); }
  void Cancel() { context_.TryCancel(); }

  bool Attach(const CreatedSession& session, uint64_t last_pose_seq = 0) {
    return Attach(session.name(), session.resume_token(), last_pose_seq);
  }
  bool Attach(const std::string& session, const std::string& token, uint64_t last_pose_seq = 0) {
    v1::TrackRequest request;
    request.mutable_attach()->set_session(session);
    request.mutable_attach()->set_resume_token(token);
    request.mutable_attach()->set_last_pose_seq(last_pose_seq);
    return Write(request);
  }
  bool Events(uint64_t seq, const std::string& payload) {
    v1::TrackRequest request;
    request.mutable_events()->set_seq(seq);
    request.mutable_events()->set_payload(payload);
    return Write(request);
  }
  bool End() {
    v1::TrackRequest request;
    request.mutable_end();
    return Write(request);
  }

  bool Read(v1::TrackResponse& response) { return stream_->Read(&response); }
  // Reads up to the first response of this kind; the earlier ones are appended to `before`.
  bool ReadUntil(v1::TrackResponse::MessageCase kind, v1::TrackResponse& response,
                 std::vector<v1::TrackResponse>* before = nullptr) {
    while (Read(response)) {
      if (response.message_case() == kind) return true;
      if (before != nullptr) before->push_back(response);
    }
    return false;
  }
  // Reads the remaining responses and returns the final status.
  grpc::Status Finish() {
    v1::TrackResponse response;
    while (Read(response)) continue;
    is_finished_ = true;
    return stream_->Finish();
  }

 private:
  grpc::ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::TrackRequest, v1::TrackResponse>> stream_;
  bool is_finished_ = false;
};

}  // namespace evpose::server
