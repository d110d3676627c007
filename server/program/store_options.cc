// SPDX-License-Identifier: Apache-2.0
#include "server/program/store_options.h"

#include <cstdlib>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/string_view.h"
#include "core/base/output_file.h"
#include "core/base/status_macros.h"
#include "server/stores/postgres/postgres_address.h"
#include "server/stores/redis/redis_address.h"
#include "server/stores/redis/redis_groups_file.h"

namespace evpose::server {
namespace {

// The default of --data-dir.
std::string DefaultDataDirectory() {
  constexpr std::pair<const char*, const char*> kPlaces[] = {
      {"STATE_DIRECTORY", ""}, {"XDG_STATE_HOME", "/evpose"}, {"HOME", "/.local/state/evpose"}};
  for (const auto& [variable, below] : kPlaces) {
    const char* directory = std::getenv(variable);
    if (directory != nullptr && *directory != '\0') return absl::StrCat(directory, below);
  }
  return "";
}

// Chooses the default data directory and creates its parents. The parent of a directory given by the user must exist,
// so that a misspelled path is an error.
absl::Status ChooseDataDirectory(StoreOptions& options) {
  if (options.store != "sqlite" || !options.data_dir.empty()) return absl::OkStatus();
  options.data_dir = DefaultDataDirectory();
  if (options.data_dir.empty()) {
    return absl::InvalidArgumentError(
        "there is no home directory to keep sessions in: give --data-dir, or --store memory");
  }
  std::error_code error;
  std::filesystem::create_directories(std::filesystem::path(options.data_dir).parent_path(), error);
  if (!error) return absl::OkStatus();
  return absl::PermissionDeniedError(absl::StrCat("cannot make the directory for ", options.data_dir, ": ",
                                                  error.message(), "; give --data-dir, or --store memory"));
}

absl::StatusOr<std::string> ReadStorePassword(const std::string& file) {
  constexpr size_t kMaxPasswordBytes = 4096;  // a longer file is not that of a password
  EVPOSE_ASSIGN_OR_RETURN(const std::string contents, ReadFile(file, kMaxPasswordBytes));
  const absl::string_view password = absl::StripAsciiWhitespace(contents);
  if (password.empty()) return absl::InvalidArgumentError(absl::StrCat(file, ": there is no password in it"));
  return std::string(password);
}

// Returns the store's address with the password, escaped with %XX.
std::string AddStorePassword(const std::string& store, const std::string& password) {
  std::string escaped;
  for (const char c : password) escaped += absl::StrFormat("%%%02X", static_cast<unsigned char>(c));
  if (IsPostgresUrl(store)) return WithPostgresPassword(store, escaped);
  const size_t user = store.find("://") + 3;
  const size_t at = store.rfind('@');
  const std::string text = absl::StrCat(at == std::string::npos || at == user ? ":" : "", escaped);
  if (at != std::string::npos) return absl::StrCat(store.substr(0, at), text, store.substr(at));
  return absl::StrCat(store.substr(0, user), text, "@", store.substr(user));
}

}  // namespace

absl::Status CheckStore(const std::string& store) {
  EVPOSE_ASSIGN_OR_RETURN(const StoreKind kind, KindOfStore(store));
  switch (kind) {
    case StoreKind::kMemory:
    case StoreKind::kSqlite:
      break;
    case StoreKind::kRedis:
      if (store == kRedisGroupsPrefix) return absl::InvalidArgumentError("redis-groups: has no FILE");
      return HasRedisGroups(store) ? absl::OkStatus() : ParseRedisAddress(store).status();
    case StoreKind::kPostgresql:
      return ParsePostgresAddress(store).status();
  }
  return absl::OkStatus();
}

absl::Status CheckStorePassword(const ProgramOptions& options) {
  if (options.store_password_file.empty()) return absl::OkStatus();
  const std::string& store = options.server.store.store;
  EVPOSE_ASSIGN_OR_RETURN(const StoreKind kind, KindOfStore(store));
  std::string password;
  switch (kind) {
    case StoreKind::kMemory:
    case StoreKind::kSqlite:
      return absl::InvalidArgumentError(
          "is for --store redis://HOST:PORT, redis+sentinel://HOST:PORT,.../NAME, redis-groups:FILE and "
          "postgresql://HOST:PORT/DATABASE");
    case StoreKind::kRedis: {
      if (HasRedisGroups(store)) return absl::OkStatus();
      EVPOSE_ASSIGN_OR_RETURN(const RedisAddress address, ParseRedisAddress(store));
      password = address.password;
      break;
    }
    case StoreKind::kPostgresql: {
      EVPOSE_ASSIGN_OR_RETURN(const PostgresAddress address, ParsePostgresAddress(store));
      password = address.Get("password");
      break;
    }
  }
  if (password.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError("the address of --store has a password already: give one of them");
}

absl::Status CheckStoreLimit(const StoreOptions& store) {
  constexpr uint64_t kMinBytes = 1u << 20;  // a smaller number is one of megabytes, by mistake
  if (store.max_bytes < kMinBytes) {
    return absl::InvalidArgumentError(absl::StrCat("is ", store.max_bytes, "; give at least ", kMinBytes));
  }
  EVPOSE_ASSIGN_OR_RETURN(const StoreKind kind, KindOfStore(store.store));
  if (store.max_bytes == StoreOptions().max_bytes || kind != StoreKind::kRedis) return absl::OkStatus();
  return absl::InvalidArgumentError("is for --store sqlite, memory and postgresql://; set maxmemory in Redis instead");
}

absl::Status CheckDivideStore(const ProgramOptions& options) {
  if (!options.divides_store || HasRedisGroups(options.server.store.store)) return absl::OkStatus();
  return absl::InvalidArgumentError("is for --store redis-groups:FILE");
}

absl::Status CompleteStore(ProgramOptions& options) {
  StoreOptions& store = options.server.store;
  EVPOSE_RETURN_IF_ERROR(ChooseDataDirectory(store));
  if (options.store_password_file.empty()) return absl::OkStatus();
  EVPOSE_ASSIGN_OR_RETURN(const std::string password, ReadStorePassword(options.store_password_file));
  if (HasRedisGroups(store.store)) {
    store.groups_password = password;
  } else {
    store.store = AddStorePassword(store.store, password);
  }
  return absl::OkStatus();
}

std::string StoreForLog(const StoreOptions& options) {
  const absl::StatusOr<StoreKind> kind = KindOfStore(options.store);
  if (!kind.ok()) return options.store;
  switch (*kind) {
    case StoreKind::kMemory:
      break;
    case StoreKind::kSqlite:
      return absl::StrCat("sqlite in ", options.data_dir);
    case StoreKind::kRedis: {
      const auto address = ParseRedisAddress(options.store);
      return address.ok() ? address->Printable() : options.store;
    }
    case StoreKind::kPostgresql: {
      const auto address = ParsePostgresAddress(options.store);
      return address.ok() ? address->Printable() : options.store;
    }
  }
  return options.store;
}

}  // namespace evpose::server
