// SPDX-License-Identifier: Apache-2.0
#include "server/rpc/common/status_mapping.h"

#include <new>
#include <string>

#include "google/rpc/error_details.pb.h"
#include "google/rpc/status.pb.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

constexpr char kDomain[] = "evpose.v1";

void AddDetails(const ErrorDetails& details, const std::string& message, google::rpc::Status& out) {
  if (!details.field.empty()) {
    google::rpc::BadRequest bad_request;
    google::rpc::BadRequest::FieldViolation& violation = *bad_request.add_field_violations();
    violation.set_field(details.field);
    violation.set_description(message);
    out.add_details()->PackFrom(bad_request);
  }
  if (!details.reason.empty()) {
    google::rpc::ErrorInfo info;
    info.set_reason(details.reason);
    info.set_domain(kDomain);
    for (const auto& [key, value] : details.metadata) (*info.mutable_metadata())[key] = value;
    out.add_details()->PackFrom(info);
  }
  if (!details.quota_subject.empty()) {
    google::rpc::QuotaFailure quota;
    google::rpc::QuotaFailure::Violation& violation = *quota.add_violations();
    violation.set_subject(details.quota_subject);
    violation.set_description(message);
    out.add_details()->PackFrom(quota);
  }
  if (details.retry_after > absl::ZeroDuration()) {
    google::rpc::RetryInfo retry;
    retry.mutable_retry_delay()->set_seconds(absl::ToInt64Seconds(details.retry_after));
    out.add_details()->PackFrom(retry);
  }
}

grpc::Status WithDetails(grpc::StatusCode code, const absl::Status& status) {
  const std::string message(status.message());
  google::rpc::Status details;
  AddDetails(GetErrorDetails(status), message, details);
  if (details.details().empty()) return grpc::Status(code, message);
  details.set_code(code);
  details.set_message(message);
  return grpc::Status(code, message, details.SerializeAsString());
}

}  // namespace

grpc::Status ToGrpcStatus(const absl::Status& status) noexcept {
  if (status.ok()) return grpc::Status::OK;
  // Both enumerations have the same canonical values.
  const auto code = static_cast<grpc::StatusCode>(status.code());
  try {
    return WithDetails(code, status);
  } catch (const std::bad_alloc&) {
    return grpc::Status(code, "");
  }
}

}  // namespace evpose::server
