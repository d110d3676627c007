// The models that sessions may track: loaded once, shared by all.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "core/models/object_model.h"
#include "server/stores/store.h"

namespace evpose::server {

struct ModelInfo {
  std::string name;
  ModelFormat format = ModelFormat::kObj;
  uint64_t size_bytes = 0;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 30.0;
  uint32_t num_faces = 0;
  uint32_t num_lines = 0;
  uint32_t num_symmetries = 1;
  double diameter_m = 0.0;
  std::string sha256_hex;  // of the file's bytes
  std::vector<std::string> notices;
  absl::Time create_time;
};

// How a model is to be read; part of what its name is made from.
struct ModelReading {
  ModelFormat format = ModelFormat::kObj;
  double metres_per_unit = 1.0;
  double crease_angle_deg = 30.0;
};

// "models/{id}", id as the API's Model.name says.
std::string ModelName(const ModelReading& reading, absl::Span<const uint8_t> bytes);

// A model in use: it cannot be deleted while one of these lives.
struct ModelUse {
  std::shared_ptr<const ObjectModel> model;
  std::shared_ptr<const void> use;
};

// Thread-safe.
class ModelRegistry {
 public:
  struct Options {
    uint64_t max_model_bytes = 64ull << 20;
    uint64_t max_store_bytes = 512ull << 20;  // of all files, those on their way included
  };

  // Loads what the store has. Errors: those of the store; INTERNAL for a stored model that can no longer be loaded.
  static absl::StatusOr<std::unique_ptr<ModelRegistry>> Create(const Options& options, Store& store);
  ~ModelRegistry();

  // Room for a file on its way; given back at destruction.
  class Reservation {
   public:
    Reservation(ModelRegistry& registry, uint64_t size_bytes) : registry_(registry), size_bytes_(size_bytes) {}
    ~Reservation() { registry_.Release(size_bytes_); }
    Reservation(const Reservation&) = delete;
    Reservation& operator=(const Reservation&) = delete;

   private:
    ModelRegistry& registry_;
    const uint64_t size_bytes_;
  };
  // Errors: INVALID_ARGUMENT with the field (header.size_bytes) for nothing or more than a model may have;
  // RESOURCE_EXHAUSTED (MODEL_STORE_FULL).
  absl::StatusOr<std::unique_ptr<Reservation>> Reserve(uint64_t size_bytes);

  // Loads and stores a file; the caller holds a reservation of its size. What is there already stays as it is. Slow for
  // large models. Errors: INVALID_ARGUMENT with the field: header.sha256 when it is not empty and not that of the bytes
  // (hex), header.* for readings out of range, chunk with the loader's words.
  absl::StatusOr<ModelInfo> Upload(const ModelReading& reading, absl::string_view expected_sha256_hex,
                                   std::shared_ptr<const std::vector<uint8_t>> bytes);

  // Errors of both: NOT_FOUND (MODEL_NOT_FOUND).
  absl::StatusOr<ModelInfo> Get(absl::string_view name) const;
  absl::StatusOr<ModelUse> Use(absl::string_view name) const;
  // At most `max_models` whose names come after `after_name`.
  std::vector<ModelInfo> List(absl::string_view after_name, size_t max_models) const;
  // Deleting what is not there is OK. Errors: FAILED_PRECONDITION (MODEL_IN_USE).
  absl::Status Delete(absl::string_view name);

 private:
  struct Entry {
    ModelInfo info;
    ModelUse use;
  };

  ModelRegistry(const Options& options, Store& store) : options_(options), store_(store) {}
  static absl::StatusOr<Entry> Load(const ModelRecord& record, const ModelOptions& options);
  ModelOptions LoadingOptions(const ModelReading& reading) const;
  void Release(uint64_t reserved_bytes);

  const Options options_;
  Store& store_;
  mutable std::mutex mutex_;
  std::map<std::string, Entry, std::less<>> models_ ABSL_GUARDED_BY(mutex_);
  uint64_t stored_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  uint64_t reserved_bytes_ ABSL_GUARDED_BY(mutex_) = 0;
};

}  // namespace evpose::server
