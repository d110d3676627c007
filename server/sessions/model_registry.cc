#include "server/sessions/model_registry.h"

#include <algorithm>
#include <bit>
#include <mutex>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "core/base/hash.h"
#include "core/base/status_macros.h"
#include "server/sessions/errors.h"

namespace evpose::server {
namespace {

// The byte that stands for a format in a model's name: the API's number of it.
uint8_t FormatByte(ModelFormat format) {
  switch (format) {
    case ModelFormat::kObj:
      return 1;
    case ModelFormat::kPly:
      return 2;
    case ModelFormat::kStl:
      return 3;
  }
  return 0;
}

void AppendLittleEndian(double value, std::vector<uint8_t>& out) {
  const auto bits = std::bit_cast<uint64_t>(value);
  for (int shift = 0; shift < 64; shift += 8) out.push_back(static_cast<uint8_t>(bits >> shift));
}

absl::Status ModelNotFound(absl::string_view name) {
  return WithReason(absl::NotFoundError(absl::StrCat("there is no model \"", name, "\": upload it first")),
                    "MODEL_NOT_FOUND", {{"model", std::string(name)}});
}

}  // namespace

std::string ModelName(const ModelReading& reading, absl::Span<const uint8_t> bytes) {
  std::vector<uint8_t> prefix = {FormatByte(reading.format)};
  AppendLittleEndian(reading.metres_per_unit, prefix);
  AppendLittleEndian(reading.crease_angle_deg, prefix);
  Sha256 digest;
  digest.Update(prefix);
  digest.Update(bytes);
  return absl::StrCat("models/", digest.FinishHex());
}

absl::StatusOr<std::unique_ptr<ModelRegistry>> ModelRegistry::Create(const Options& options, Store& store) {
  std::unique_ptr<ModelRegistry> registry(new ModelRegistry(options, store));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<ModelRecord> records, store.ReadModels());
  const std::lock_guard lock(registry->mutex_);
  for (const ModelRecord& record : records) {
    auto entry =
        Load(record, registry->LoadingOptions({record.format, record.metres_per_unit, record.crease_angle_deg}));
    if (!entry.ok()) {
      return absl::InternalError(
          absl::StrCat("stored model ", record.name, " cannot be loaded: ", entry.status().message()));
    }
    registry->stored_bytes_ += record.bytes->size();
    registry->models_.emplace(record.name, *std::move(entry));
  }
  return registry;
}

// As in Session: shows to tools that all calls are over.
ModelRegistry::~ModelRegistry() { const std::lock_guard lock(mutex_); }

ModelOptions ModelRegistry::LoadingOptions(const ModelReading& reading) const {
  ModelOptions options;
  options.metres_per_unit = reading.metres_per_unit;
  options.crease_angle_deg = reading.crease_angle_deg;
  options.max_bytes = options_.max_model_bytes;
  return options;
}

absl::StatusOr<ModelRegistry::Entry> ModelRegistry::Load(const ModelRecord& record, const ModelOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(ObjectModel model, ParseObjectModel(*record.bytes, record.format, options));
  Entry entry;
  entry.info = {.name = record.name,
                .format = record.format,
                .size_bytes = record.bytes->size(),
                .metres_per_unit = record.metres_per_unit,
                .crease_angle_deg = record.crease_angle_deg,
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

absl::StatusOr<std::unique_ptr<ModelRegistry::Reservation>> ModelRegistry::Reserve(uint64_t size_bytes) {
  const std::lock_guard lock(mutex_);
  if (size_bytes == 0 || size_bytes > options_.max_model_bytes) {
    return InvalidField("header.size_bytes",
                        absl::StrCat("is ", size_bytes, "; a model has 1 to ", options_.max_model_bytes, " bytes"));
  }
  const uint64_t taken = stored_bytes_ + reserved_bytes_;
  if (taken + size_bytes > options_.max_store_bytes) {
    return LimitReached("MODEL_STORE_FULL", "max_model_store_bytes",
                        absl::StrCat("no room for a model of ", size_bytes, " bytes: ", taken, " of ",
                                     options_.max_store_bytes, " are taken; delete models that are not needed"),
                        absl::ZeroDuration());
  }
  reserved_bytes_ += size_bytes;
  return std::make_unique<Reservation>(*this, size_bytes);
}

void ModelRegistry::Release(uint64_t reserved_bytes) {
  const std::lock_guard lock(mutex_);
  reserved_bytes_ -= reserved_bytes;
}

absl::StatusOr<ModelInfo> ModelRegistry::Upload(const ModelReading& reading, absl::string_view expected_sha256_hex,
                                                std::shared_ptr<const std::vector<uint8_t>> bytes) {
  const std::string sha256_hex = Sha256Hex(*bytes);
  if (!expected_sha256_hex.empty() && expected_sha256_hex != sha256_hex) {
    return InvalidField("header.sha256", absl::StrCat("is ", expected_sha256_hex, ", but that of the ", bytes->size(),
                                                      " bytes received is ", sha256_hex));
  }
  const ModelOptions options = LoadingOptions(reading);
  if (const absl::Status status = options.Validate(); !status.ok()) return InvalidField("header", status.message());
  const ModelRecord record = {.name = ModelName(reading, *bytes),
                              .format = reading.format,
                              .metres_per_unit = reading.metres_per_unit,
                              .crease_angle_deg = reading.crease_angle_deg,
                              .create_time = absl::Now(),
                              .bytes = bytes};
  if (auto known = Get(record.name); known.ok()) return known;
  auto entry = Load(record, options);
  if (!entry.ok()) return InvalidField("chunk", entry.status().message());

  const std::lock_guard lock(mutex_);
  if (const auto found = models_.find(record.name); found != models_.end()) return found->second.info;
  EVPOSE_RETURN_IF_ERROR(store_.PutModel(record));
  stored_bytes_ += bytes->size();
  return models_.emplace(record.name, *std::move(entry)).first->second.info;
}

absl::StatusOr<ModelInfo> ModelRegistry::Get(absl::string_view name) const {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(name);
  if (found == models_.end()) return ModelNotFound(name);
  return found->second.info;
}

absl::StatusOr<ModelUse> ModelRegistry::Use(absl::string_view name) const {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(name);
  if (found == models_.end()) return ModelNotFound(name);
  return found->second.use;
}

std::vector<ModelInfo> ModelRegistry::List(absl::string_view after_name, size_t max_models) const {
  const std::lock_guard lock(mutex_);
  std::vector<ModelInfo> models;
  for (auto it = models_.upper_bound(after_name); it != models_.end() && models.size() < max_models; ++it) {
    models.push_back(it->second.info);
  }
  return models;
}

absl::Status ModelRegistry::Delete(absl::string_view name) {
  const std::lock_guard lock(mutex_);
  const auto found = models_.find(name);
  if (found == models_.end()) return absl::OkStatus();
  // Uses are given out under the lock only, so the count cannot rise now.
  if (found->second.use.use.use_count() > 1) {
    return WithReason(absl::FailedPreconditionError(absl::StrCat(name, " is used by a session: delete that first")),
                      "MODEL_IN_USE", {{"model", std::string(name)}});
  }
  EVPOSE_RETURN_IF_ERROR(store_.DeleteModel(name));
  stored_bytes_ -= found->second.info.size_bytes;
  models_.erase(found);
  return absl::OkStatus();
}

}  // namespace evpose::server
