// SPDX-License-Identifier: Apache-2.0

// The object models of all tenants. A model is loaded when a session first uses it, shared by all sessions of its
// tenant, and released with the last of them. Tenants are independent: the same file uploaded by two tenants is two
// models, which have the same name and are deleted separately.
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
#include "server/models/model_limits.h"
#include "server/models/model_preparer.h"
#include "server/runtime/keyed_mutexes.h"
#include "server/runtime/slow_executor.h"
#include "server/stores/common/store.h"

namespace evpose::server {

struct ModelInfo {
  std::string name;
  ModelReading reading;
  uint64_t size_bytes = 0;
  uint32_t num_faces = 0;
  uint32_t num_lines = 0;
  uint32_t num_curves = 0;
  uint32_t num_regions = 0;
  uint32_t num_symmetries = 1;
  std::optional<ContinuousSymmetry> continuous_symmetry;
  double diameter_m = 0.0;
  std::string sha256_hex;  // digest of the file's bytes
  std::vector<std::string> notices;
  absl::Time create_time;
  std::string file_name;  // file name of the first upload; may be empty
};

// Returns "models/{id}"; the id is defined at Model.name in the API.
std::string ModelName(const ModelReading& reading, absl::Span<const uint8_t> bytes);

// Returns INVALID_ARGUMENT (header.sha256) when the expected digest (hexadecimal) is not empty and differs from the
// actual one.
absl::Status CheckSha256(absl::string_view expected_hex, absl::string_view actual_hex, uint64_t num_bytes);

// A reference to a model in use. The model cannot be deleted while `use` or a copy of it exists. `model` is null while
// the model is not loaded.
struct ModelUse {
  std::shared_ptr<const ObjectModel> model;
  std::shared_ptr<const void> use;
};

// Thread-safe.
class ModelRegistry {
 public:
  struct Options {
    ModelLimits::Options limits;
    bool shares_store = false;  // other servers add and delete models in the same store
    std::shared_ptr<const ModelPreparer> preparer = MakeModelPreparer();
  };

  // Reads the list of the store's models, and loads none. Errors: those of the store.
  static absl::StatusOr<std::unique_ptr<ModelRegistry>> Create(const Options& options, Store& store);
  ~ModelRegistry();

  ModelLimits& limits() { return limits_; }

  // Finds a file that has been uploaded before with the same parameters, so that a repeated upload needs no space. The
  // model cannot be deleted while the result exists.
  struct Known {
    ModelInfo info;
    ModelUse use;
  };
  std::optional<Known> FindFile(const std::string& tenant, const ModelReading& reading, uint64_t size_bytes,
                                absl::string_view sha256_hex) const;

  // Prepares and stores a file. A model that exists is returned unchanged, with its first file name. Takes seconds for
  // large models. Errors:
  // INVALID_ARGUMENT with the field (header.sha256 as CheckSha256(), header for parameters out of range, chunk for a
  // file that cannot be parsed) or the reason MODEL_TOO_EXPENSIVE; the status of `cancellation`; those of the
  // store.
  absl::StatusOr<ModelInfo> Upload(const std::string& tenant, const ModelReading& reading,
                                   absl::string_view expected_sha256_hex,
                                   std::shared_ptr<const std::vector<uint8_t>> bytes,
                                   const Cancellation& cancellation = Cancellation(),
                                   const std::string& file_name = "");

  // Checks that a known model is still in the store. A model that another server has deleted is forgotten. Waits for
  // the store if it is shared. Errors: NOT_FOUND (MODEL_NOT_FOUND); those of the store.
  absl::Status CheckStored(const std::string& tenant, const std::string& name);

  // Return a known model, loaded or not. Errors: NOT_FOUND (MODEL_NOT_FOUND).
  absl::StatusOr<ModelInfo> Get(const std::string& tenant, absl::string_view name) const;
  absl::StatusOr<ModelUse> Use(const std::string& tenant, absl::string_view name) const;
  // Does the same as Use(), and also finds a model that another server has added to the store, and loads the model.
  // Waits for the store. A model that another version of the preparation derived is prepared again, which takes
  // seconds. Errors: those of Use(); DATA_LOSS if the model is damaged or cannot be prepared; the status of
  // SlowExecutor::Running() if that ends the preparation, or while another session loads the model; those of the store.
  absl::StatusOr<ModelUse> UseStored(const std::string& tenant, absl::string_view name);
  // Tenant and name of the models that another version of the preparation derived.
  std::vector<std::pair<std::string, std::string>> Outdated() const;

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
    uint64_t stored_bytes = 0;  // size of the file and of what was derived from it
    bool is_current = false;    // prepared by this version; otherwise the counts in `info` are missing
    std::shared_ptr<const void> use = std::make_shared<const char>();
    std::weak_ptr<const ObjectModel> model;  // empty while no session uses it
    bool is_being_deleted = false;           // Delete() is in progress: no new use is allowed
  };

  ModelRegistry(const Options& options, Store& store) : options_(options), store_(store), limits_(options.limits) {}
  // Adds the model to the list, or updates what the list says about it.
  ModelInfo Insert(const ModelRecord& record);
  bool IsCurrent(const Key& key) const;
  // Fills in `prepared` and `summary`. Errors: those of ModelPreparer.
  absl::StatusOr<std::shared_ptr<const ObjectModel>> Prepare(ModelRecord& record,
                                                             const Cancellation& cancellation) const;
  // A use of a model that is perhaps only in the store; `record`: the model if it was read for that. The caller has
  // locked the model in `loading_`.
  absl::StatusOr<ModelUse> FindStored(const Key& key, std::optional<ModelRecord>& record);
  absl::StatusOr<std::shared_ptr<const ObjectModel>> Load(ModelRecord record);
  // Blocks new uses of the model. Returns false if this server has no entry for it. Errors: FAILED_PRECONDITION
  // (MODEL_IN_USE).
  absl::StatusOr<bool> BeginDelete(const Key& key);
  void EndDelete(const Key& key, const absl::Status& status);
  absl::Status DeleteStored(const Key& key, bool was_here);
  absl::Status CheckUnusedInStore(const Key& key) const;
  void Forget(const Key& key);
  ModelOptions LoadingOptions(const ModelReading& reading) const;

  const Options options_;
  Store& store_;
  // One mutex for each model that is being read, loaded or prepared for a session. Locked before store_mutex_.
  KeyedMutexes<Key> loading_;
  // Held during calls of the store that change the list, so that store and models_ stay consistent. Locked before
  // mutex_, which is never held while waiting.
  std::mutex store_mutex_;
  mutable std::mutex mutex_;
  std::map<Key, Entry> models_ ABSL_GUARDED_BY(mutex_);
  ModelLimits limits_;
};

}  // namespace evpose::server
