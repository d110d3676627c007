// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/model_service.h"

#include <algorithm>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "server/rpc/common/authentication.h"
#include "server/rpc/common/call_alarm.h"
#include "server/rpc/common/conversion.h"
#include "server/rpc/common/pending_response.h"
#include "server/rpc/common/status_mapping.h"
#include "server/rpc/common/stream_registry.h"
#include "server/rpc/model_geometry_reactor.h"
#include "server/rpc/standard_methods.h"
#include "server/runtime/client_text.h"
#include "server/runtime/errors.h"
#include "server/runtime/out_of_memory.h"

namespace evpose::server {
namespace {

constexpr size_t kSha256Bytes = 32;

absl::Status ModelWasDeleted(const std::string& name) {
  return WithReason(absl::AbortedError(absl::StrCat(name, " was deleted by another server: upload it once more")),
                    v1::MODEL_DELETED, {{"model", name}});
}

// Receives the chunks of a file, then has it prepared on the pool's threads for that. Reads are sequential: a read is
// started after the previous message has been handled. The alarm and OnCancel() are asynchronous; the alarm ends the
// call when the next message, or the whole file, does not arrive in time.
class UploadReactor : public grpc::ServerReadReactor<v1::UploadModelRequest>,
                      public OpenStream,
                      public std::enable_shared_from_this<UploadReactor> {
 public:
  UploadReactor(const ServiceContext& services, grpc::CallbackServerContext* context, v1::Model* response)
      : services_(services),
        context_(context),
        access_version_(services.authenticator.version()),
        caller_(Authenticate(services.authenticator, *context)),
        response_(response),
        pending_(std::make_shared<PendingResponse>(LimitsOf(services), *context)) {}

  void Start() {
    self_ = shared_from_this();
    services_.streams.Add(StreamRegistry::Kind::kUpload, self_);
    const std::lock_guard lock(mutex_);
    if (is_finished_) return;  // the server is shutting down
    if (!caller_.ok()) return FinishWith(caller_.status());
    auto reservation = services_.models.limits().BeginUpload(caller_->tenant);
    if (!reservation.ok()) return FinishWith(reservation.status());
    reservation_ = *std::move(reservation);
    deadline_ = absl::Now() + services_.upload_timeout;
    if (const absl::Status status = Read(); !status.ok()) FinishWith(status);
  }

  void OnCancel() override { End(absl::CancelledError("the client cancelled")); }

  void GoAway(absl::Duration) override {}

  // The work of the call ends early: what waits is not run, what runs is ended.
  void End(const absl::Status& status) override {
    cancellation_->Cancel();
    const std::lock_guard lock(mutex_);
    if (!is_finished_) FinishWith(status);
  }

  void CheckAccess(const AccessCheck& check) override {
    absl::Status access;
    {
      const std::lock_guard lock(mutex_);
      if (is_finished_) return;
      access = StillAdmitted(services_.authenticator, *context_, caller_, check, access_version_);
    }
    if (!access.ok()) End(access);
  }

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(mutex_);
    ++messages_;
    if (is_finished_) return;
    alarm_.Cancel();
    const absl::Status status = OrOutOfMemory([this, ok]() ABSL_NO_THREAD_SAFETY_ANALYSIS {
      if (!ok) return Load();
      EVPOSE_RETURN_IF_ERROR(HandleRequest());
      return Read();
    });
    if (!status.ok()) FinishWith(status);
  }

  void OnDone() override {
    services_.streams.Remove(this);
    pending_->End();
    const std::shared_ptr<UploadReactor> last = std::move(self_);
  }

 private:
  struct KnownFile {
    ModelRegistry::Known model;
    Sha256 digest;
  };

  absl::Status Read() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    const absl::Duration max_wait = std::min(services_.attach_timeout, deadline_ - absl::Now());
    EVPOSE_RETURN_IF_ERROR(alarm_.Set(max_wait, [weak = weak_from_this(), awaited = messages_] {
      if (const auto self = weak.lock()) self->OnAlarm(awaited);
    }));
    StartRead(&request_);
    return absl::OkStatus();
  }

  void OnAlarm(uint64_t awaited) {
    const std::lock_guard lock(mutex_);
    if (is_finished_ || messages_ != awaited) return;
    const bool is_late = absl::Now() >= deadline_;
    FinishWith(OrOutOfMemory([this, is_late] {
      return WithReason(
          absl::DeadlineExceededError(absl::StrCat(
              is_late ? "the file did not arrive within " : "the next message of the upload did not arrive within ",
              absl::FormatDuration(is_late ? services_.upload_timeout : services_.attach_timeout))),
          v1::UPLOAD_TIMEOUT);
    }));
  }

  void FinishWith(const absl::Status& status) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    is_finished_ = true;
    alarm_.Cancel();
    reservation_.reset();
    bytes_ = std::vector<uint8_t>();
    known_.reset();
    Finish(ToGrpcStatus(status));
  }

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
    if (has_header_) return InvalidField("header", "was sent already");
    EVPOSE_RETURN_IF_ERROR(services_.sessions.CheckNotDraining());
    EVPOSE_ASSIGN_OR_RETURN(reading_, FromProto(header));
    if (!header.sha256().empty() && header.sha256().size() != kSha256Bytes) {
      return InvalidField("header.sha256",
                          absl::StrCat("has ", header.sha256().size(), " bytes; a SHA-256 has ", kSha256Bytes));
    }
    constexpr size_t kMaxFileNameBytes = 255;  // as file systems have
    if (header.file_name().size() > kMaxFileNameBytes) {
      return InvalidField("header.file_name", absl::StrCat("has ", header.file_name().size(),
                                                           " bytes; a file name has at most ", kMaxFileNameBytes));
    }
    if (!IsPlainText(header.file_name())) {
      return InvalidField("header.file_name", "has a character that is not printable: remove it");
    }
    file_name_ = header.file_name();
    sha256_hex_ = absl::BytesToHexString(header.sha256());
    size_bytes_ = header.size_bytes();
    auto known = services_.models.FindFile(caller_->tenant, reading_, size_bytes_, sha256_hex_);
    if (known.has_value()) {
      known_ = std::make_unique<KnownFile>();
      known_->model = *std::move(known);
    } else {
      EVPOSE_RETURN_IF_ERROR(reservation_->Declare(size_bytes_));
    }
    has_header_ = true;
    return absl::OkStatus();
  }

  absl::Status HandleChunk(const std::string& chunk) {
    if (!has_header_) return InvalidField("header", "must be the first message of the stream");
    if (chunk.size() > size_bytes_ - received_bytes_) {
      return InvalidField("header.size_bytes", absl::StrCat("is ", size_bytes_, ", but more bytes were received"));
    }
    received_bytes_ += chunk.size();
    if (known_ != nullptr) {
      // The server has the file already; only the digest of the received bytes is needed.
      known_->digest.Update({reinterpret_cast<const uint8_t*>(chunk.data()), chunk.size()});
    } else {
      EVPOSE_RETURN_IF_ERROR(reservation_->Add(chunk.size()));
      bytes_.insert(bytes_.end(), chunk.begin(), chunk.end());
    }
    return absl::OkStatus();
  }

  absl::Status Load() {
    if (!has_header_) return InvalidField("header", "must be the first message of the stream");
    if (received_bytes_ != size_bytes_) {
      return InvalidField("header.size_bytes",
                          absl::StrCat("is ", size_bytes_, ", but only ", received_bytes_, " bytes were received"));
    }
    // The tasks hold a reference, because OnDone() may run on another thread before they end.
    if (known_ == nullptr) {
      return services_.pool.preparations().TryPost(
          caller_->tenant,
          [this, self = shared_from_this()](const absl::Status& admitted) {
            Complete(admitted, &UploadReactor::Prepare);
          },
          cancellation_);
    }
    EVPOSE_RETURN_IF_ERROR(CheckSha256(sha256_hex_, known_->digest.FinishHex(), size_bytes_));
    return services_.pool.slow().TryPost(
        caller_->tenant,
        [this, self = shared_from_this()](const absl::Status& admitted) {
          Complete(admitted, &UploadReactor::FindKnown);
        },
        cancellation_);
  }

  // Ends the call with the model that `make()` returns. `make` runs without the lock, which OnCancel() takes.
  void Complete(const absl::Status& admitted, absl::StatusOr<ModelInfo> (UploadReactor::*make)()) {
    const auto model = OrOutOfMemory([&]() -> absl::StatusOr<ModelInfo> {
      EVPOSE_RETURN_IF_ERROR(admitted);
      return (this->*make)();
    });
    const std::lock_guard lock(mutex_);
    if (is_finished_) return;
    FinishWith(OrOutOfMemory([&]() -> absl::Status {
      EVPOSE_RETURN_IF_ERROR(model.status());
      *response_ = ToProto(*model);
      return pending_->Begin(caller_->tenant, *response_);
    }));
  }

  absl::StatusOr<ModelInfo> Prepare() {
    std::shared_ptr<const std::vector<uint8_t>> file;
    {
      const std::lock_guard lock(mutex_);
      if (is_finished_) return absl::CancelledError("the call has ended");
      file = std::make_shared<const std::vector<uint8_t>>(std::move(bytes_));
    }
    return services_.models.Upload(caller_->tenant, reading_, sha256_hex_, std::move(file), *cancellation_, file_name_);
  }

  absl::StatusOr<ModelInfo> FindKnown() {
    ModelInfo info;
    {
      const std::lock_guard lock(mutex_);
      if (is_finished_) return absl::CancelledError("the call has ended");
      info = known_->model.info;
    }
    const absl::Status stored = services_.models.CheckStored(caller_->tenant, info.name);
    if (absl::IsNotFound(stored)) return ModelWasDeleted(info.name);
    EVPOSE_RETURN_IF_ERROR(stored);
    return info;
  }

  const ServiceContext services_;
  grpc::CallbackServerContext* const context_;
  uint64_t access_version_;  // used by CheckAccess() only, with the lock
  const absl::StatusOr<Caller> caller_;
  v1::Model* const response_;
  const std::shared_ptr<PendingResponse> pending_;
  std::shared_ptr<UploadReactor> self_;  // until OnDone
  std::mutex mutex_;
  CallAlarm alarm_;
  uint64_t messages_ = 0;  // completed reads, so that an alarm of an earlier read is recognized
  bool is_finished_ = false;
  v1::UploadModelRequest request_;
  ModelReading reading_;
  std::string file_name_;
  std::string sha256_hex_;
  bool has_header_ = false;
  uint64_t size_bytes_ = 0;
  uint64_t received_bytes_ = 0;
  const std::shared_ptr<Cancellation> cancellation_ = std::make_shared<Cancellation>();
  absl::Time deadline_;                               // time by which the last byte of the file must arrive
  std::unique_ptr<ModelLimits::Upload> reservation_;  // counts bytes_
  std::vector<uint8_t> bytes_;
  std::unique_ptr<KnownFile> known_;  // not null: the file is known, and bytes_ stays empty
};

absl::Status List(const ModelRegistry& models, const std::string& tenant, const v1::ListModelsRequest& request,
                  v1::ListModelsResponse& response) {
  EVPOSE_ASSIGN_OR_RETURN(const size_t page_size, PageSize(request.page_size()));
  EVPOSE_ASSIGN_OR_RETURN(const std::string after_name, PageStart(request.page_token(), "models/"));
  for (const ModelInfo& model : models.List(tenant, after_name, page_size + 1)) {
    if (response.models_size() == static_cast<int>(page_size)) {
      response.set_next_page_token(response.models().rbegin()->name());
      break;
    }
    *response.add_models() = ToProto(model);
  }
  return absl::OkStatus();
}

}  // namespace

grpc::ServerReadReactor<v1::UploadModelRequest>* ModelServiceImpl::UploadModel(grpc::CallbackServerContext* context,
                                                                               v1::Model* response) {
  const auto reactor = std::make_shared<UploadReactor>(services_, context, response);
  reactor->Start();
  return reactor.get();
}

grpc::ServerUnaryReactor* ModelServiceImpl::GetModel(grpc::CallbackServerContext* context,
                                                     const v1::GetModelRequest* request, v1::Model* response) {
  return FinishUnary(services_, context, response, [this, request, response](const Caller& caller) -> absl::Status {
    EVPOSE_ASSIGN_OR_RETURN(const ModelInfo model, services_.models.Get(caller.tenant, request->name()));
    *response = ToProto(model);
    return absl::OkStatus();
  });
}

grpc::ServerUnaryReactor* ModelServiceImpl::ListModels(grpc::CallbackServerContext* context,
                                                       const v1::ListModelsRequest* request,
                                                       v1::ListModelsResponse* response) {
  return FinishUnary(services_, context, response, [this, request, response](const Caller& caller) {
    return List(services_.models, caller.tenant, *request, *response);
  });
}

grpc::ServerUnaryReactor* ModelServiceImpl::GetModelGeometry(grpc::CallbackServerContext* context,
                                                             const v1::GetModelGeometryRequest* request,
                                                             v1::ModelGeometry* response) {
  return StartGetModelGeometry(services_.models, services_.pool.preparations(), *services_.sessions.options().memory,
                               LimitsOf(services_), Authenticate(services_.authenticator, *context), *context, *request,
                               *response);
}

grpc::ServerUnaryReactor* ModelServiceImpl::DeleteModel(grpc::CallbackServerContext* context,
                                                        const v1::DeleteModelRequest* request,
                                                        google::protobuf::Empty* response) {
  return PostUnary(services_, context, response, [this, request](const Caller& caller) {
    return DeletionStatus(services_.models.Delete(caller.tenant, request->name()), request->allow_missing());
  });
}

}  // namespace evpose::server
