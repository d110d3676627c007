#include "client/cli/session_progress.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/command.h"

namespace evpose::client {
namespace {

constexpr absl::Duration kPeriod = absl::Milliseconds(250);

// Rates over the time between two looks.
std::string Describe(const SessionHealth& now, const SessionHealth& before, absl::Duration elapsed) {
  const double seconds = absl::ToDoubleSeconds(elapsed);
  std::string text = absl::StrFormat("%.2f Mev/s  %.0f poses/s",
                                     static_cast<double>(now.decoded_events - before.decoded_events) * 1e-6 / seconds,
                                     static_cast<double>(now.poses - before.poses) / seconds);
  for (const ObjectHealth& object : now.objects) absl::StrAppend(&text, "  ", DescribeState(object));
  return text;
}

}  // namespace

SessionProgress::SessionProgress(CliContext& context, Client& client, const std::string& session, int64_t total_bytes,
                                 bool is_shown)
    : context_(context), client_(client), session_(session), total_bytes_(total_bytes) {
  if (is_shown) thread_ = std::jthread([this](std::stop_token stop) { Run(stop); });
}

void SessionProgress::Update(const TrackProgress& progress) {
  std::lock_guard lock(mutex_);
  progress_ = progress;
}

void SessionProgress::Stop() {
  thread_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void SessionProgress::Run(std::stop_token stop) {
  ProgressLine line(context_);
  SessionHealth before;
  absl::Time before_time = SystemClock().Now();
  while (SystemClock().SleepUntil(before_time + kPeriod, stop)) {
    const absl::StatusOr<Session> session = client_.GetSession(session_);
    const absl::Time now = SystemClock().Now();
    uint64_t sent_bytes = 0;
    {
      std::lock_guard lock(mutex_);
      sent_bytes = progress_.sent_bytes;
    }
    if (session.ok()) {
      const double ratio =
          total_bytes_ > 0 ? static_cast<double>(sent_bytes) / static_cast<double>(total_bytes_) : -1.0;
      const std::string share = ratio < 0.0 ? absl::StrFormat("%.1f MB", static_cast<double>(sent_bytes) * 1e-6)
                                            : absl::StrFormat("%3.0f %%", 100.0 * ratio);
      line.Show(ratio, absl::StrCat(share, "  ", Describe(session->health, before, now - before_time)));
      before = session->health;
    }
    before_time = now;
  }
}

}  // namespace evpose::client
