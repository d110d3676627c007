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
#include "evpose/storage/v1/model.pb.h"
#include "server/models/prepared_model.h"
#include "server/models/stored_symmetry.h"
#include "server/runtime/client_text.h"
#include "server/runtime/enum_number.h"
#include "server/runtime/errors.h"
#include "server/sessions/durability/session_codec.h"
#include "server/stores/common/record_version.h"
#include "server/telemetry/log.h"

namespace evpose::server {
namespace {

constexpr uint8_t kSurfaceAsIs = 2;  // MODEL_SURFACE_AS_IS of the API

absl::Status ModelNotFound(absl::string_view name) {
  return WithReason(absl::NotFoundError(absl::StrCat("there is no model \"", Shortened(name), "\": upload it first")),
                    v1::MODEL_NOT_FOUND, {{"model", Shortened(name)}});
}

absl::Status ModelInUse(absl::string_view name) {
  return WithReason(absl::FailedPreconditionError(absl::StrCat(name, " is used by a session: delete that first")),
                    v1::MODEL_IN_USE, {{"model", std::string(name)}});
}

// The number of sessions that are searched for a model with one round trip to the store.
constexpr size_t kSessionsPerPage = 1000;

bool UsesModel(const SessionRecord& record, absl::string_view model) {
  const auto config = DecodeConfig(record.config);
  if (!config.ok()) return false;  // a session with an unreadable configuration cannot be resumed
  return std::any_of(config->objects.begin(), config->objects.end(),
                     [model](const ObjectConfig& object) { return object.model == model; });
}

// The file name of a summary of any version; empty if there is none.
std::string FileNameOf(const ModelRecord& record) {
  storage::v1::ModelSummary stored;
  return ParseRecord(record.summary, stored) ? stored.file_name() : "";
}

std::string EncodeSummary(const ObjectModel& model, const std::string& sha256_hex, uint64_t prepared_bytes,
                          const std::string& file_name) {
  storage::v1::ModelSummary stored;
  stored.set_file_name(file_name);
  stored.set_version(kPreparationVersion);
  stored.set_num_faces(static_cast<uint32_t>(model.triangles.size()));
  stored.set_num_lines(static_cast<uint32_t>(model.lines.size()));
  stored.set_num_curves(static_cast<uint32_t>(model.curves.size()));
  stored.set_num_regions(static_cast<uint32_t>(model.surface.regions.size()));
  stored.set_num_symmetries(static_cast<uint32_t>(std::max<size_t>(1, model.symmetries.size())));
  if (model.continuous_symmetry) *stored.mutable_continuous_symmetry() = ToStored(*model.continuous_symmetry);
  stored.set_diameter_m(model.diameter_m);
  stored.set_sha256_hex(sha256_hex);
  stored.set_prepared_bytes(prepared_bytes);
  for (const std::string& notice : model.notices) stored.add_notices(notice);
  return SerializeRecord(stored);
}

// nullopt if another version has prepared the model.
std::optional<storage::v1::ModelSummary> CurrentSummary(const ModelRecord& record) {
  storage::v1::ModelSummary stored;
  if (!ParseRecord(record.summary, stored) || stored.version() != kPreparationVersion) return std::nullopt;
  return stored;
}

ModelInfo InfoOf(const ModelRecord& record) {
  ModelInfo info = {.name = record.name,
                    .reading = record.reading,
                    .size_bytes = record.file_bytes,
                    .create_time = record.create_time,
                    .file_name = FileNameOf(record)};
  if (const auto summary = CurrentSummary(record); summary.has_value()) {
    info.num_faces = summary->num_faces();
    info.num_lines = summary->num_lines();
    info.num_curves = summary->num_curves();
    info.num_regions = summary->num_regions();
    info.num_symmetries = summary->num_symmetries();
    info.continuous_symmetry = SymmetryOf(*summary);
    info.diameter_m = summary->diameter_m();
    info.sha256_hex = summary->sha256_hex();
    info.notices.assign(summary->notices().begin(), summary->notices().end());
  }
  return info;
}

}  // namespace

std::string ModelName(const ModelReading& reading, absl::Span<const uint8_t> bytes) {
  StateWriter parameters;
  parameters(EnumNumber<uint8_t>(reading.format), reading.metres_per_unit, reading.crease_angle_deg);
  // Not for the default, so that the models of earlier servers keep their names.
  if (!reading.is_smooth) parameters(kSurfaceAsIs);
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
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<ModelRecord> records, store.ListModels());
  for (const ModelRecord& record : records) registry->Insert(record);
  return registry;
}

// Locks, so that ThreadSanitizer sees that all calls precede the destruction.
ModelRegistry::~ModelRegistry() { const std::lock_guard lock(mutex_); }

ModelOptions ModelRegistry::LoadingOptions(const ModelReading& reading) const {
  ModelOptions options;
  options.metres_per_unit = reading.metres_per_unit;
  options.crease_angle_deg = reading.crease_angle_deg;
  options.is_smooth = reading.is_smooth;
  options.max_bytes = options_.limits.max_model_bytes;
  return options;
}

ModelInfo ModelRegistry::Insert(const ModelRecord& record) {
  const std::lock_guard lock(mutex_);
  const auto summary = CurrentSummary(record);
  Entry& entry = models_.try_emplace(Key(record.tenant, record.name)).first->second;
  if (entry.stored_bytes > 0) limits_.RemoveStored(record.tenant, entry.stored_bytes);
  entry.info = InfoOf(record);
  entry.stored_bytes = record.file_bytes + (summary.has_value() ? summary->prepared_bytes() : 0);
  entry.is_current = summary.has_value();
  limits_.AddStored(record.tenant, entry.stored_bytes);
  return entry.info;
}

bool ModelRegistry::IsCurrent(const Key& key) const {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(key);
  return found != models_.end() && found->second.is_current;
}

std::vector<std::pair<std::string, std::string>> ModelRegistry::Outdated() const {
  const std::lock_guard lock(mutex_);
  std::vector<Key> outdated;
  for (const auto& [key, entry] : models_) {
    if (!entry.is_current) outdated.push_back(key);
  }
  return outdated;
}

absl::StatusOr<std::shared_ptr<const ObjectModel>> ModelRegistry::Prepare(ModelRecord& record,
                                                                          const Cancellation& cancellation) const {
  EVPOSE_ASSIGN_OR_RETURN(record.prepared, options_.preparer->Prepare(*record.bytes, record.reading.format,
                                                                      LoadingOptions(record.reading), cancellation));
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, DecodePreparedModel(record.prepared));
  record.summary = EncodeSummary(model, Sha256Hex(*record.bytes), record.prepared.size(), FileNameOf(record));
  return std::make_shared<const ObjectModel>(std::move(model));
}

std::optional<ModelRegistry::Known> ModelRegistry::FindFile(const std::string& tenant, const ModelReading& reading,
                                                            uint64_t size_bytes, absl::string_view sha256_hex) const {
  const std::lock_guard lock(mutex_);
  for (auto it = models_.lower_bound(Key(tenant, "")); it != models_.end() && it->first.first == tenant; ++it) {
    const ModelInfo& info = it->second.info;
    const bool is_same = info.sha256_hex == sha256_hex && info.size_bytes == size_bytes && info.reading == reading;
    if (is_same && !it->second.is_being_deleted) return Known{info, {it->second.model.lock(), it->second.use}};
  }
  return std::nullopt;
}

absl::StatusOr<ModelInfo> ModelRegistry::Upload(const std::string& tenant, const ModelReading& reading,
                                                absl::string_view expected_sha256_hex,
                                                std::shared_ptr<const std::vector<uint8_t>> bytes,
                                                const Cancellation& cancellation, const std::string& file_name) {
  EVPOSE_RETURN_IF_ERROR(CheckSha256(expected_sha256_hex, Sha256Hex(*bytes), bytes->size()));
  if (const absl::Status status = LoadingOptions(reading).Validate(); !status.ok())
    return InvalidField("header", status.message());
  ModelRecord record = {.name = ModelName(reading, *bytes),
                        .tenant = tenant,
                        .reading = reading,
                        .create_time = absl::Now(),
                        .file_bytes = bytes->size(),
                        .bytes = bytes};
  storage::v1::ModelSummary named;
  named.set_file_name(file_name);
  record.summary = SerializeRecord(named);
  const Key key(tenant, record.name);
  if (IsCurrent(key)) {
    const absl::Status stored = CheckStored(tenant, record.name);
    if (stored.ok()) return Get(tenant, record.name);
    if (!absl::IsNotFound(stored)) return stored;
  }
  if (const absl::Status status = Prepare(record, cancellation).status(); !status.ok()) {
    const bool is_of_file = absl::IsInvalidArgument(status) && GetErrorDetails(status).reason.empty();
    return is_of_file ? InvalidField("chunk", status.message()) : status;
  }
  EVPOSE_RETURN_IF_ERROR(limits_.Check(tenant, record.prepared.size()));
  const std::lock_guard store_lock(store_mutex_);
  if (IsCurrent(key)) return Get(tenant, record.name);
  EVPOSE_RETURN_IF_ERROR(FromStore(store_.PutModel(record)));
  return Insert(record);
}

absl::Status ModelRegistry::CheckStored(const std::string& tenant, const std::string& name) {
  if (!options_.shares_store) return absl::OkStatus();
  absl::StatusOr<bool> is_stored = store_.HasModel(tenant, name);
  if (is_stored.ok() && !*is_stored) {
    const std::lock_guard store_lock(store_mutex_);
    is_stored = store_.HasModel(tenant, name);  // this server may have stored it since then
    if (is_stored.ok() && !*is_stored) {
      Forget(Key(tenant, name));
      return ModelNotFound(name);
    }
  }
  return FromStore(is_stored.status());
}

void ModelRegistry::Forget(const Key& key) {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(key);
  if (found == models_.end()) return;
  limits_.RemoveStored(key.first, found->second.stored_bytes);
  models_.erase(found);
}

absl::StatusOr<ModelInfo> ModelRegistry::Get(const std::string& tenant, absl::string_view name) const {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(Key(tenant, name));
  if (found == models_.end()) return ModelNotFound(name);
  return found->second.info;
}

absl::StatusOr<ModelUse> ModelRegistry::FindStored(const Key& key, std::optional<ModelRecord>& record) {
  const auto& [tenant, name] = key;
  absl::StatusOr<ModelUse> use = Use(tenant, name);
  if (use.ok()) return use;
  absl::StatusOr<ModelRecord> stored = store_.ReadModel(tenant, name);
  if (absl::IsNotFound(stored.status())) return use;
  EVPOSE_RETURN_IF_ERROR(stored.status());
  // Not locked while the file is read, which takes long. The model may have been deleted meanwhile.
  const std::lock_guard store_lock(store_mutex_);
  EVPOSE_ASSIGN_OR_RETURN(const bool is_stored, store_.HasModel(tenant, name));
  if (!is_stored) return use;
  record = *std::move(stored);
  Insert(*record);
  return Use(tenant, name);
}

absl::StatusOr<ModelUse> ModelRegistry::UseStored(const std::string& tenant, absl::string_view name) {
  const Key key(tenant, std::string(name));
  // DATA_LOSS is returned unchanged: the session factory reports a damaged model as damage of the session.
  const auto for_caller = [](const absl::Status& status) {
    return absl::IsDataLoss(status) ? status : FromStore(status);
  };
  absl::StatusOr<ModelUse> use = Use(tenant, name);
  if (use.ok() && use->model != nullptr) return use;
  const auto loading = loading_.LockKey(key);                // sessions that begin at the same time load it once
  EVPOSE_RETURN_IF_ERROR(SlowExecutor::Running().status());  // the call may have ended during the wait
  std::optional<ModelRecord> record;
  use = FindStored(key, record);
  if (!use.ok()) return for_caller(use.status());
  if (use->model != nullptr) return use;
  if (!record.has_value()) {
    absl::StatusOr<ModelRecord> stored = store_.ReadModel(tenant, name);
    if (absl::IsNotFound(stored.status())) {
      Forget(key);  // another server has deleted it
      return ModelNotFound(name);
    }
    if (!stored.ok()) return for_caller(stored.status());
    record = *std::move(stored);
  }
  auto loaded = Load(*std::move(record));
  if (!loaded.ok()) return for_caller(loaded.status());
  use->model = *std::move(loaded);
  const std::lock_guard lock(mutex_);
  if (const auto found = models_.find(key); found != models_.end()) found->second.model = use->model;
  return use;
}

absl::StatusOr<std::shared_ptr<const ObjectModel>> ModelRegistry::Load(ModelRecord record) {
  if (CurrentSummary(record).has_value()) {
    EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, DecodePreparedModel(record.prepared));
    return std::make_shared<const ObjectModel>(std::move(model));
  }
  SlowExecutor::LeavePlaceToWait();  // for the seconds of the preparation
  auto model = Prepare(record, SlowExecutor::Running());
  if (absl::IsInvalidArgument(model.status())) {
    return absl::DataLossError(absl::StrCat(record.name, " cannot be loaded: ", model.status().message()));
  }
  EVPOSE_RETURN_IF_ERROR(model.status());
  const std::lock_guard store_lock(store_mutex_);
  // Another server may have deleted the model during the preparation; to store it would restore it.
  if (options_.shares_store && !store_.HasModel(record.tenant, record.name).value_or(true)) return model;
  const absl::Status kept = store_.PutModel(record);
  if (!kept.ok())
    Log(LogLevel::kWarning, "prepared_model_not_stored", {{"model", record.name}, {"message", kept.message()}});
  if (kept.ok()) Insert(record);
  return model;
}

absl::StatusOr<ModelUse> ModelRegistry::Use(const std::string& tenant, absl::string_view name) const {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(Key(tenant, name));
  if (found == models_.end() || found->second.is_being_deleted) return ModelNotFound(name);
  return ModelUse{found->second.model.lock(), found->second.use};
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
  if (found->second.use.use_count() > 1) return ModelInUse(key.second);
  found->second.is_being_deleted = true;
  return true;
}

void ModelRegistry::EndDelete(const Key& key, const absl::Status& status) {
  if (status.ok()) return Forget(key);
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(key);
  if (found != models_.end()) found->second.is_being_deleted = false;
}

absl::Status ModelRegistry::DeleteStored(const Key& key, bool was_here) {
  const auto& [tenant, name] = key;
  if (!was_here) {
    // Another server has stored the model, or it could not be loaded; in both cases no session here uses it.
    const absl::StatusOr<bool> is_stored = store_.HasModel(tenant, name);
    if (!is_stored.ok()) return FromStore(is_stored.status());
    if (!*is_stored) return ModelNotFound(name);
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
  SessionPage page;
  do {
    auto next = store_.ListSessions(key.first, page.last_name, kSessionsPerPage);
    if (!next.ok()) return FromStore(next.status());
    page = *std::move(next);
    if (std::any_of(page.records.begin(), page.records.end(),
                    [&key](const SessionRecord& record) { return UsesModel(record, key.second); })) {
      return ModelInUse(key.second);
    }
  } while (!page.last_name.empty());
  return absl::OkStatus();
}

}  // namespace evpose::server
