// SPDX-License-Identifier: Apache-2.0
#include "server/models/model_limits.h"

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/errors.h"

namespace evpose::server {

absl::Status ModelLimits::Upload::Add(uint64_t bytes) {
  EVPOSE_RETURN_IF_ERROR(limits_.Receive(tenant_, bytes));
  bytes_ += bytes;
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<ModelLimits::Upload>> ModelLimits::BeginUpload(const std::string& tenant) {
  const std::lock_guard lock(mutex_);
  if (all_.uploads >= options_.max_uploads) {
    options_.metrics->quota_refusals[QuotaLimit::kMaxUploads].Add();
    return LimitReached(
        v1::TOO_MANY_UPLOADS, "max_uploads",
        absl::StrCat("the server has its maximum of ", options_.max_uploads, " uploads under way: try again later"),
        kRetryDelay);
  }
  const auto found = by_tenant_.find(tenant);
  if (found != by_tenant_.end() && found->second.uploads >= options_.max_tenant_uploads) {
    options_.metrics->quota_refusals[QuotaLimit::kTenantUploads].Add();
    return LimitReached(v1::TENANT_QUOTA, "tenant_uploads",
                        absl::StrCat("this tenant has its ", options_.max_tenant_uploads,
                                     " uploads under way: try again when one has ended"),
                        kRetryDelay);
  }
  // The allocations precede the counts, because one that fails after them would leave the counts too high.
  Usage& of_tenant = by_tenant_[tenant];
  auto upload = std::make_unique<Upload>(*this, tenant);
  ++all_.uploads;
  ++of_tenant.uploads;
  return upload;
}

absl::Status ModelLimits::CheckSize(const std::string& tenant, uint64_t size_bytes) {
  if (size_bytes == 0 || size_bytes > options_.max_model_bytes) {
    return InvalidField("header.size_bytes",
                        absl::StrCat("is ", size_bytes, "; a model has 1 to ", options_.max_model_bytes, " bytes"));
  }
  const std::lock_guard lock(mutex_);
  return CheckRoom(tenant, size_bytes);
}

absl::Status ModelLimits::Check(const std::string& tenant, uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  return CheckRoom(tenant, bytes);
}

absl::Status ModelLimits::Receive(const std::string& tenant, uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  EVPOSE_RETURN_IF_ERROR(CheckRoom(tenant, bytes));
  AddBytes(tenant, bytes);
  return absl::OkStatus();
}

absl::Status ModelLimits::CheckRoom(const std::string& tenant, uint64_t bytes) {
  // The message has no usage by tenant, because other tenants must not be visible.
  if (all_.bytes + bytes > options_.max_store_bytes) {
    options_.metrics->quota_refusals[QuotaLimit::kMaxModelStoreBytes].Add();
    return LimitReached(v1::MODEL_STORE_FULL, "max_model_store_bytes",
                        absl::StrCat("no room for ", bytes, " bytes of a model: the server's ",
                                     options_.max_store_bytes, " are taken; delete models that are not needed"),
                        absl::ZeroDuration());
  }
  const auto found = by_tenant_.find(tenant);
  const uint64_t taken = found == by_tenant_.end() ? 0 : found->second.bytes;
  if (taken + bytes <= options_.max_tenant_bytes) return absl::OkStatus();
  options_.metrics->quota_refusals[QuotaLimit::kTenantModelBytes].Add();
  return LimitReached(v1::TENANT_QUOTA, "tenant_model_bytes",
                      absl::StrCat("no room for ", bytes, " bytes of a model: this tenant has taken ", taken, " of ",
                                   options_.max_tenant_bytes, "; delete models that are not needed"),
                      absl::ZeroDuration());
}

void ModelLimits::End(const std::string& tenant, uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  Release(tenant, {.bytes = bytes, .uploads = 1});
}

void ModelLimits::AddStored(const std::string& tenant, uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  AddBytes(tenant, bytes);
}

void ModelLimits::RemoveStored(const std::string& tenant, uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  Release(tenant, {.bytes = bytes});
}

void ModelLimits::AddBytes(const std::string& tenant, uint64_t bytes) {
  by_tenant_[tenant].bytes += bytes;  // first, because it may throw
  all_.bytes += bytes;
}

void ModelLimits::Release(const std::string& tenant, const Usage& usage) {
  const auto found = by_tenant_.find(tenant);
  for (Usage* const counted : {&all_, &found->second}) {
    counted->bytes -= usage.bytes;
    counted->uploads -= usage.uploads;
  }
  if (found->second.bytes == 0 && found->second.uploads == 0) by_tenant_.erase(found);
}

}  // namespace evpose::server
