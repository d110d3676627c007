// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "evpose/v1/model_service.grpc.pb.h"
#include "server/rpc/common/service_context.h"

namespace evpose::server {

// Implements ModelService; errors are documented in proto/evpose/v1/model_service.proto.
class ModelServiceImpl : public v1::ModelService::CallbackService {
 public:
  explicit ModelServiceImpl(const ServiceContext& services) : services_(services) {}

  grpc::ServerReadReactor<v1::UploadModelRequest>* UploadModel(grpc::CallbackServerContext* context,
                                                               v1::Model* response) override;
  grpc::ServerUnaryReactor* GetModel(grpc::CallbackServerContext* context, const v1::GetModelRequest* request,
                                     v1::Model* response) override;
  grpc::ServerUnaryReactor* ListModels(grpc::CallbackServerContext* context, const v1::ListModelsRequest* request,
                                       v1::ListModelsResponse* response) override;
  grpc::ServerUnaryReactor* GetModelGeometry(grpc::CallbackServerContext* context,
                                             const v1::GetModelGeometryRequest* request,
                                             v1::ModelGeometry* response) override;
  grpc::ServerUnaryReactor* DeleteModel(grpc::CallbackServerContext* context, const v1::DeleteModelRequest* request,
                                        google::protobuf::Empty* response) override;

 private:
  const ServiceContext services_;
};

}  // namespace evpose::server
