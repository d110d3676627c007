// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/session_progress.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/common/command.h"
#include "client/cli/common/pace_meter.h"

namespace evpose::client {
namespace {

// Short enough for a live display; each poll is a call to the server.
constexpr absl::Duration kPeriod = absl::Milliseconds(250);

// Counts decrease when a server continues from a checkpoint.
double Gain(uint64_t now, uint64_t before) { return now > before ? static_cast<double>(now - before) : 0.0; }

// Describes the rates between two polls. What matters less is at the end, which a narrow terminal does not show.
std::string Describe(const SessionHealth& now, const SessionHealth& before, absl::Duration elapsed,
                     const std::string& pace) {
  const double seconds = absl::ToDoubleSeconds(elapsed);
  std::string text = absl::StrFormat("%d poses", now.poses);
  for (const ObjectHealth& object : now.objects) absl::StrAppend(&text, "  ", DescribeState(object));
  if (!pace.empty()) absl::StrAppend(&text, "  ", pace);
  absl::StrAppendFormat(&text, "  %.0f poses/s  %.2f Mev/s", Gain(now.poses, before.poses) / seconds,
                        Gain(now.decoded_events, before.decoded_events) * 1e-6 / seconds);
  return text;
}

}  // namespace

SessionProgress::SessionProgress(CliContext& context, Client& client, const std::string& session, int64_t total_bytes,
                                 bool is_shown)
    : context_(context), client_(client), session_(session), total_bytes_(total_bytes), line_(context) {
  if (is_shown) thread_ = std::jthread([this](std::stop_token stop) { Run(stop); });
}

void SessionProgress::Update(const TrackProgress& progress) {
  std::lock_guard lock(mutex_);
  progress_ = progress;
}

void SessionProgress::PrintLine(const std::string& text) {
  std::lock_guard lock(mutex_);
  line_.Clear();
  context_.err << text << std::endl;
}

void SessionProgress::Stop() {
  thread_.request_stop();
  if (thread_.joinable()) thread_.join();
  line_.Clear();
}

void SessionProgress::Run(std::stop_token stop) {
  SessionHealth before;
  PaceMeter pace;
  absl::Time before_time = SystemClock().Now();
  while (SystemClock().SleepUntil(before_time + kPeriod, stop)) {
    const absl::StatusOr<Session> session = client_.GetSession(session_, stop);
    const absl::Time now = SystemClock().Now();
    if (session.ok()) {
      std::lock_guard lock(mutex_);
      const auto sent_bytes = static_cast<double>(progress_.sent_bytes);
      const double ratio = total_bytes_ > 0 ? sent_bytes / static_cast<double>(total_bytes_) : -1.0;
      const std::string share =
          ratio < 0.0 ? absl::StrFormat("%.1f MB", sent_bytes * 1e-6) : absl::StrFormat("%3.0f %%", 100.0 * ratio);
      line_.Show(ratio,
                 absl::StrCat(share, "  ",
                              Describe(session->health, before, now - before_time, pace.Update(session->health))));
      before = session->health;
    }
    before_time = now;
  }
}

}  // namespace evpose::client
