// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_store.h"

#include <algorithm>
#include <mutex>
#include <optional>
#include <set>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/out_of_memory.h"
#include "server/runtime/random_name.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/checked_records.h"
#include "server/stores/sqlite/data_directory.h"
#include "server/stores/sqlite/sqlite_file.h"
#include "server/stores/sqlite/sqlite_records.h"
#include "server/stores/sqlite/sqlite_writer.h"

namespace evpose::server {
namespace {

constexpr char kFileName[] = "evpose.db";

absl::Status DamagedSessionError(absl::string_view name) {
  return absl::DataLossError(
      absl::StrCat("session ", name, " was found damaged when the store was opened, and is skipped: delete it"));
}

class SqliteLease : public CheckedLease {
 public:
  SqliteLease(std::shared_ptr<SqliteWriter> writer, absl::string_view name, const SqliteSessionState& state)
      : CheckedLease(state.token(), state.next_pose_seq), writer_(std::move(writer)), name_(name) {}

 private:
  void Write(SessionCommit commit, const CommitPlace& place, Done done) override {
    const uint64_t size_bytes = SizeBytes(commit);
    writer_->Push(
        [name = name_, token = token(), place, commit = std::move(commit)](SqliteDatabase& database) -> absl::Status {
          EVPOSE_ASSIGN_OR_RETURN(SqliteSessionState state, SqliteReadState(database, name));
          EVPOSE_RETURN_IF_ERROR(CheckHolder(name, state.token(), token));
          if (state.last_commit < place.last_ok) return RolledBackError(name, token.number);
          EVPOSE_RETURN_IF_ERROR(SqliteWriteParts(database, name, commit, place.next_pose_seq, state));
          state.last_commit = place.number;
          return SqliteWriteState(database, name, state);
        },
        size_bytes, std::move(done));
  }

  void Refuse(absl::Status status, Done done) override {
    writer_->Push([status = std::move(status)](SqliteDatabase&) { return status; }, 0, std::move(done));
  }

  const std::shared_ptr<SqliteWriter> writer_;
  const std::string name_;
};

class SqliteStore : public Store {
 public:
  SqliteStore(std::unique_ptr<DataDirectory> directory, uint64_t max_bytes, SqliteFile file,
              std::unique_ptr<SqliteDatabase> reader)
      : directory_(std::move(directory)),
        max_bytes_(max_bytes),
        damage_(std::move(file.contents.damage)),
        writer_(std::make_shared<SqliteWriter>(std::move(file.database))),
        damaged_sessions_(std::move(file.contents.damaged_sessions)),
        reader_(std::move(reader)) {}

  // The writer's connection is closed last, because closing the last connection copies the log into the file.
  ~SqliteStore() override {
    {
      const std::lock_guard lock(mutex_);
      reader_.reset();
    }
    writer_->Close();
  }

  StoreKind kind() const override { return StoreKind::kSqlite; }
  std::vector<std::string> damage() const override { return damage_; }

  absl::Status CheckHealth() override {
    const std::lock_guard lock(mutex_);
    return SqliteLastFencingNumber(*reader_).status();
  }

  std::optional<StoreUsage> Usage() override {
    const std::lock_guard lock(mutex_);
    const absl::StatusOr<uint64_t> bytes = SqliteUsedBytes(*reader_);
    if (!bytes.ok()) return std::nullopt;
    return StoreUsage{*bytes, max_bytes_};
  }

  absl::StatusOr<std::vector<ModelRecord>> ListModels() const override {
    const std::lock_guard lock(mutex_);
    return SqliteListModels(*reader_);
  }

  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    const std::lock_guard lock(mutex_);
    auto model = SqliteReadModel(*reader_, tenant, name);
    EVPOSE_RETURN_IF_ERROR(Noting(model.status()));
    return model;
  }

  absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const override {
    const std::lock_guard lock(mutex_);
    return SqliteHasModel(*reader_, tenant, name);
  }

  absl::Status PutModel(const ModelRecord& model) override {
    return writer_->Call([&](SqliteDatabase& database) { return SqlitePutModel(database, model); },
                         model.bytes->size() + model.prepared.size());
  }

  absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
    return writer_->Call([&](SqliteDatabase& database) { return SqliteDeleteModel(database, tenant, name); });
  }

  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override {
    if (IsDamaged(record.name)) return SessionExistsError(record.name);
    SqliteSessionState state;
    EVPOSE_ASSIGN_OR_RETURN(state.holder, RandomHex128());
    const absl::Status written = writer_->Call([&](SqliteDatabase& database) -> absl::Status {
      const auto found = SqliteReadState(database, record.name);
      if (!absl::IsNotFound(found.status())) return SessionExistsError(record.name);
      const auto of_request = SqliteFindRequest(database, record.tenant, record.request_id);
      if (of_request.ok() || absl::IsDataLoss(of_request.status())) return SessionExistsError(record.name);
      if (!absl::IsNotFound(of_request.status())) return of_request.status();
      EVPOSE_ASSIGN_OR_RETURN(state.fencing_number, SqliteNextFencingNumber(database));
      return SqliteInsertSession(database, record, lifecycle, state);
    });
    EVPOSE_RETURN_IF_ERROR(written);
    return std::make_unique<SqliteLease>(writer_, record.name, state);
  }

  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    if (IsDamaged(name)) return DamagedSessionError(name);
    SqliteSession session;
    EVPOSE_ASSIGN_OR_RETURN(const std::string holder, RandomHex128());
    const absl::Status written = writer_->Call([&](SqliteDatabase& database) -> absl::Status {
      EVPOSE_ASSIGN_OR_RETURN(session, SqliteReadSession(database, name, /*after_pose_seq=*/0));
      EVPOSE_ASSIGN_OR_RETURN(session.state.fencing_number, SqliteNextFencingNumber(database));
      session.state.holder = holder;
      session.state.last_commit = 0;
      return SqliteWriteState(database, name, session.state);
    });
    EVPOSE_RETURN_IF_ERROR(Noting(written));
    return AcquiredSession{.session = std::move(session.stored),
                           .lease = std::make_unique<SqliteLease>(writer_, name, session.state)};
  }

  absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    const std::lock_guard lock(mutex_);
    return ReadOne(name, after_pose_seq);
  }

  absl::StatusOr<std::vector<StoredSession>> ReadWithoutPoses(const std::vector<std::string>& names) const override {
    const std::lock_guard lock(mutex_);
    std::vector<StoredSession> sessions;
    for (const std::string& name : names) {
      auto session = ReadOne(name, kAfterAllPoses);
      if (IsMissingOrDamaged(session.status())) continue;
      EVPOSE_RETURN_IF_ERROR(session.status());
      sessions.push_back(*std::move(session));
    }
    return sessions;
  }

  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const override {
    const std::lock_guard lock(mutex_);
    return SqliteReadTenant(*reader_, name);
  }

  absl::StatusOr<SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                           size_t max_sessions) const override {
    const std::lock_guard lock(mutex_);
    return SqliteListSessions(*reader_, tenant, after_name, max_sessions);
  }

  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const override {
    const std::lock_guard lock(mutex_);
    auto record = SqliteFindRequest(*reader_, tenant, request_id);
    EVPOSE_RETURN_IF_ERROR(Noting(record.status()));
    return record;
  }

  absl::StatusOr<std::vector<SessionOwner>> ListOwners() const override {
    const std::lock_guard lock(mutex_);
    return SqliteListOwners(*reader_);
  }

  absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    const std::lock_guard lock(mutex_);
    return SqliteReadOldestLifecycles(*reader_, max_sessions);
  }

  absl::Status DeleteSession(absl::string_view name) override {
    {
      const std::lock_guard lock(mutex_);
      damaged_sessions_.erase(std::string(name));
    }
    return writer_->Call([&](SqliteDatabase& database) { return SqliteDeleteSession(database, name); });
  }

  absl::Status DeleteHeldSession(absl::string_view name, const FencingToken& token) override {
    return writer_->Call([&](SqliteDatabase& database) -> absl::Status {
      const auto state = SqliteReadState(database, name);
      if (state.ok()) EVPOSE_RETURN_IF_ERROR(CheckHolder(name, state->token(), token));
      return SqliteDeleteSession(database, name);
    });
  }

  absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) override {
    std::vector<std::string> ended;
    const absl::Status written = writer_->Call([&](SqliteDatabase& database) -> absl::Status {
      EVPOSE_ASSIGN_OR_RETURN(ended, SqliteSessionsEndedBefore(database, ended_before));
      for (const std::string& name : ended) EVPOSE_RETURN_IF_ERROR(SqliteDeleteSession(database, name));
      return absl::OkStatus();
    });
    EVPOSE_RETURN_IF_ERROR(written);
    std::vector<std::string> names = writer_->TakeDeletedForRoom();
    std::move(ended.begin(), ended.end(), std::back_inserter(names));
    return names;
  }

 private:
  // Returns `status`. After damage, the next start checks all records and rescues the intact ones.
  const absl::Status& Noting(const absl::Status& status) const {
    if (absl::IsDataLoss(status)) MarkForCheck(directory_->PathOf(kFileName));
    return status;
  }

  absl::StatusOr<StoredSession> ReadOne(absl::string_view name, uint64_t after_pose_seq) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (damaged_sessions_.contains(name)) return DamagedSessionError(name);
    EVPOSE_RETURN_IF_ERROR(reader_->Execute("BEGIN"));  // all queries read one snapshot
    const absl::Cleanup end = [&reader = *reader_] {
      // The transaction is open after a failed allocation or COMMIT; the next BEGIN would fail without the rollback.
      if (reader.InTransaction()) RunUnlessOutOfMemory([&reader] { reader.Execute("ROLLBACK").IgnoreError(); });
    };
    auto session = SqliteReadSession(*reader_, name, after_pose_seq);
    EVPOSE_RETURN_IF_ERROR(reader_->Execute("COMMIT"));
    EVPOSE_RETURN_IF_ERROR(Noting(session.status()));
    return std::move(session->stored);
  }

  bool IsDamaged(absl::string_view name) const {
    const std::lock_guard lock(mutex_);
    return damaged_sessions_.contains(name);
  }

  const std::unique_ptr<DataDirectory> directory_;  // the first member: unlocked after the file is closed
  const uint64_t max_bytes_;
  const std::vector<std::string> damage_;
  const std::shared_ptr<SqliteWriter> writer_;
  mutable std::mutex mutex_;
  std::set<std::string, std::less<>> damaged_sessions_ ABSL_GUARDED_BY(mutex_);
  std::unique_ptr<SqliteDatabase> reader_ ABSL_GUARDED_BY(mutex_);
};

}  // namespace

absl::StatusOr<std::unique_ptr<Store>> OpenSqliteStore(const SqliteStoreOptions& options) {
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<DataDirectory> directory, DataDirectory::Open(options.data_dir));
  const std::string path = directory->PathOf(kFileName);
  EVPOSE_ASSIGN_OR_RETURN(SqliteFile file, OpenSqliteFile(path, options.max_checked_bytes));
  EVPOSE_RETURN_IF_ERROR(LimitSqliteBytes(*file.database, options.max_bytes));
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<SqliteDatabase> reader, OpenSqliteReader(path));
  return std::make_unique<SqliteStore>(std::move(directory), options.max_bytes, std::move(file), std::move(reader));
}

}  // namespace evpose::server
