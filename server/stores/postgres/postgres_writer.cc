// SPDX-License-Identifier: Apache-2.0
#include "server/stores/postgres/postgres_writer.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "absl/strings/str_cat.h"
#include "core/base/status_macros.h"
#include "server/stores/common/commit_guard.h"
#include "server/stores/common/job_groups.h"

namespace evpose::server {

PostgresWriter::PostgresWriter(std::shared_ptr<PostgresClient> client)
    : client_(std::move(client)), thread_([this](std::vector<Job> jobs) { Process(std::move(jobs)); }) {}

void PostgresWriter::Push(PostgresCommit commit, SessionLease::Done done) {
  Job job;
  job.commit = std::make_unique<const PostgresCommit>(std::move(commit));
  job.done = std::move(done);
  thread_.Push(std::move(job));
}

void PostgresWriter::Refuse(absl::Status status, SessionLease::Done done) {
  thread_.Push({.commit = nullptr, .refusal = std::move(status), .done = std::move(done)});
}

void PostgresWriter::Close() {
  thread_.Close();
  connection_.reset();
}

void PostgresWriter::Process(std::vector<Job> jobs) {
  const auto refused =
      std::stable_partition(jobs.begin(), jobs.end(), [](const Job& job) { return job.commit != nullptr; });
  for (auto job = refused; job != jobs.end(); ++job) job->done(std::move(job->refusal));
  jobs.erase(refused, jobs.end());
  ForEachGroup(
      jobs, [](const Job& job) { return job.commit->size_bytes; },
      [this](absl::Span<Job> group) { ProcessGroup(group); });
}

void PostgresWriter::ProcessGroup(absl::Span<Job> group) {
  // The same order in all servers, so that two that lock the same sessions do not wait for each other.
  std::sort(group.begin(), group.end(),
            [](const Job& a, const Job& b) { return a.commit->session < b.commit->session; });
  Outcomes outcomes(group.size());
  bool is_unknown = false;
  absl::Status status = WriteTogether(group, outcomes, is_unknown);
  if (!status.ok()) {
    for (size_t i = 0; i < group.size(); ++i) {
      if (group.size() > 1 && !is_unknown) {
        Outcomes alone(1);
        status = WriteTogether(group.subspan(i, 1), alone, is_unknown);
        if (status.ok()) status = alone[0];
      }
      outcomes[i] = status;
    }
  }
  for (size_t i = 0; i < group.size(); ++i) group[i].done(std::move(outcomes[i]));
}

absl::Status PostgresWriter::WriteTogether(absl::Span<Job> group, Outcomes& outcomes, bool& is_unknown) {
  is_unknown = true;
  EVPOSE_RETURN_IF_ERROR(Connect());
  bool is_complete = false;
  absl::Status status = OrUnavailable([&] {
    absl::Status transacted = Transact(group, outcomes);
    is_complete = true;
    return transacted;
  });
  if (!is_complete || connection_->broken()) {
    // Without memory, results may still arrive.
    client_->Discard(std::exchange(connection_, nullptr));
    return status;
  }
  is_unknown = !status.ok() && connection_->has_warned();
  connection_->RollBack();
  return status;
}

absl::Status PostgresWriter::Connect() {
  if (connection_ != nullptr && !connection_->IsAlive()) client_->Discard(std::exchange(connection_, nullptr));
  if (connection_ != nullptr) return absl::OkStatus();
  EVPOSE_ASSIGN_OR_RETURN(connection_, client_->Connect());
  return absl::OkStatus();
}

absl::Status PostgresWriter::Transact(absl::Span<Job> group, Outcomes& outcomes) {
  uint64_t bytes = 0;
  std::vector<PostgresCommand> locks = {{.statement = &kPostgresBegin}};
  for (const Job& job : group) {
    bytes += job.commit->size_bytes;
    locks.push_back({.statement = &kPostgresLock, .values = {job.commit->session}});
  }
  EVPOSE_RETURN_IF_ERROR(client_->MakeRoom(*connection_, bytes));
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<PostgresRows> rows, connection_->Run(locks));
  std::vector<PostgresCommand> writes;
  for (size_t i = 0; i < group.size(); ++i) {
    const PostgresCommit& commit = *group[i].commit;
    const auto stored = ParsePostgresLease(commit.session, rows[i + 1]);
    outcomes[i] = stored.ok() ? CheckPostgresCommit(commit, *stored) : stored.status();
    if (outcomes[i].ok()) AddPostgresCommit(commit, *stored, writes);
  }
  writes.push_back({.statement = &kPostgresCommit});
  EVPOSE_ASSIGN_OR_RETURN(const std::vector<PostgresRows> written, connection_->Run(writes));
  if (written.back().tag() == "COMMIT") return absl::OkStatus();
  return absl::UnavailableError(absl::StrCat(client_->options().address.Printable(), " has rolled back the commits"));
}

}  // namespace evpose::server
