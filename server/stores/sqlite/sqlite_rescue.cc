// SPDX-License-Identifier: Apache-2.0
#include "server/stores/sqlite/sqlite_rescue.h"

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"

namespace evpose::server {
namespace {

// Collects the keys of a table with several queries: in both directions and by table and index, so that a damaged page
// hides fewer rows. Returns false when a query fails or the results differ.
template <typename Key, typename ReadKey>
bool CollectKeys(SqliteDatabase& database, const std::vector<std::string>& lists, const ReadKey& read_key,
                 std::set<Key>& keys) {
  bool is_whole = true;
  std::set<size_t> sizes;
  for (const std::string& list : lists) {
    SqliteQuery query = database.Query(list);
    std::set<Key> found;
    while (query.Next()) found.insert(read_key(query));
    is_whole = is_whole && query.status().ok();
    sizes.insert(found.size());
    keys.merge(found);
  }
  sizes.insert(keys.size());
  return is_whole && sizes.size() == 1;
}

std::string FirstText(SqliteQuery& query) { return query.TextAt(0); }

// Names in a damaged file may be arbitrary bytes; control characters are escaped.
std::string Printable(absl::string_view name) { return absl::CHexEscape(name); }

std::string Why(const absl::Status& status) {
  return absl::IsNotFound(status) ? "its record is missing" : std::string(status.message());
}

void CheckStructure(SqliteDatabase& database, SqliteContents& contents) {
  SqliteQuery query = database.Query("PRAGMA quick_check(1)");
  const std::string words = query.Next() ? query.TextAt(0) : std::string(query.status().message());
  if (words != "ok") contents.damage.push_back(absl::StrCat("the structure of ", database.path(), ": ", words));
}

void CheckFencing(SqliteDatabase& database, SqliteContents& contents) {
  const auto last = SqliteLastFencingNumber(database);
  if (last.ok()) {
    contents.last_fencing_number = *last;
  } else {
    contents.damage.push_back(absl::StrCat("the last fencing number: ", last.status().message()));
  }
}

void CheckModels(SqliteDatabase& database, SqliteContents& contents) {
  std::set<SqliteModelKey> keys;
  const bool is_whole = CollectKeys(
      database,
      {"SELECT name, tenant FROM models NOT INDEXED ORDER BY rowid",
       "SELECT name, tenant FROM models NOT INDEXED ORDER BY rowid DESC",
       "SELECT name, tenant FROM models ORDER BY name, tenant",
       "SELECT name, tenant FROM models ORDER BY name DESC, tenant DESC"},
      [](SqliteQuery& query) { return SqliteModelKey{.tenant = query.TextAt(1), .name = query.TextAt(0)}; }, keys);
  if (!is_whole)
    contents.damage.push_back(absl::StrCat("the list of models in ", database.path(), ": some may be missing"));
  for (const SqliteModelKey& key : keys) {
    const auto model = SqliteReadModel(database, key.tenant, key.name);
    if (model.ok()) {
      contents.models.push_back(key);
    } else {
      contents.damage.push_back(absl::StrCat("model ", Printable(key.name), ": ", Why(model.status())));
    }
  }
}

// A file of schema 1 that was too damaged to be upgraded has none.
bool HasIndexes(SqliteDatabase& database) {
  return database.Query("SELECT 1 FROM pragma_table_info('sessions') WHERE name = 'tenant'").Next();
}

// Returns whether the columns for the indexes have the values of the record. A rescued file gets them from the record.
bool MatchesIndexColumns(SqliteDatabase& database, const SessionRecord& record) {
  SqliteQuery query = database.Query("SELECT tenant, request_id FROM sessions WHERE name = ?");
  query.Text(record.name);
  return query.Next() && query.TextAt(0) == record.tenant && query.TextAt(1) == record.request_id;
}

void CheckSessions(SqliteDatabase& database, SqliteContents& contents) {
  std::vector<std::string> lists = {"SELECT name FROM sessions NOT INDEXED ORDER BY rowid",
                                    "SELECT name FROM sessions NOT INDEXED ORDER BY rowid DESC",
                                    "SELECT name FROM sessions ORDER BY name",
                                    "SELECT name FROM sessions ORDER BY name DESC"};
  const bool has_indexes = HasIndexes(database);
  if (has_indexes) {
    lists.emplace_back("SELECT name FROM sessions INDEXED BY sessions_of_tenant");
    lists.emplace_back("SELECT name FROM sessions INDEXED BY sessions_by_lifecycle_write ORDER BY lifecycle_write");
  }
  std::set<std::string> names;
  const bool is_whole = CollectKeys(database, lists, FirstText, names);
  if (!is_whole) {
    contents.damage.push_back(absl::StrCat("the list of sessions in ", database.path(), ": some may be missing"));
  }
  // The name of a session with a lost record may still be found in the tables of checkpoints and poses.
  CollectKeys(database, {"SELECT session FROM checkpoints", "SELECT session FROM checkpoints ORDER BY session DESC"},
              FirstText, names);
  CollectKeys(database,
              {"SELECT DISTINCT session FROM poses", "SELECT DISTINCT session FROM poses ORDER BY session DESC"},
              FirstText, names);
  for (const std::string& name : names) {
    const auto session = SqliteReadSession(database, name, /*after_pose_seq=*/0);
    if (session.ok()) {
      contents.sessions.push_back(name);
      if (has_indexes && !MatchesIndexColumns(database, session->stored.record)) {
        contents.damage.push_back(absl::StrCat("the index of session ", Printable(name), ": was made again"));
      }
      contents.last_fencing_number = std::max(contents.last_fencing_number, session->state.fencing_number);
    } else {
      contents.damaged_sessions.insert(name);
      contents.damage.push_back(absl::StrCat("session ", Printable(name), ": ", Why(session.status())));
    }
  }
}

absl::Status CopySession(SqliteDatabase& from, const std::string& name, SqliteDatabase& to) {
  EVPOSE_ASSIGN_OR_RETURN(SqliteSession session, SqliteReadSession(from, name, /*after_pose_seq=*/0));
  EVPOSE_RETURN_IF_ERROR(SqliteInsertSession(to, session.stored.record, session.stored.lifecycle, session.state));
  SessionCommit parts;
  if (session.state.checkpoint_checksum != 0) parts.checkpoint = std::move(session.stored.checkpoint);
  parts.poses = std::move(session.stored.poses);
  SqliteSessionState state = session.state;
  return SqliteWriteParts(to, name, parts, state.next_pose_seq, state);
}

}  // namespace

SqliteContents CheckSqliteContents(SqliteDatabase& database) {
  SqliteContents contents;
  CheckStructure(database, contents);
  CheckFencing(database, contents);
  CheckModels(database, contents);
  CheckSessions(database, contents);
  return contents;
}

absl::Status CopySqliteContents(SqliteDatabase& from, const SqliteContents& contents, SqliteDatabase& to) {
  EVPOSE_RETURN_IF_ERROR(to.Execute("BEGIN IMMEDIATE"));
  EVPOSE_RETURN_IF_ERROR(SqliteSetLastFencingNumber(to, contents.last_fencing_number));
  for (const SqliteModelKey& key : contents.models) {
    EVPOSE_ASSIGN_OR_RETURN(const ModelRecord model, SqliteReadModel(from, key.tenant, key.name));
    EVPOSE_RETURN_IF_ERROR(SqlitePutModel(to, model));
  }
  for (const std::string& name : contents.sessions) EVPOSE_RETURN_IF_ERROR(CopySession(from, name, to));
  return to.Execute("COMMIT");
}

}  // namespace evpose::server
