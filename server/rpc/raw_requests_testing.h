// SPDX-License-Identifier: Apache-2.0

// The requests that create a session with raw stubs, for tests, benchmarks and fuzz targets.
#pragma once

#include <grpcpp/grpcpp.h>

#include <cstdint>
#include <string>
#include <vector>

#include "evpose/v1/model_service.grpc.pb.h"
#include "evpose/v1/session_service.pb.h"

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

}  // namespace evpose::server
