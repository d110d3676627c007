// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/model_geometry_reactor.h"

#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/models/display_geometry.h"
#include "server/rpc/common/authentication.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

constexpr uint32_t kMaxFaces = 100'000;  // as the API states; bounds the response

void SetGeometry(const DisplayGeometry& geometry, v1::ModelGeometry& out) {
  out.mutable_vertices_m()->Reserve(static_cast<int>(3 * geometry.vertices.size()));
  for (const Eigen::Vector3f& vertex : geometry.vertices) out.mutable_vertices_m()->Add(vertex.begin(), vertex.end());
  out.mutable_faces()->Reserve(static_cast<int>(3 * geometry.faces.size()));
  for (const auto& face : geometry.faces) out.mutable_faces()->Add(face.begin(), face.end());
  out.mutable_edges_m()->Reserve(static_cast<int>(6 * geometry.edges.size()));
  for (const auto& [p1, p2] : geometry.edges) {
    out.mutable_edges_m()->Add(p1.begin(), p1.end());
    out.mutable_edges_m()->Add(p2.begin(), p2.end());
  }
  out.set_simplified(geometry.is_simplified);
}

// Loads and simplifies the model on the threads for the preparation of models, in the turn of its tenant.
class GeometryReactor : public UnaryReactor {
 public:
  GeometryReactor(ModelRegistry& models, MemoryBudget& memory, const ResponseLimits& limits,
                  grpc::CallbackServerContext& context, const v1::GetModelGeometryRequest& request,
                  v1::ModelGeometry& response)
      : UnaryReactor(limits, context, response),
        models_(models),
        memory_(memory),
        request_(request),
        response_(response) {}

  void Start(SlowExecutor& preparations, const absl::StatusOr<Caller>& caller) {
    if (!caller.ok()) return Refuse(caller.status());
    if (request_.max_faces() > kMaxFaces) {
      return Refuse(InvalidField("max_faces",
                                 absl::StrCat("is ", request_.max_faces(), "; at most ", kMaxFaces, " are returned")));
    }
    // gRPC does not call OnDone() before Finish().
    const absl::Status posted = preparations.TryPost(
        caller->tenant,
        [this, tenant = caller->tenant](const absl::Status& admitted) {
          Answer(tenant, admitted.ok() ? OrOutOfMemory([&] { return SetResponse(tenant); }) : admitted);
        },
        cancellation());  // a call that waits is finished in its turn, without work
    if (!posted.ok()) Refuse(posted);
  }

 private:
  absl::Status SetResponse(const std::string& tenant) {
    std::shared_ptr<const ObjectModel> model;
    {
      // The model may be deleted while it is simplified.
      const absl::StatusOr<ModelUse> use = models_.UseStored(tenant, request_.name());
      if (absl::IsDataLoss(use.status())) {
        return WithReason(absl::DataLossError(absl::StrCat(request_.name(),
                                                           " cannot be read; delete it and upload it "
                                                           "again: ",
                                                           use.status().message())),
                          v1::MODEL_DAMAGED);
      }
      EVPOSE_RETURN_IF_ERROR(use.status());
      model = use->model;
    }
    EVPOSE_RETURN_IF_ERROR(cancellation()->status());
    EVPOSE_ASSIGN_OR_RETURN(const MemoryCharge charge, memory_.Charge(tenant, {}, MemoryOfModels({model})));
    DisplayLimits limits;
    if (request_.max_faces() != 0) limits.max_faces = request_.max_faces();
    SetGeometry(MakeDisplayGeometry(*model, limits), response_);
    return absl::OkStatus();
  }

  ModelRegistry& models_;
  MemoryBudget& memory_;
  const v1::GetModelGeometryRequest& request_;
  v1::ModelGeometry& response_;
};

}  // namespace

grpc::ServerUnaryReactor* StartGetModelGeometry(ModelRegistry& models, SlowExecutor& preparations, MemoryBudget& memory,
                                                const ResponseLimits& limits, const absl::StatusOr<Caller>& caller,
                                                grpc::CallbackServerContext& context,
                                                const v1::GetModelGeometryRequest& request,
                                                v1::ModelGeometry& response) {
  auto* const reactor = new GeometryReactor(models, memory, limits, context, request, response);
  reactor->Start(preparations, caller);
  return reactor;
}

}  // namespace evpose::server
