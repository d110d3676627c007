// SPDX-License-Identifier: Apache-2.0

// The object models of all tenants. A model is loaded once and shared by all sessions of its tenant. Tenants are
// independent: the same file uploaded by two tenants is two models, which have the same name and are deleted
// separately.
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
  ModelReading reading;
  uint64_t size_bytes = 0;
  uint32_t num_faces = 0;
  uint32_t num_lines = 0;
  uint32_t num_symmetries = 1;
  double diameter_m = 0.0;
  std::string sha256_hex;  // of the file's bytes
  std::vector<std::string> notices;
  absl::Time create_time;
};

// Returns "models/{id}"; the id is defined at Model.name in the API.
std::string ModelName(const ModelReading& reading, absl::Span<const uint8_t> bytes);

// Returns INVALID_ARGUMENT (header.sha256) when the expected digest (hexadecimal) is not empty and differs from the
// actual one.
absl::Status CheckSha256(absl::string_view expected_hex, absl::string_view actual_hex, uint64_t num_bytes);

// A reference to a model in use. The model cannot be deleted while `use` or a copy of it exists.
struct ModelUse {
  std::shared_ptr<const ObjectModel> model;
  std::shared_ptr<const void> use;
};

// Thread-safe.
class ModelRegistry {
 public:
  struct Options {
    uint64_t max_model_bytes = 64ull << 20;
    uint64_t max_store_bytes = 512ull << 20;   // of all files, including uploads in progress
    uint64_t max_tenant_bytes = 512ull << 20;  // of the files of one tenant, including uploads in progress
    bool shares_store = false;                 // other servers add and delete models in the same store
    std::shared_ptr<ServerMetrics> metrics = std::make_shared<ServerMetrics>();
  };

  // Loads all models of the store. A model that cannot be loaded is reported in the log and skipped. Errors: those of
  // the store.
  static absl::StatusOr<std::unique_ptr<ModelRegistry>> Create(const Options& options, Store& store);
  ~ModelRegistry();

  // Reserves bytes for an upload until the result is destroyed. Errors: INVALID_ARGUMENT (header.size_bytes) for a size
  // of 0 or above max_model_bytes; RESOURCE_EXHAUSTED (MODEL_STORE_FULL, or TENANT_QUOTA when the tenant's own limit is
  // reached).
  absl::StatusOr<std::shared_ptr<const void>> Reserve(const std::string& tenant, uint64_t size_bytes);

  // Finds a file that has been uploaded before with the same parameters, so that a repeated upload needs no space. The
  // model cannot be deleted while the result exists.
  struct Known {
    ModelInfo info;
    ModelUse use;
  };
  std::optional<Known> FindFile(const std::string& tenant, const ModelReading& reading, uint64_t size_bytes,
                                absl::string_view sha256_hex) const;

  // Loads and stores a file, for which the caller holds a reservation. A model that exists is returned unchanged. Takes
  // seconds for large models. Errors: INVALID_ARGUMENT with the field (header.sha256 as CheckSha256(), header for
  // parameters out of range, chunk for a file that cannot be parsed); those of the store.
  absl::StatusOr<ModelInfo> Upload(const std::string& tenant, const ModelReading& reading,
                                   absl::string_view expected_sha256_hex,
                                   std::shared_ptr<const std::vector<uint8_t>> bytes);

  // Checks that a loaded model is still in the store. A model that another server has deleted is unloaded. Waits for
  // the store if it is shared. Errors: NOT_FOUND (MODEL_NOT_FOUND); those of the store.
  absl::Status CheckStored(const std::string& tenant, const std::string& name);

  // Return a loaded model. Errors: NOT_FOUND (MODEL_NOT_FOUND).
  absl::StatusOr<ModelInfo> Get(const std::string& tenant, absl::string_view name) const;
  absl::StatusOr<ModelUse> Use(const std::string& tenant, absl::string_view name) const;
  // As Use(), but also loads a model that another server has added to the store. Waits for the store. Errors: those of
  // Use(); those of the store.
  absl::StatusOr<ModelUse> UseStored(const std::string& tenant, absl::string_view name);
  // Returns at most `max_models` models with names after `after_name`, sorted by name.
  std::vector<ModelInfo> List(const std::string& tenant, absl::string_view after_name, size_t max_models) const;
  // Deletes a model. Waits for the store. Errors: FAILED_PRECONDITION (MODEL_IN_USE) while a session uses it, including
  // ended sessions and, with a shared store, sessions of other servers; NOT_FOUND (MODEL_NOT_FOUND); those of the
  // store.
  absl::Status Delete(const std::string& tenant, absl::string_view name);

 private:
  using Key = std::pair<std::string, std::string>;  // tenant, name
  struct Entry {
    ModelInfo info;
    ModelUse use;
    bool is_going = false;  // Delete() is in progress: no new use is allowed
  };

  ModelRegistry(const Options& options, Store& store) : options_(options), store_(store) {}
  absl::StatusOr<Entry> Load(const ModelRecord& record) const;
  // Blocks new uses of the model. Returns false when it is not loaded. Errors: FAILED_PRECONDITION (MODEL_IN_USE).
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
  // Held during calls of the store about one model, so that store and models_ stay consistent. Locked before mutex_,
  // which is never held while waiting.
  std::mutex store_mutex_;
  mutable std::mutex mutex_;
  std::map<Key, Entry> models_ ABSL_GUARDED_BY(mutex_);
  // Stored and reserved bytes, of all tenants and by tenant. A tenant without bytes is not in the map.
  uint64_t bytes_ ABSL_GUARDED_BY(mutex_) = 0;
  std::map<std::string, uint64_t> bytes_of_tenant_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace evpose::server
