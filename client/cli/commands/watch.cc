// SPDX-License-Identifier: Apache-2.0

// evpose watch: the poses of a session as they come.
#include <map>
#include <mutex>
#include <string>
#include <thread>

#include "client/cli/commands/commands.h"
#include "client/cli/common/pose_format.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr absl::Duration kHealthPeriod = absl::Seconds(1);

struct WatchArguments {
  std::string session;
  ServerArguments server;
  uint64_t after_pose_seq = 0;
  bool is_json = false;
};

// Says on standard error how the objects are, when that changes: while there is no pose, why. Thread-safe.
class StateLines {
 public:
  explicit StateLines(std::ostream& err) : err_(err) {}

  void Show(const SessionHealth& health) {
    const std::lock_guard lock(mutex_);
    for (const ObjectHealth& object : health.objects) {
      std::string& shown = shown_[object.object_id];
      const std::string text = DescribeState(object);
      if (text == shown) continue;
      shown = text;
      err_ << object.object_id << ": " << text << (object.detail.empty() ? "" : ": ") << object.detail << std::endl;
    }
  }
  void Skipped(uint64_t num_skipped) {
    const std::lock_guard lock(mutex_);
    err_ << "skipped " << num_skipped << " poses: too slow, or no longer stored" << std::endl;
  }

 private:
  std::mutex mutex_;
  std::ostream& err_;
  std::map<std::string, std::string> shown_;
};

absl::Status RunWatch(const WatchArguments& arguments, CliContext& context) {
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<Client> client, arguments.server.Connect(context));
  const PoseFormat format = arguments.is_json ? PoseFormat::kJsonLines : PoseFormat::kTum;
  StateLines states(context.err);
  std::stop_source stop;
  const auto on_poses = [&](const std::vector<Pose>& poses, uint64_t num_skipped) {
    if (num_skipped > 0) states.Skipped(num_skipped);
    for (const Pose& pose : poses) context.out << PoseLine(format, pose);
    context.out.flush();
    if (!context.out) stop.request_stop();  // nobody gets what comes
  };
  EVPOSE_ASSIGN_OR_RETURN(const Session session, client->GetSession(arguments.session));
  states.Show(session.health);
  std::jthread interrupts([&](std::stop_token ended) {
    absl::Time shown_at = SystemClock().Now();
    while (!context.IsInterrupted()) {
      if (!SystemClock().SleepUntil(SystemClock().Now() + kInterruptPeriod, ended)) return;
      if (SystemClock().Now() - shown_at < kHealthPeriod) continue;
      // A session that is gone ends the stream of poses, too.
      if (const absl::StatusOr<Session> now = client->GetSession(arguments.session); now.ok()) states.Show(now->health);
      shown_at = SystemClock().Now();
    }
    stop.request_stop();
  });
  const absl::Status status =
      client->WatchPoses(arguments.session, arguments.after_pose_seq, on_poses, stop.get_token());
  interrupts.request_stop();
  return stop.stop_requested() ? absl::OkStatus() : status;
}

}  // namespace

CommandRunner AddWatchCommand(CLI::App& app, CliContext& context) {
  auto arguments = std::make_shared<WatchArguments>();
  app.add_option("session", arguments->session, "sessions/ID, as `evpose sessions list` prints it")->required();
  app.add_option("--after", arguments->after_pose_seq, "Number of the pose after which the output begins")
      ->capture_default_str();
  arguments->server.AddTo(app, true);
  app.add_flag("--json", arguments->is_json, "One JSON object on each line, instead of TUM");
  app.footer(
      "Prints the stored poses and then the live ones until the session ends or until an interrupt. Changes of the\n"
      "objects' states are printed on standard error.\n\n"
      "Example:\n"
      "  evpose watch \"$(evpose sessions list --server 127.0.0.1:50051 | head -n 1 | cut -d ' ' -f 1)\" \\\n"
      "    --server 127.0.0.1:50051");
  return [arguments, &context] { return RunWatch(*arguments, context); };
}

}  // namespace evpose::client
