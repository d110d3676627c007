// SPDX-License-Identifier: Apache-2.0
#include "client/lib/stream/reconnecting_stream.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/messages/conversion.h"
#include "client/lib/messages/status_details.h"
#include "core/base/status_macros.h"
#include "core/base/trace_context.h"

namespace evpose::client {
namespace {

// Attempts after which a damaged chunk is regarded as damaged at its source, not by the link, which hardly damages the
// same chunk each time.
constexpr size_t kMaxDamagedTries = 5;
constexpr size_t kMaxOlderTokens = kMaxTriedTokens - 2;  // beside the current one and the previous one

}  // namespace

std::string TraceId(const std::string& session) { return TraceIdOf(session); }

absl::Status TrackOptions::Validate() const {
  if (!(rate >= 0.0) || rate > 1e6) return absl::InvalidArgumentError("rate must lie in [0, 1e6]");
  EVPOSE_RETURN_IF_ERROR(retain.Validate());
  if (attach_timeout <= absl::ZeroDuration()) return absl::InvalidArgumentError("attach_timeout must be positive");
  return retry.Validate();
}

ReconnectingStream::ReconnectingStream(const std::vector<StreamServer>& servers, std::atomic<size_t>& current,
                                       bool outlives_server, const TrackPosition& position, EventFeed& feed,
                                       const TrackCallbacks& callbacks, const TrackOptions& options)
    : servers_(servers),
      current_(current),
      index_(current),
      outlives_server_(outlives_server),
      position_(position),
      feed_(feed),
      callbacks_(callbacks),
      options_(options),
      backoff_(options.retry) {}

absl::StatusOr<TrackSummary> ReconnectingStream::Run() {
  while (true) {
    const AttemptOutcome outcome = RunOnce();
    Observe(outcome);
    if (outcome.summary && outcome.status.ok()) {
      const FeedPoint last = feed_.outbox().state().last;
      return TrackSummary{.health = *outcome.summary,
                          .sent_bytes = last.bytes,
                          .sent_chunks = last.seq,
                          .poses = position_.last_pose_seq - position_.lost_poses,
                          .lost_poses = position_.lost_poses,
                          .trace = trace_};
    }
    // The next attempt tells the server, and by it all readers, that the session has ended.
    const bool must_report_loss = ReasonOf(outcome.status) == v1::ROLLED_BACK && !outcome.stated_first_seq;
    if (outcome.is_final && must_report_loss && !options_.stop.stop_requested()) continue;
    if (outcome.is_final) return WithProgress(outcome.status);
    if (options_.stop.stop_requested()) return WithProgress(absl::CancelledError("cancelled"));
    if (!Plan(outcome)) return WithProgress(outcome.status);
    if (!WaitForNextTry(outcome.status)) {
      const bool is_stopped = options_.stop.stop_requested();
      return WithProgress(is_stopped ? absl::CancelledError("cancelled") : outcome.status);
    }
  }
}

std::vector<std::string> ReconnectingStream::Tokens() const {
  std::vector<std::string> tokens = {position_.resume_token};
  if (!position_.previous_token.empty()) tokens.push_back(position_.previous_token);
  tokens.insert(tokens.end(), older_tokens_.begin(), older_tokens_.end());
  return tokens;
}

AttemptOutcome ReconnectingStream::RunOnce() {
  const std::vector<std::string> tokens = Tokens();
  trace_ = {TraceIdOf(position_.session), NewSpanId()};
  const AttemptOptions attempt_options = {.resume_token = tokens[token_age_],
                                          .attach_after_pose = attaches_from_first_pose_ ? 0 : position_.last_pose_seq,
                                          .leaves_on_go_away = options_.retry.max_outage > absl::ZeroDuration() &&
                                                               (outlives_server_ || servers_.size() > 1),
                                          .trace = trace_};
  TrackCallbacks callbacks = callbacks_;
  callbacks.on_position = [this](const TrackPosition& position, bool has_new_token) {
    if (has_new_token) ReportAttached();
    return callbacks_.on_position ? callbacks_.on_position(position, has_new_token) : absl::OkStatus();
  };
  const StreamServer::Stub stub = server().connect();
  if (server().auth_token) auth_token_ = server().auth_token();
  StreamAttempt attempt(*stub, position_, feed_, callbacks, options_, attempt_options);
  AttemptOutcome outcome = attempt.Run();
  fed_bytes_ = std::max(fed_bytes_, attempt.fed_bytes());
  if (outcome.was_attached) {
    token_age_ = 0;
    attaches_from_first_pose_ = false;
    older_tokens_.assign(tokens.begin(), tokens.end());
    std::erase_if(older_tokens_, [this](const std::string& token) {
      return token == position_.resume_token || token == position_.previous_token;
    });
    if (older_tokens_.size() > kMaxOlderTokens) older_tokens_.resize(kMaxOlderTokens);
  }
  return outcome;
}

void ReconnectingStream::Observe(const AttemptOutcome& outcome) {
  const absl::Time now = clock().Now();
  if (absl::IsResourceExhausted(outcome.status) && !outcome.was_attached) server().note_refusal();
  // The outage began at the end of the last stream that made progress.
  const bool has_lasted = outcome.was_attached && now - attached_at_ >= options_.retry.max_delay;
  if (outcome.made_progress || has_lasted) {
    backoff_.Reset();
    damaged_tries_ = 0;
    away_since_.reset();
  }
  if (outcome.was_attached) num_servers_without_session_ = 0;
  if (away_since_) return;
  away_since_ = now;
  tries_ = 0;
}

bool ReconnectingStream::Plan(const AttemptOutcome& outcome) {
  if (outcome.status.ok() || options_.retry.max_outage == absl::ZeroDuration()) return outcome.status.ok();
  switch (AdviseOn(outcome.status)) {
    case RetryAdvice::kTryAgain:
      num_servers_without_session_ = 0;
      if (outcome.status.code() == absl::StatusCode::kDataLoss) return ++damaged_tries_ < kMaxDamagedTries;
      return true;
    case RetryAdvice::kTryOtherServer:
      return ++num_servers_without_session_ < servers_.size();
    case RetryAdvice::kTryOtherToken:
      return ++token_age_ < Tokens().size();
    case RetryAdvice::kTryOtherAuthToken:
      return server().auth_token && server().auth_token() != auth_token_;
    case RetryAdvice::kAttachFromFirstPose:
      if (attaches_from_first_pose_) return false;
      return attaches_from_first_pose_ = true;
    case RetryAdvice::kGiveUp:
      return false;
  }
  return false;
}

bool ReconnectingStream::WaitForNextTry(const absl::Status& cause) {
  const absl::Time now = clock().Now();
  const bool is_same_server = token_age_ > 0 || attaches_from_first_pose_;
  // Each server is tried once without delay. A server that shuts down may be back soon.
  const bool is_at_once = is_same_server || tries_ + 1 < servers_.size() || (cause.ok() && tries_ == 0);
  const absl::Duration delay =
      is_at_once ? absl::ZeroDuration() : std::max(backoff_.Next(), GetDetails(cause).retry_in);
  if (now + delay - *away_since_ > options_.retry.max_outage) return false;
  ++tries_;
  if (!is_same_server) index_ = (index_ + 1) % servers_.size();
  Report({.is_unreachable = true,
          .server = server().name,
          .cause = cause,
          .outage = now - *away_since_,
          .next_try_in = delay,
          .trace = {}});
  return clock().SleepUntil(now + delay, options_.stop.get_token());
}

void ReconnectingStream::ReportAttached() {
  current_ = index_;
  attached_at_ = clock().Now();
  if (!away_since_) return;
  Report({.is_unreachable = false,
          .server = server().name,
          .cause = absl::OkStatus(),
          .outage = clock().Now() - *away_since_,
          .next_try_in = absl::ZeroDuration(),
          .trace = {}});
}

void ReconnectingStream::Report(ConnectionChange change) const {
  if (!callbacks_.on_connection) return;
  const OutboxState state = feed_.outbox().state();
  change.kept_bytes = state.kept_bytes;
  change.source_waits = state.is_waiting;
  change.trace = trace_;
  callbacks_.on_connection(change);
}

absl::Status ReconnectingStream::WithProgress(const absl::Status& status) const {
  const uint64_t poses = position_.last_pose_seq - position_.lost_poses;
  std::string text = absl::StrCat(server().name, ": ", status.message(), " (after ", fed_bytes_, " bytes sent, ", poses,
                                  " poses received)");
  if (tries_ > 0) {
    absl::StrAppend(&text, "; gave up after ", tries_, " more tries in ",
                    absl::FormatDuration(absl::Trunc(clock().Now() - *away_since_, absl::Milliseconds(100))));
  }
  absl::StrAppend(&text, "; trace_id=", trace_.trace_id, " span_id=", trace_.span_id);
  return WithMessage(status, text);
}

}  // namespace evpose::client
