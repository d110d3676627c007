#include "server/rpc/model_service.h"

#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/rpc/conversion.h"
#include "server/rpc/status_mapping.h"
#include "server/sessions/errors.h"

namespace evpose::server {
namespace {

constexpr size_t kSha256Bytes = 32;

// Takes the file piece by piece, then loads it on a worker. Deletes itself when the call is over. Its reactions follow
// one another, a read is started when the one before was handled; the lock says so to those who cannot see into gRPC.
class UploadReactor : public grpc::ServerReadReactor<v1::UploadModelRequest> {
 public:
  UploadReactor(const ServiceContext& services, v1::Model* response) : services_(services), response_(response) {
    StartRead(&request_);
  }

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    if (!ok) return Load();
    if (const absl::Status status = HandleRequest(); !status.ok()) return Finish(ToGrpcStatus(status));
    StartRead(&request_);
  }

  void OnDone() override {
    { const std::lock_guard lock(mutex_); }
    delete this;
  }

 private:
  absl::Status HandleRequest() {
    switch (request_.message_case()) {
      case v1::UploadModelRequest::kHeader:
        return HandleHeader(request_.header());
      case v1::UploadModelRequest::kChunk:
        return HandleChunk(request_.chunk());
      default:
        return InvalidField("message", "is empty: header or chunk is expected");
    }
  }

  absl::Status HandleHeader(const v1::UploadModelRequest::Header& header) {
    if (reservation_ != nullptr) return InvalidField("header", "was sent already");
    EVPOSE_RETURN_IF_ERROR(services_.sessions.CheckNotDraining());
    EVPOSE_ASSIGN_OR_RETURN(reading_, FromProto(header));
    if (!header.sha256().empty() && header.sha256().size() != kSha256Bytes) {
      return InvalidField("header.sha256",
                          absl::StrCat("has ", header.sha256().size(), " bytes; a SHA-256 has ", kSha256Bytes));
    }
    EVPOSE_ASSIGN_OR_RETURN(reservation_, services_.models.Reserve(header.size_bytes()));
    size_bytes_ = header.size_bytes();
    sha256_hex_ = absl::BytesToHexString(header.sha256());
    return absl::OkStatus();
  }

  absl::Status HandleChunk(const std::string& chunk) {
    if (reservation_ == nullptr) return InvalidField("header", "must be the first message of the stream");
    if (chunk.size() > size_bytes_ - bytes_.size()) {
      return InvalidField("header.size_bytes", absl::StrCat("is ", size_bytes_, ", but more bytes came"));
    }
    bytes_.insert(bytes_.end(), chunk.begin(), chunk.end());
    return absl::OkStatus();
  }

  void Load() {
    if (reservation_ == nullptr) {
      return Finish(ToGrpcStatus(InvalidField("header", "must be the first message of the stream")));
    }
    if (bytes_.size() != size_bytes_) {
      return Finish(ToGrpcStatus(InvalidField(
          "header.size_bytes", absl::StrCat("is ", size_bytes_, ", but only ", bytes_.size(), " bytes came"))));
    }
    services_.pool.Post([this] {
      const std::lock_guard lock(mutex_);
      const auto model = services_.models.Upload(reading_, sha256_hex_,
                                                 std::make_shared<const std::vector<uint8_t>>(std::move(bytes_)));
      if (model.ok()) *response_ = ToProto(*model);
      reservation_.reset();
      Finish(ToGrpcStatus(model.status()));
    });
  }

  const ServiceContext services_;
  v1::Model* const response_;
  std::mutex mutex_;
  v1::UploadModelRequest request_;
  ModelReading reading_;
  std::string sha256_hex_;
  uint64_t size_bytes_ = 0;
  std::unique_ptr<ModelRegistry::Reservation> reservation_;  // null: the header has not come yet
  std::vector<uint8_t> bytes_;
};

absl::Status List(const ModelRegistry& models, const v1::ListModelsRequest& request, v1::ListModelsResponse& response) {
  EVPOSE_ASSIGN_OR_RETURN(const size_t page_size, PageSize(request.page_size()));
  EVPOSE_ASSIGN_OR_RETURN(const std::string after_name, PageStart(request.page_token(), "models/"));
  for (const ModelInfo& model : models.List(after_name, page_size + 1)) {
    if (response.models_size() == static_cast<int>(page_size)) {
      response.set_next_page_token(response.models().rbegin()->name());
      break;
    }
    *response.add_models() = ToProto(model);
  }
  return absl::OkStatus();
}

}  // namespace

grpc::ServerReadReactor<v1::UploadModelRequest>* ModelServiceImpl::UploadModel(grpc::CallbackServerContext*,
                                                                               v1::Model* response) {
  return new UploadReactor(services_, response);
}

grpc::ServerUnaryReactor* ModelServiceImpl::GetModel(grpc::CallbackServerContext* context,
                                                     const v1::GetModelRequest* request, v1::Model* response) {
  const auto model = services_.models.Get(request->name());
  if (model.ok()) *response = ToProto(*model);
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpcStatus(model.status()));
  return reactor;
}

grpc::ServerUnaryReactor* ModelServiceImpl::ListModels(grpc::CallbackServerContext* context,
                                                       const v1::ListModelsRequest* request,
                                                       v1::ListModelsResponse* response) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpcStatus(List(services_.models, *request, *response)));
  return reactor;
}

grpc::ServerUnaryReactor* ModelServiceImpl::DeleteModel(grpc::CallbackServerContext* context,
                                                        const v1::DeleteModelRequest* request,
                                                        v1::DeleteModelResponse*) {
  grpc::ServerUnaryReactor* reactor = context->DefaultReactor();
  reactor->Finish(ToGrpcStatus(services_.models.Delete(request->name())));
  return reactor;
}

}  // namespace evpose::server
