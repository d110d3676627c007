// SPDX-License-Identifier: Apache-2.0
#include "server/models/model_registry.h"

#include <algorithm>
#include <mutex>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"
#include "core/numerics/hash.h"
#include "server/runtime/client_text.h"
#include "server/runtime/enum_number.h"
#include "server/runtime/errors.h"
#include "server/sessions/durability/session_codec.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

absl::Status ModelNotFound(absl::string_view name) {
  return WithReason(absl::NotFoundError(absl::StrCat("there is no model \"", Shortened(name), "\": upload it first")),
                    v1::MODEL_NOT_FOUND, {{"model", Shortened(name)}});
}

absl::Status ModelInUse(absl::string_view name) {
  return WithReason(absl::FailedPreconditionError(absl::StrCat(name, " is used by a session: delete that first")),
                    v1::MODEL_IN_USE, {{"model", std::string(name)}});
}

}  // namespace

std::string ModelName(const ModelReading& reading, absl::Span<const uint8_t> bytes) {
  StateWriter parameters;
  parameters(EnumNumber<uint8_t>(reading.format), reading.metres_per_unit, reading.crease_angle_deg);
  const std::string prefix = parameters.Take();
  Sha256 digest;
  digest.Update({reinterpret_cast<const uint8_t*>(prefix.data()), prefix.size()});
  digest.Update(bytes);
  return absl::StrCat("models/", digest.FinishHex());
}

absl::Status CheckSha256(absl::string_view expected_hex, absl::string_view actual_hex, uint64_t num_bytes) {
  if (expected_hex.empty() || expected_hex == actual_hex) return absl::OkStatus();
  return InvalidField("header.sha256", absl::StrCat("is ", expected_hex, ", but that of the ", num_bytes,
                                                    " bytes received is ", actual_hex));
}

absl::StatusOr<std::unique_ptr<ModelRegistry>> ModelRegistry::Create(const Options& options, Store& store) {
  std::unique_ptr<ModelRegistry> registry(new ModelRegistry(options, store));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<ModelRecord> records, store.ReadModels());
  const std::lock_guard lock(registry->mutex_);
  for (const ModelRecord& record : records) {
    auto entry = registry->Load(record);
    if (!entry.ok()) {
      Log(LogLevel::kError, "model_not_loaded",
          {{"model", record.name}, {"tenant", record.tenant}, {"message", entry.status().message()}});
      continue;
    }
    registry->AddBytes(record.tenant, record.bytes->size());
    registry->models_.emplace(Key(record.tenant, record.name), *std::move(entry));
  }
  return registry;
}

// Locks, so that ThreadSanitizer sees that all calls precede the destruction.
ModelRegistry::~ModelRegistry() { const std::lock_guard lock(mutex_); }

ModelOptions ModelRegistry::LoadingOptions(const ModelReading& reading) const {
  ModelOptions options;
  options.metres_per_unit = reading.metres_per_unit;
  options.crease_angle_deg = reading.crease_angle_deg;
  options.max_bytes = options_.max_model_bytes;
  return options;
}

absl::StatusOr<ModelRegistry::Entry> ModelRegistry::Load(const ModelRecord& record) const {
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model,
                          ParseObjectModel(*record.bytes, record.reading.format, LoadingOptions(record.reading)));
  Entry entry;
  entry.info = {.name = record.name,
                .reading = record.reading,
                .size_bytes = record.bytes->size(),
                .num_faces = static_cast<uint32_t>(model.triangles.size()),
                .num_lines = static_cast<uint32_t>(model.lines.size()),
                .num_symmetries = static_cast<uint32_t>(std::max<size_t>(1, model.symmetries.size())),
                .diameter_m = model.diameter_m,
                .sha256_hex = Sha256Hex(*record.bytes),
                .notices = model.notices,
                .create_time = record.create_time};
  entry.use = {std::make_shared<const ObjectModel>(std::move(model)), std::make_shared<const char>()};
  return entry;
}

absl::StatusOr<std::shared_ptr<const void>> ModelRegistry::Reserve(const std::string& tenant, uint64_t size_bytes) {
  const std::lock_guard lock(mutex_);
  if (size_bytes == 0 || size_bytes > options_.max_model_bytes) {
    return InvalidField("header.size_bytes",
                        absl::StrCat("is ", size_bytes, "; a model has 1 to ", options_.max_model_bytes, " bytes"));
  }
  // The message has no usage by tenant, because other tenants must not be visible.
  if (bytes_ + size_bytes > options_.max_store_bytes) {
    options_.metrics->quota_refusals[QuotaLimit::kMaxModelStoreBytes].Add();
    return LimitReached(v1::MODEL_STORE_FULL, "max_model_store_bytes",
                        absl::StrCat("no room for a model of ", size_bytes, " bytes: the server's ",
                                     options_.max_store_bytes, " are taken; delete models that are not needed"),
                        absl::ZeroDuration());
  }
  const auto found = bytes_of_tenant_.find(tenant);
  const uint64_t taken = found == bytes_of_tenant_.end() ? 0 : found->second;
  if (taken + size_bytes > options_.max_tenant_bytes) {
    options_.metrics->quota_refusals[QuotaLimit::kTenantModelBytes].Add();
    return LimitReached(v1::TENANT_QUOTA, "tenant_model_bytes",
                        absl::StrCat("no room for a model of ", size_bytes, " bytes: this tenant has taken ", taken,
                                     " of ", options_.max_tenant_bytes, "; delete models that are not needed"),
                        absl::ZeroDuration());
  }
  AddBytes(tenant, size_bytes);
  return std::shared_ptr<const void>(this, [this, tenant, size_bytes](const void*) { Release(tenant, size_bytes); });
}

void ModelRegistry::Release(const std::string& tenant, uint64_t reserved_bytes) {
  const std::lock_guard lock(mutex_);
  RemoveBytes(tenant, reserved_bytes);
}

void ModelRegistry::AddBytes(const std::string& tenant, uint64_t bytes) {
  bytes_ += bytes;
  bytes_of_tenant_[tenant] += bytes;
}

void ModelRegistry::RemoveBytes(const std::string& tenant, uint64_t bytes) {
  bytes_ -= bytes;
  const auto found = bytes_of_tenant_.find(tenant);
  found->second -= bytes;
  if (found->second == 0) bytes_of_tenant_.erase(found);
}

std::optional<ModelRegistry::Known> ModelRegistry::FindFile(const std::string& tenant, const ModelReading& reading,
                                                            uint64_t size_bytes, absl::string_view sha256_hex) const {
  const std::lock_guard lock(mutex_);
  for (auto it = models_.lower_bound(Key(tenant, "")); it != models_.end() && it->first.first == tenant; ++it) {
    const ModelInfo& info = it->second.info;
    const bool is_same = info.sha256_hex == sha256_hex && info.size_bytes == size_bytes && info.reading == reading;
    if (is_same && !it->second.is_going) return Known{info, it->second.use};
  }
  return std::nullopt;
}

absl::StatusOr<ModelInfo> ModelRegistry::Upload(const std::string& tenant, const ModelReading& reading,
                                                absl::string_view expected_sha256_hex,
                                                std::shared_ptr<const std::vector<uint8_t>> bytes) {
  const std::string sha256_hex = Sha256Hex(*bytes);
  EVPOSE_RETURN_IF_ERROR(CheckSha256(expected_sha256_hex, sha256_hex, bytes->size()));
  if (const absl::Status status = LoadingOptions(reading).Validate(); !status.ok())
    return InvalidField("header", status.message());
  const ModelRecord record = {.name = ModelName(reading, *bytes),
                              .tenant = tenant,
                              .reading = reading,
                              .create_time = absl::Now(),
                              .bytes = bytes};
  if (auto known = Get(tenant, record.name); known.ok()) {
    const absl::Status stored = CheckStored(tenant, record.name);
    if (!absl::IsNotFound(stored)) return stored.ok() ? known : stored;
  }
  auto entry = Load(record);
  if (!entry.ok()) return InvalidField("chunk", entry.status().message());

  const std::lock_guard store_lock(store_mutex_);
  if (auto known = Get(tenant, record.name); known.ok()) return known;
  EVPOSE_RETURN_IF_ERROR(FromStore(store_.PutModel(record)));
  const Key key(tenant, record.name);
  const std::lock_guard lock(mutex_);
  AddBytes(tenant, bytes->size());
  return models_.emplace(key, *std::move(entry)).first->second.info;
}

absl::Status ModelRegistry::CheckStored(const std::string& tenant, const std::string& name) {
  if (!options_.shares_store) return absl::OkStatus();
  const std::lock_guard store_lock(store_mutex_);
  const absl::Status status = store_.ReadModel(tenant, name).status();
  if (!absl::IsNotFound(status)) return FromStore(status);
  Forget(Key(tenant, name));
  return ModelNotFound(name);
}

void ModelRegistry::Forget(const Key& key) {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(key);
  if (found == models_.end()) return;
  RemoveBytes(key.first, found->second.info.size_bytes);
  models_.erase(found);
}

absl::StatusOr<ModelInfo> ModelRegistry::Get(const std::string& tenant, absl::string_view name) const {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(Key(tenant, name));
  if (found == models_.end()) return ModelNotFound(name);
  return found->second.info;
}

absl::StatusOr<ModelUse> ModelRegistry::UseStored(const std::string& tenant, absl::string_view name) {
  absl::StatusOr<ModelUse> known = Use(tenant, name);
  if (known.ok()) return known;
  const std::lock_guard store_lock(store_mutex_);
  known = Use(tenant, name);
  if (known.ok()) return known;
  const absl::StatusOr<ModelRecord> record = store_.ReadModel(tenant, name);
  if (absl::IsNotFound(record.status())) return known;
  // DATA_LOSS is returned unchanged: the session factory reports a damaged model as damage of the session.
  if (!record.ok()) return absl::IsDataLoss(record.status()) ? record.status() : FromStore(record.status());
  EVPOSE_ASSIGN_OR_RETURN(Entry entry, Load(*record));
  const std::lock_guard lock(mutex_);
  const auto [found, is_new] = models_.emplace(Key(tenant, std::string(name)), std::move(entry));
  if (is_new) AddBytes(tenant, record->bytes->size());
  return found->second.use;
}

absl::StatusOr<ModelUse> ModelRegistry::Use(const std::string& tenant, absl::string_view name) const {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(Key(tenant, name));
  if (found == models_.end() || found->second.is_going) return ModelNotFound(name);
  return found->second.use;
}

std::vector<ModelInfo> ModelRegistry::List(const std::string& tenant, absl::string_view after_name,
                                           size_t max_models) const {
  const std::lock_guard lock(mutex_);
  std::vector<ModelInfo> models;
  for (auto it = models_.upper_bound(Key(tenant, after_name)); it != models_.end() && it->first.first == tenant; ++it) {
    if (models.size() == max_models) break;
    models.push_back(it->second.info);
  }
  return models;
}

absl::Status ModelRegistry::Delete(const std::string& tenant, absl::string_view name) {
  const std::lock_guard store_lock(store_mutex_);
  const Key key(tenant, name);
  EVPOSE_ASSIGN_OR_RETURN(const bool was_here, BeginDelete(key));
  const absl::Status status = DeleteStored(key, was_here);
  EndDelete(key, status);
  return status;
}

absl::StatusOr<bool> ModelRegistry::BeginDelete(const Key& key) {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(key);
  if (found == models_.end()) return false;
  // Copies of `use` are made under the lock only, so the count cannot rise now.
  if (found->second.use.use.use_count() > 1) return ModelInUse(key.second);
  found->second.is_going = true;
  return true;
}

void ModelRegistry::EndDelete(const Key& key, const absl::Status& status) {
  if (status.ok()) return Forget(key);
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(key);
  if (found != models_.end()) found->second.is_going = false;
}

absl::Status ModelRegistry::DeleteStored(const Key& key, bool was_here) {
  const auto& [tenant, name] = key;
  if (!was_here) {
    // Another server has stored the model, or it could not be loaded; in both cases no session here uses it.
    const absl::Status stored = store_.ReadModel(tenant, name).status();
    if (absl::IsNotFound(stored)) return ModelNotFound(name);
    if (!stored.ok() && !absl::IsDataLoss(stored)) return FromStore(stored);
  }
  EVPOSE_RETURN_IF_ERROR(CheckUnusedInStore(key));
  if (!options_.shares_store) return FromStore(store_.DeleteModel(tenant, name));
  const absl::StatusOr<ModelRecord> record = store_.ReadModel(tenant, name);
  EVPOSE_RETURN_IF_ERROR(FromStore(store_.DeleteModel(tenant, name)));
  if (!record.ok()) return absl::OkStatus();
  // Another server may have created a session with the model at the same time. It reads the model after storing the
  // session, and this server lists the sessions after deleting the model; so at least one of them sees the conflict.
  const absl::Status unused = CheckUnusedInStore(key);
  if (!absl::IsFailedPrecondition(unused)) return absl::OkStatus();
  EVPOSE_RETURN_IF_ERROR(FromStore(store_.PutModel(*record)));
  return unused;
}

absl::Status ModelRegistry::CheckUnusedInStore(const Key& key) const {
  const auto records = store_.ListSessions();
  if (!records.ok()) return FromStore(records.status());
  for (const SessionRecord& record : *records) {
    if (record.tenant != key.first) continue;
    const auto config = DecodeConfig(record.config);
    if (!config.ok()) continue;  // a session with an unreadable configuration cannot be resumed
    for (const ObjectConfig& object : config->objects) {
      if (object.model == key.second) return ModelInUse(key.second);
    }
  }
  return absl::OkStatus();
}

}  // namespace evpose::server
