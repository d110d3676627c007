// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_store.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/runtime/random_name.h"
#include "server/stores/common/checked_lease.h"
#include "server/stores/common/checked_records.h"
#include "server/stores/postgres/postgres_records.h"
#include "server/stores/postgres/postgres_schema.h"
#include "server/stores/postgres/postgres_writer.h"

namespace evpose::server {
namespace {

// The number of lifecycles that are read, and of ended sessions that are deleted, with one statement.
constexpr uint64_t kSessionsPerStatement = 1000;

// The state that the leases share with their store. It lives until the last lease is destroyed.
struct Shared {
  explicit Shared(const PostgresClientOptions& options)
      : client(std::make_shared<PostgresClient>(options)), writer(client) {}

  const std::shared_ptr<PostgresClient> client;
  PostgresWriter writer;
};

class PostgresSessionLease : public CheckedLease {
 public:
  PostgresSessionLease(std::shared_ptr<Shared> shared, absl::string_view name, FencingToken token,
                       uint64_t next_pose_seq)
      : CheckedLease(std::move(token), next_pose_seq), shared_(std::move(shared)), name_(name) {}

 private:
  void Write(SessionCommit commit, const CommitPlace& place, Done done) override {
    shared_->writer.Push(PostgresCommit(name_, token(), place, std::move(commit)), std::move(done));
  }
  void Refuse(absl::Status status, Done done) override { shared_->writer.Refuse(std::move(status), std::move(done)); }

  const std::shared_ptr<Shared> shared_;
  const std::string name_;
};

class PostgresStore : public Store {
 public:
  explicit PostgresStore(const PostgresStoreOptions& options)
      : options_(options), shared_(std::make_shared<Shared>(options.client)) {}
  ~PostgresStore() override {
    shared_->writer.Close();
    shared_->client->Close();
  }

  // Reads all records unless there are too many. To be called before every other function.
  absl::Status Check() {
    const uint64_t limit = options_.max_checked_records + 1;
    EVPOSE_ASSIGN_OR_RETURN(const auto rows, client().Call({{.statement = &kPostgresSomeSessions, .values = {limit}},
                                                            {.statement = &kPostgresListModels}}));
    const PostgresRows &sessions = rows[0], &models = rows[1];
    if (sessions.size() + models.size() > options_.max_checked_records) return absl::OkStatus();
    for (size_t i = 0; i < sessions.size(); ++i) {
      const std::string name = sessions.Bytes(i, 0);
      NoteDamage(absl::StrCat("session ", name), ReadSession(name, 0).status(), damage_);
    }
    for (size_t i = 0; i < models.size(); ++i) {
      const std::string name = models.Bytes(i, 0);
      NoteDamage(absl::StrCat("model ", name), ReadModel(models.Bytes(i, 1), name).status(), damage_);
    }
    return absl::OkStatus();
  }

  StoreKind kind() const override { return StoreKind::kPostgresql; }
  // Not healthy without a synchronous standby that PostgreSQL waits for: no commit would succeed.
  absl::Status CheckHealth() override { return client().Call({{.statement = &kPostgresHealth}}).status(); }
  std::vector<std::string> damage() const override { return damage_; }

  std::optional<StoreUsage> Usage() override {
    const auto rows = client().Call({{.statement = &kPostgresUsedBytes}});
    if (!rows.ok()) return std::nullopt;
    return StoreUsage{.bytes = rows->at(0).Unsigned(0, 0), .max_bytes = options_.client.max_bytes};
  }

  absl::StatusOr<std::vector<ModelRecord>> ListModels() const override {
    EVPOSE_ASSIGN_OR_RETURN(const auto rows, client().Call({{.statement = &kPostgresListModels}}));
    std::vector<ModelRecord> models;
    for (size_t i = 0; i < rows[0].size(); ++i) {
      auto model =
          DecodeModelHeader(rows[0].Bytes(i, 1), rows[0].Bytes(i, 0), rows[0].Bytes(i, 2), rows[0].Unsigned(i, 3));
      if (model.ok()) models.push_back(*std::move(model));
    }
    return models;
  }

  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    EVPOSE_ASSIGN_OR_RETURN(const auto rows,
                            client().Call({{.statement = &kPostgresReadModel, .values = {name, tenant}}}));
    if (rows[0].size() == 0) return ModelNotFoundError(name);
    const std::string bytes = rows[0].Bytes(0, 1);
    EVPOSE_ASSIGN_OR_RETURN(ModelRecord model, DecodeModelHeader(tenant, name, rows[0].Bytes(0, 0), bytes.size()));
    EVPOSE_RETURN_IF_ERROR(DecodeModelBytes(bytes, model));
    return model;
  }

  absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const override {
    EVPOSE_ASSIGN_OR_RETURN(const auto rows,
                            client().Call({{.statement = &kPostgresHasModel, .values = {name, tenant}}}));
    return rows[0].size() > 0;
  }

  absl::Status PutModel(const ModelRecord& model) override {
    const std::string header = EncodeModelHeader(model);
    const std::string bytes = EncodeModelBytes(model);
    return client().With([&](PostgresConnection& connection) -> absl::Status {
      EVPOSE_RETURN_IF_ERROR(client().MakeRoom(connection, bytes.size()));
      return Transact(connection,
                      {{.statement = &kPostgresPutModel, .values = {model.name, model.tenant, header, bytes}}})
          .status();
    });
  }

  absl::Status DeleteModel(absl::string_view tenant, absl::string_view name) override {
    return client().With([&](PostgresConnection& connection) {
      return Transact(connection, {{.statement = &kPostgresDeleteModel, .values = {name, tenant}}}).status();
    });
  }

  absl::StatusOr<std::unique_ptr<SessionLease>> CreateSession(const SessionRecord& record,
                                                              const std::string& lifecycle) override {
    FencingToken token;
    EVPOSE_ASSIGN_OR_RETURN(token.holder, RandomHex128());
    const std::string encoded = EncodeRecord(record);
    const std::string encoded_lifecycle = AddChecksum(LifecycleOf(record.name), lifecycle);
    const uint64_t bytes = encoded.size() + encoded_lifecycle.size();
    const absl::Status created = client().With([&](PostgresConnection& connection) -> absl::Status {
      EVPOSE_RETURN_IF_ERROR(client().MakeRoom(connection, bytes));
      EVPOSE_ASSIGN_OR_RETURN(const auto rows,
                              Transact(connection, {{.statement = &kPostgresCreate,
                                                     .values = {record.name, record.tenant, record.request_id, encoded,
                                                                encoded_lifecycle, token.holder, bytes}}}));
      if (rows[1].size() == 0) return SessionExistsError(record.name);
      token.number = rows[1].Unsigned(0, 0);
      return absl::OkStatus();
    });
    EVPOSE_RETURN_IF_ERROR(created);
    return std::make_unique<PostgresSessionLease>(shared_, record.name, std::move(token), /*next_pose_seq=*/1);
  }

  absl::StatusOr<AcquiredSession> AcquireSession(absl::string_view name) override {
    EVPOSE_ASSIGN_OR_RETURN(std::string holder, RandomHex128());
    PostgresSession session;
    EVPOSE_RETURN_IF_ERROR(client().With([&](PostgresConnection& connection) -> absl::Status {
      const uint64_t all = 0;
      EVPOSE_ASSIGN_OR_RETURN(const auto rows,
                              Transact(connection, {{.statement = &kPostgresLock, .values = {name}},
                                                    {.statement = &kPostgresAcquire, .values = {name, holder}},
                                                    {.statement = &kPostgresReadSession, .values = {name}},
                                                    {.statement = &kPostgresReadPoses, .values = {name, all}}}));
      EVPOSE_ASSIGN_OR_RETURN(session, ParsePostgresSession(name, /*after_pose_seq=*/0, rows[3], rows[4]));
      return absl::OkStatus();
    }));
    return AcquiredSession{
        .session = std::move(session.stored),
        .lease = std::make_unique<PostgresSessionLease>(
            shared_, name, FencingToken{session.fencing_number, std::move(holder)}, session.next_pose_seq)};
  }

  absl::StatusOr<StoredSession> ReadSession(absl::string_view name, uint64_t after_pose_seq) const override {
    const uint64_t after = std::min(after_pose_seq, kAfterAllPoses);  // a number beyond bigint is beyond all poses, too
    EVPOSE_ASSIGN_OR_RETURN(const auto rows, client().Call({{.statement = &kPostgresBeginReading},
                                                            {.statement = &kPostgresReadSession, .values = {name}},
                                                            {.statement = &kPostgresReadPoses, .values = {name, after}},
                                                            {.statement = &kPostgresCommit}}));
    EVPOSE_ASSIGN_OR_RETURN(PostgresSession session, ParsePostgresSession(name, after, rows[1], rows[2]));
    return std::move(session.stored);
  }

  absl::StatusOr<std::vector<StoredSession>> ReadWithoutPoses(const std::vector<std::string>& names) const override {
    std::vector<PostgresCommand> commands;
    for (const std::string& name : names) commands.push_back({.statement = &kPostgresReadSession, .values = {name}});
    EVPOSE_ASSIGN_OR_RETURN(const auto rows, client().Call(commands));
    std::vector<StoredSession> sessions;
    for (size_t i = 0; i < names.size(); ++i) {
      auto read = ParsePostgresSession(names[i], kAfterAllPoses, rows[i], /*poses=*/PostgresRows(nullptr));
      if (IsMissingOrDamaged(read.status())) continue;
      EVPOSE_RETURN_IF_ERROR(read.status());
      sessions.push_back(std::move(read->stored));
    }
    return sessions;
  }

  absl::StatusOr<std::string> ReadTenant(absl::string_view name) const override {
    EVPOSE_ASSIGN_OR_RETURN(const auto rows, client().Call({{.statement = &kPostgresReadTenant, .values = {name}}}));
    if (rows[0].size() == 0) return SessionNotFoundError(name);
    return rows[0].Bytes(0, 0);
  }

  absl::StatusOr<SessionPage> ListSessions(absl::string_view tenant, absl::string_view after_name,
                                           size_t max_sessions) const override {
    const uint64_t limit = max_sessions;
    EVPOSE_ASSIGN_OR_RETURN(
        const auto rows, client().Call({{.statement = &kPostgresListSessions, .values = {tenant, after_name, limit}}}));
    SessionPage page;
    for (size_t i = 0; i < rows[0].size(); ++i) {
      page.last_name = rows[0].Bytes(i, 0);
      auto record = DecodeRecord(page.last_name, rows[0].Bytes(i, 1));
      if (record.ok()) page.records.push_back(*std::move(record));
    }
    if (rows[0].size() < max_sessions) page.last_name.clear();
    return page;
  }

  absl::StatusOr<SessionRecord> FindRequest(absl::string_view tenant, absl::string_view request_id) const override {
    EVPOSE_ASSIGN_OR_RETURN(const auto rows,
                            client().Call({{.statement = &kPostgresFindRequest, .values = {tenant, request_id}}}));
    if (rows[0].size() == 0) return RequestNotFoundError(request_id);
    return DecodeRecord(rows[0].Bytes(0, 0), rows[0].Bytes(0, 1));
  }

  absl::StatusOr<std::vector<SessionOwner>> ListOwners() const override {
    EVPOSE_ASSIGN_OR_RETURN(const auto rows, client().Call({{.statement = &kPostgresListOwners}}));
    std::vector<SessionOwner> owners;
    for (size_t i = 0; i < rows[0].size(); ++i) {
      owners.push_back({.name = rows[0].Bytes(i, 0), .tenant = rows[0].Bytes(i, 1)});
    }
    return owners;
  }

  absl::StatusOr<std::vector<StoredLifecycle>> ReadOldestLifecycles(size_t max_sessions) const override {
    std::vector<StoredLifecycle> lifecycles;
    uint64_t last_write = 0;
    while (lifecycles.size() < max_sessions) {
      EVPOSE_ASSIGN_OR_RETURN(
          const auto rows,
          client().Call({{.statement = &kPostgresOldestLifecycles, .values = {last_write, kSessionsPerStatement}}}));
      for (size_t i = 0; i < rows[0].size() && lifecycles.size() < max_sessions; ++i) {
        std::string name = rows[0].Bytes(i, 0);
        last_write = rows[0].Unsigned(i, 2);
        auto lifecycle = VerifyChecksum(LifecycleOf(name), rows[0].Bytes(i, 1));
        if (lifecycle.ok()) lifecycles.push_back({.name = std::move(name), .lifecycle = *std::move(lifecycle)});
      }
      if (rows[0].size() < kSessionsPerStatement) break;
    }
    return lifecycles;
  }

  absl::Status DeleteSession(absl::string_view name) override {
    std::vector<PostgresCommand> commands = {{.statement = &kPostgresLock, .values = {name}}};
    AddPostgresDeletion(name, commands);
    return client().With(
        [&](PostgresConnection& connection) { return Transact(connection, std::move(commands)).status(); });
  }

  absl::Status DeleteHeldSession(absl::string_view name, const FencingToken& token) override {
    return client().With([&](PostgresConnection& connection) -> absl::Status {
      EVPOSE_ASSIGN_OR_RETURN(const auto rows, connection.Run({{.statement = &kPostgresBegin},
                                                               {.statement = &kPostgresLock, .values = {name}}}));
      const auto stored = ParsePostgresLease(name, rows[1]);
      if (stored.ok()) EVPOSE_RETURN_IF_ERROR(CheckHolder(name, stored->token, token));
      std::vector<PostgresCommand> commands;
      AddPostgresDeletion(name, commands);
      commands.push_back({.statement = &kPostgresCommit});
      return connection.Run(commands).status();
    });
  }

  absl::StatusOr<std::vector<std::string>> DeleteEnded(absl::Time ended_before) override {
    std::vector<std::string> names;
    const absl::Status deleted = client().With([&](PostgresConnection& connection) -> absl::Status {
      size_t before = 0;
      do {
        before = names.size();
        EVPOSE_RETURN_IF_ERROR(
            PostgresClient::DeleteEnded(connection, absl::ToUnixNanos(ended_before), kSessionsPerStatement, names));
      } while (names.size() == before + kSessionsPerStatement);
      return absl::OkStatus();
    });
    // Those that were deleted before an error are returned by the next call.
    client().NoteDeleted(std::move(names));
    EVPOSE_RETURN_IF_ERROR(deleted);
    return client().TakeDeleted();
  }

 private:
  PostgresClient& client() const { return *shared_->client; }

  // Runs commands in a transaction. The result of the first one is at 1, behind that of BEGIN.
  static absl::StatusOr<std::vector<PostgresRows>> Transact(PostgresConnection& connection,
                                                            std::vector<PostgresCommand> commands) {
    commands.insert(commands.begin(), {.statement = &kPostgresBegin});
    commands.push_back({.statement = &kPostgresCommit});
    return connection.Run(commands);
  }

  const PostgresStoreOptions options_;
  const std::shared_ptr<Shared> shared_;
  std::vector<std::string> damage_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Store>> OpenPostgresStore(const PostgresStoreOptions& options) {
  const std::string address = options.client.address.Printable();
  {
    const auto connection = PostgresConnection::Open(options.client.address, options.client.timeout);
    if (absl::IsUnavailable(connection.status())) {
      return absl::UnavailableError(
          absl::StrCat(connection.status().message(), ": start PostgreSQL there, or give --store its address"));
    }
    EVPOSE_RETURN_IF_ERROR(connection.status());
    EVPOSE_RETURN_IF_ERROR(CreatePostgresSchema(**connection, address));
  }
  auto store = std::make_unique<PostgresStore>(options);
  EVPOSE_RETURN_IF_ERROR(store->Check());
  return store;
}

}  // namespace evpose::server
