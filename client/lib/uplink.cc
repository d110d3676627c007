#include "client/lib/uplink.h"

#include <algorithm>
#include <utility>

#include "core/base/hash.h"

namespace evpose::client {
namespace {

// Whole words of every encoding.
constexpr size_t kWordBytes = 8;

}  // namespace

Uplink::Uplink(Stream& stream, const ChunkSource& source, const TrackOptions& options, std::function<void()> cancel)
    : stream_(stream),
      source_(source),
      options_(options),
      cancel_(std::move(cancel)),
      pacer_(options.clock == nullptr ? SystemClock() : *options.clock, options.rate) {}

Uplink::~Uplink() { Stop(); }

void Uplink::Start(uint64_t next_seq, uint64_t send_limit_bytes, uint32_t max_chunk_bytes) {
  GrantCredit(send_limit_bytes);
  // A chunk larger than the whole window would wait for ever.
  const size_t max_piece_bytes = std::min<uint64_t>(send_limit_bytes, max_chunk_bytes) / kWordBytes * kWordBytes;
  if (max_piece_bytes == 0) {
    status_ = absl::InternalError("the server gives no room for a single word");
    cancel_();
    return;
  }
  thread_ = std::jthread([this, next_seq, max_piece_bytes] { Run(next_seq, max_piece_bytes); });
}

void Uplink::GrantCredit(uint64_t send_limit_bytes) {
  {
    std::lock_guard lock(mutex_);
    send_limit_bytes_ = std::max(send_limit_bytes_, send_limit_bytes);
  }
  credit_changed_.notify_all();
}

void Uplink::Stop() {
  stop_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void Uplink::Run(uint64_t next_seq, size_t max_piece_bytes) {
  while (true) {
    absl::StatusOr<EventChunkBytes> chunk = source_();
    if (stop_.stop_requested()) return;
    if (!chunk.ok()) {
      status_ = std::move(chunk).status();
      cancel_();
      return;
    }
    if (chunk->bytes.empty()) break;
    if (!pacer_.Wait(chunk->t_last_us, stop_.get_token())) return;
    if (!SendChunk(*chunk, max_piece_bytes, next_seq)) return;
  }
  v1::TrackRequest request;
  request.mutable_end();
  if (stream_.Write(request)) stream_.WritesDone();
}

bool Uplink::SendChunk(const EventChunkBytes& chunk, size_t max_piece_bytes, uint64_t& next_seq) {
  for (size_t begin = 0; begin < chunk.bytes.size(); begin += max_piece_bytes) {
    const size_t size = std::min(max_piece_bytes, chunk.bytes.size() - begin);
    if (!WaitForCredit(size)) return false;
    v1::TrackRequest request;
    v1::EventChunk& events = *request.mutable_events();
    events.set_seq(next_seq++);
    events.set_payload(chunk.bytes.data() + begin, size);
    if (options_.has_checksum) events.set_crc32c(Crc32c({chunk.bytes.data() + begin, size}));
    if (!stream_.Write(request)) return false;  // the stream is over; its status says why
    sent_bytes_ += size;
    ++sent_chunks_;
  }
  return true;
}

bool Uplink::WaitForCredit(size_t size) {
  std::unique_lock lock(mutex_);
  return credit_changed_.wait(lock, stop_.get_token(),
                              [this, size] { return sent_bytes_ + size <= send_limit_bytes_; });
}

}  // namespace evpose::client
