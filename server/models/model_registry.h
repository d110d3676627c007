// SPDX-License-Identifier: Apache-2.0

// The models that sessions may track: loaded once, shared by all sessions of a tenant. What one tenant has is nothing
// to another: the same file of two is two models, of the same name, each with its own life.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "core/models/object_model.h"
#include "server/stores/common/store.h"
#include "server/telemetry/metrics.h"

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

  friend bool operator==(const ModelReading&, const ModelReading&) = default;
};

// "models/{id}", id as the API's Model.name says.
std::string ModelName(const ModelReading& reading, absl::Span<const uint8_t> bytes);

// INVALID_ARGUMENT (header.sha256) when a digest was expected (hex, not empty) that is not that of the bytes.
absl::Status CheckSha256(absl::string_view expected_hex, absl::string_view actual_hex, uint64_t num_bytes);

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
    uint64_t max_store_bytes = 512ull << 20;   // of all files, those on their way included
    uint64_t max_tenant_bytes = 512ull << 20;  // of those of one tenant
    bool shares_store = false;                 // other servers put models into it, and delete them
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };

  // Loads what the store has; what can no longer be loaded is named in the log and left out. Errors: those of the
  // store.
  static absl::StatusOr<std::unique_ptr<ModelRegistry>> Create(const Options& options, Store& store);
  ~ModelRegistry();

  // Room for a file on its way; given back at destruction.
  class Reservation {
   public:
    Reservation(ModelRegistry& registry, const std::string& tenant, uint64_t size_bytes)
        : registry_(registry), tenant_(tenant), size_bytes_(size_bytes) {}
    ~Reservation() { registry_.Release(tenant_, size_bytes_); }
    Reservation(const Reservation&) = delete;
    Reservation& operator=(const Reservation&) = delete;

   private:
    ModelRegistry& registry_;
    const std::string tenant_;
    const uint64_t size_bytes_;
  };
  // Errors: INVALID_ARGUMENT with the field (header.size_bytes) for nothing or more than a model may have;
  // RESOURCE_EXHAUSTED (MODEL_STORE_FULL; TENANT_QUOTA when it is the tenant's share that is full).
  absl::StatusOr<std::unique_ptr<Reservation>> Reserve(const std::string& tenant, uint64_t size_bytes);

  // A file that is there already, read the same way: uploading it again takes no room. It cannot be deleted while one
  // of these lives.
  struct Known {
    ModelInfo info;
    ModelUse use;
  };
  std::optional<Known> FindFile(const std::string& tenant, const ModelReading& reading, uint64_t size_bytes,
                                absl::string_view sha256_hex) const;

  // Loads and stores a file; the caller holds a reservation of its size. What is there already stays as it is. Slow for
  // large models. Errors: INVALID_ARGUMENT with the field: as CheckSha256, header.* for readings out of range, chunk
  // with the loader's words.
  absl::StatusOr<ModelInfo> Upload(const std::string& tenant, const ModelReading& reading,
                                   absl::string_view expected_sha256_hex,
                                   std::shared_ptr<const std::vector<uint8_t>> bytes);

  // For one that is known: OK when it is in the store. One that another server has deleted is forgotten. Waits for the
  // store when it is shared. Errors: NOT_FOUND (MODEL_NOT_FOUND), those of the store.
  absl::Status CheckStored(const std::string& tenant, const std::string& name);

  // Errors of both: NOT_FOUND (MODEL_NOT_FOUND).
  absl::StatusOr<ModelInfo> Get(const std::string& tenant, absl::string_view name) const;
  absl::StatusOr<ModelUse> Use(const std::string& tenant, absl::string_view name) const;
  // The same, also of a model that another server has put into the store since. Waits for the store. Errors beside
  // those of Use: those of the store.
  absl::StatusOr<ModelUse> UseStored(const std::string& tenant, absl::string_view name);
  // At most `max_models` whose names come after `after_name`.
  std::vector<ModelInfo> List(const std::string& tenant, absl::string_view after_name, size_t max_models) const;
  // Waits for the store. Deleting again is OK, as long as it is remembered. Errors: FAILED_PRECONDITION (MODEL_IN_USE)
  // while there is a session that uses it, ended or not, on a shared store also at another server; NOT_FOUND
  // (MODEL_NOT_FOUND); those of the store.
  absl::Status Delete(const std::string& tenant, absl::string_view name);

 private:
  using Key = std::pair<std::string, std::string>;  // tenant, name
  struct Entry {
    ModelInfo info;
    ModelUse use;
    bool is_going = false;  // the store is about to delete it: it is given to nobody
  };

  ModelRegistry(const Options& options, Store& store) : options_(options), store_(store) {}
  static absl::StatusOr<Entry> Load(const ModelRecord& record, const ModelOptions& options);
  // False: it is not here. Nobody gets it from now on.
  absl::StatusOr<bool> BeginDelete(const Key& key);
  void EndDelete(const Key& key, const absl::Status& status);
  absl::Status DeleteStored(const Key& key, bool was_here);
  absl::Status CheckUnusedInStore(const Key& key) const;
  void Forget(const Key& key);
  ModelOptions LoadingOptions(const ModelReading& reading) const;
  void Release(const std::string& tenant, uint64_t reserved_bytes);
  void AddBytes(const std::string& tenant, uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  void RemoveBytes(const std::string& tenant, uint64_t bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const Options options_;
  Store& store_;
  // Held while the store is asked for one model: what it says stands then. Before mutex_, with which nobody waits.
  std::mutex store_mutex_;
  mutable std::mutex mutex_;
  std::map<Key, Entry> models_ ABSL_GUARDED_BY(mutex_);
  // Of all and of each tenant, stored and reserved; a tenant without any is not in the map.
  uint64_t bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  std::map<std::string, uint64_t> bytes_of_tenant_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
