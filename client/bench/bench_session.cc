// SPDX-License-Identifier: Apache-2.0
#include "client/bench/bench_session.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lib/client_access.h"
#include "client/lib/messages/core_types.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"
#include "core/models/object_model.h"
#include "core/recordings/chunker.h"

namespace evpose::client {
namespace {

// The system clock. Stores the time of its first call; a pacer makes this call at the first time stamp.
class FirstCallClock final : public Clock {
 public:
  absl::Time Now() override {
    const absl::Time now = SystemClock().Now();
    if (!first_) first_ = now;
    return now;
  }
  bool SleepUntil(absl::Time time, std::stop_token stop) override { return SystemClock().SleepUntil(time, stop); }
  absl::Time first() const { return first_.value_or(absl::InfinitePast()); }

 private:
  std::optional<absl::Time> first_;
};

absl::Status CheckSummary(const TrackSummary& summary, uint64_t num_events) {
  if (summary.health.decoded_events != num_events) {
    return absl::InternalError(
        absl::StrCat("the server decoded ", summary.health.decoded_events, " events and not ", num_events));
  }
  if (summary.poses == 0) return absl::InternalError("the server found no pose in the recording");
  return absl::OkStatus();
}

}  // namespace

MemoryReader::MemoryReader(const EncodedRecording& recording, int num_times)
    : recording_(recording), num_times_(num_times) {
  header_.encoding = recording.encoding;
  header_.geometry = recording.geometry;
  header_.geometry_is_stated = header_.geometry_is_known = true;
}

absl::StatusOr<size_t> MemoryReader::Read(absl::Span<uint8_t> buffer) {
  if (begin_ == recording_.bytes->size() && time_ + 1 < num_times_) {
    ++time_;
    begin_ = 0;
  }
  const size_t size = std::min(buffer.size(), recording_.bytes->size() - begin_);
  std::copy_n(recording_.bytes->data() + begin_, size, buffer.data());
  begin_ += size;
  return size;
}

absl::StatusOr<SessionConfig> UploadSession(Client& client, const SpeedRecording& recording, Encoding encoding) {
  const std::string obj = ObjectModelToObj(*recording.model);
  const absl::Span<const uint8_t> bytes = AsBytes(obj);
  EVPOSE_ASSIGN_OR_RETURN(const ModelInfo model, client.UploadModel(bytes, {}));
  SessionConfig config;
  config.encoding = FromCore(encoding);
  config.camera = FromCore(recording.camera);
  config.objects.push_back(
      {.model = model.name, .initial_camera_from_object = FromCore(recording.initial_camera_from_object)});
  return config;
}

absl::StatusOr<std::unique_ptr<BenchSession>> BenchSession::Create(Client& client, const SessionConfig& config) {
  EVPOSE_ASSIGN_OR_RETURN(Session session,
                          client.CreateSession(config, /*request_id=*/"", /*max_wait=*/absl::ZeroDuration()));
  return std::unique_ptr<BenchSession>(new BenchSession(client, std::move(session)));
}

// An unreachable server has been reported by Stream() already.
BenchSession::~BenchSession() { client_.DeleteSession(session_.name).IgnoreError(); }

absl::StatusOr<StreamTimes> BenchSession::Stream(const EncodedRecording& recording, uint64_t num_events, double rate,
                                                 const std::function<bool()>& is_cancelled) {
  MemoryReader reader(recording);
  Chunker chunker(reader, ChunkerOptions());
  StreamTimes times;
  const auto next_chunk = [&]() -> absl::StatusOr<EventChunk> {
    if (is_cancelled()) return absl::CancelledError("interrupted");
    absl::StatusOr<EventChunk> chunk = FromCore(chunker.Next());
    if (chunk.ok() && !chunk->bytes.empty()) times.chunk_ends_us.push_back(chunk->t_last_us);
    return chunk;
  };
  FirstCallClock clock;
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventFeed> feed,
                          EventFeed::Open(next_chunk, {.rate = rate, .clock = &clock}));
  TrackCallbacks callbacks;
  callbacks.on_pose = [&times](const Pose& pose) {
    times.poses.push_back({pose.t_us, SystemClock().Now(), pose.latency});
  };
  const TrackPosition position = {.session = session_.name, .resume_token = session_.resume_token};
  TrackOptions track_options;
  track_options.retry.max_outage = absl::ZeroDuration();
  times.begin = SystemClock().Now();
  EVPOSE_ASSIGN_OR_RETURN(const TrackSummary summary,
                          ClientAccess::Track(client_, position, *feed, callbacks, track_options));
  if (rate > 0.0) times.begin = clock.first();
  times.end = SystemClock().Now();
  EVPOSE_RETURN_IF_ERROR(CheckSummary(summary, num_events));
  return times;
}

}  // namespace evpose::client
