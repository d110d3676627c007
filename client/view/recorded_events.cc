// SPDX-License-Identifier: Apache-2.0
#include "client/view/recorded_events.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/view/keep_every_second.h"
#include "core/base/state_io.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

constexpr size_t kPieceBytes = size_t{64} * 1024;  // decoded at a time: the new events are published after each
// Bounds the memory. In a bag with more losses the decoder is not reset at the further ones, so that some wrong events
// follow each of them.
constexpr size_t kMaxLosses = 1'000'000;

absl::Status FileError(const std::string& what) {
  return absl::UnavailableError(absl::StrCat(what, ": ", std::strerror(errno)));  // NOLINT(concurrency-mt-unsafe)
}

// Creates a file without a name in the folder for temporary files.
absl::StatusOr<int> TemporaryFile() {
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::temp_directory_path(error);
  std::string name = (error ? std::filesystem::path("/tmp") : folder) / "evpose-view-XXXXXX";
  const int file = mkostemp(name.data(), O_CLOEXEC);
  if (file < 0) return FileError(absl::StrCat(name, ": cannot be created; set TMPDIR to a folder with space"));
  unlink(name.c_str());
  return file;
}

bool IsRegularFile(int file) {
  struct stat facts = {};
  return fstat(file, &facts) == 0 && S_ISREG(facts.st_mode);
}

}  // namespace

absl::StatusOr<std::unique_ptr<RecordedEvents>> RecordedEvents::Open(const std::string& path,
                                                                     std::unique_ptr<RecordingReader> reader,
                                                                     const RecordedEventsOptions& options) {
  const RecordingHeader& header = reader->header();
  EVPOSE_ASSIGN_OR_RETURN(std::unique_ptr<EventDecoder> decoder, MakeEventDecoder(header.encoding, header.geometry));
  // The data of a RAW or DAT file are its bytes after the header.
  int file = path == "-" || !header.container.empty() ? -1 : open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  const bool is_direct = file >= 0 && IsRegularFile(file);
  if (!is_direct) {
    if (file >= 0) close(file);
    EVPOSE_ASSIGN_OR_RETURN(file, TemporaryFile());
  }
  const uint64_t data_offset = is_direct ? header.size_bytes : 0;
  std::unique_ptr<RecordedEvents> events(
      new RecordedEvents(std::move(reader), std::move(decoder), file, data_offset, !is_direct, options));
  events->thread_ = std::jthread([self = events.get()](const std::stop_token& stop) { self->ReadAll(stop); });
  return events;
}

RecordedEvents::RecordedEvents(std::unique_ptr<RecordingReader> reader, std::unique_ptr<EventDecoder> decoder, int file,
                               uint64_t data_offset, bool is_own, const RecordedEventsOptions& options)
    : reader_(std::move(reader)),
      header_(reader_->header()),
      decoder_(std::move(decoder)),
      file_(file),
      data_offset_(data_offset),
      is_own_(is_own),
      max_positions_(options.max_positions),
      spacing_bytes_(options.spacing_bytes) {}

RecordedEvents::~RecordedEvents() {
  thread_ = {};
  close(file_);
}

absl::Status RecordedEvents::Keep(absl::Span<const uint8_t> bytes) const {
  while (is_own_ && !bytes.empty()) {
    const ssize_t written = write(file_, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return FileError("the temporary file of the recording cannot be written; set TMPDIR");
    bytes.remove_prefix(static_cast<size_t>(written));
  }
  return absl::OkStatus();
}

void RecordedEvents::ReadAll(const std::stop_token& stop) {
  std::vector<uint8_t> piece(kPieceBytes);
  DecodedEvents decoded;
  uint64_t offset = 0;
  while (!stop.stop_requested()) {
    const absl::StatusOr<size_t> size = reader_->Read(absl::MakeSpan(piece));
    if (!size.ok() || *size == 0) return Finish(size.status());
    const auto bytes = absl::MakeConstSpan(piece).first(*size);
    if (const absl::Status status = Keep(bytes); !status.ok()) return Finish(status);
    const bool follows_loss = reader_->follows_loss();
    if (follows_loss) decoder_->ResetAfterLoss();
    AddPosition(offset);
    decoded.events.clear();
    decoded.triggers.clear();
    decoded.time_marks.clear();
    decoder_->Decode(bytes, decoded);
    if (follows_loss) AddLoss(offset);
    offset += *size;
    Publish(offset, decoded);
  }
}

void RecordedEvents::AddPosition(uint64_t offset) {
  const std::lock_guard lock(mutex_);
  if (!positions_.empty() && offset - positions_.back().offset < spacing_bytes_) return;
  StateWriter writer;
  decoder_->SaveState(writer);
  const int64_t latest_us = progress_.has_events ? progress_.range.to_us : std::numeric_limits<int64_t>::min();
  positions_.push_back({offset, latest_us, writer.Take()});
  if (positions_.size() <= max_positions_) return;
  KeepEverySecond(positions_);  // the first one stays
  spacing_bytes_ *= 2;
}

void RecordedEvents::AddLoss(uint64_t offset) {
  const std::lock_guard lock(mutex_);
  if (losses_.size() < kMaxLosses) losses_.push_back(offset);
}

void RecordedEvents::Publish(uint64_t read_bytes, const DecodedEvents& decoded) {
  {
    const std::lock_guard lock(mutex_);
    read_bytes_ = read_bytes;
    counts_.Add(decoded.events);
    TimeSpan& range = progress_.range;
    if (!progress_.has_events && !decoded.events.empty()) {
      progress_.has_events = true;
      range = {decoded.events[0].t_us, decoded.events[0].t_us};
    }
    for (const Event& event : decoded.events) {
      range.from_us = std::min(range.from_us, event.t_us);
      range.to_us = std::max(range.to_us, event.t_us);
    }
  }
  const std::lock_guard lock(listeners_mutex_);
  for (const auto& [number, listener] : listeners_) listener();
}

void RecordedEvents::Finish(const absl::Status& status) {
  {
    const std::lock_guard lock(mutex_);
    progress_.is_complete = true;
    progress_.status = status;
  }
  const std::lock_guard lock(listeners_mutex_);
  for (const auto& [number, listener] : listeners_) listener();
}

RecordedEvents::Progress RecordedEvents::progress() const {
  const std::lock_guard lock(mutex_);
  return progress_;
}

EventCounts RecordedEvents::counts() const {
  const std::lock_guard lock(mutex_);
  return counts_;
}

std::shared_ptr<void> RecordedEvents::Subscribe(std::function<void()> on_progress) {
  const std::lock_guard lock(listeners_mutex_);
  const uint64_t number = next_listener_++;
  listeners_[number] = std::move(on_progress);
  return std::shared_ptr<void>(nullptr, [this, number](void*) {
    const std::lock_guard lock_of_end(listeners_mutex_);
    listeners_.erase(number);
  });
}

bool RecordedEvents::HasUntil(int64_t to_us) const {
  const std::lock_guard lock(mutex_);
  return progress_.is_complete || (progress_.has_events && progress_.range.to_us >= to_us);
}

absl::StatusOr<size_t> RecordedEvents::ReadAt(uint64_t offset, absl::Span<uint8_t> buffer) const {
  ssize_t size = -1;
  do {
    size = pread(file_, buffer.data(), buffer.size(), static_cast<off_t>(data_offset_ + offset));
  } while (size < 0 && errno == EINTR);
  if (size < 0) return FileError("the recording cannot be read");
  if (size == 0) return absl::DataLossError("the recording has become shorter while it was shown");
  return static_cast<size_t>(size);
}

absl::Status RecordedEvents::Visit(int64_t from_us, int64_t to_us,
                                   const std::function<void(absl::Span<const Event>)>& visit) const {
  Position position;
  std::vector<uint64_t> losses;
  uint64_t end = 0;
  {
    const std::lock_guard lock(mutex_);
    // The first position has no events before it.
    const auto after = std::lower_bound(positions_.begin(), positions_.end(), from_us,
                                        [](const Position& each, int64_t t_us) { return each.latest_us < t_us; });
    if (positions_.empty()) return absl::OkStatus();
    position = after == positions_.begin() ? positions_.front() : *(after - 1);
    end = read_bytes_;
    losses.assign(std::upper_bound(losses_.begin(), losses_.end(), position.offset), losses_.end());
  }
  EVPOSE_ASSIGN_OR_RETURN(const std::unique_ptr<EventDecoder> decoder,
                          MakeEventDecoder(header_.encoding, header_.geometry));
  StateReader state(position.decoder);
  decoder->LoadState(state);
  EVPOSE_RETURN_IF_ERROR(state.Finish());
  std::vector<uint8_t> piece(kPieceBytes);
  DecodedEvents decoded;
  std::vector<Event> selected;
  auto loss = losses.begin();
  bool is_beyond = false;
  for (uint64_t offset = position.offset; offset < end && !is_beyond;) {
    if (loss != losses.end() && *loss == offset) {
      decoder->ResetAfterLoss();
      ++loss;
    }
    const uint64_t piece_end = std::min<uint64_t>(end, loss == losses.end() ? end : *loss);
    const size_t wanted = std::min<uint64_t>(piece.size(), piece_end - offset);
    EVPOSE_ASSIGN_OR_RETURN(const size_t size, ReadAt(offset, absl::MakeSpan(piece).first(wanted)));
    offset += size;
    decoded = {};
    decoder->Decode(absl::MakeConstSpan(piece).first(size), decoded);
    for (const Event& event : decoded.events) {
      // The rest of the piece may have events whose times step back.
      is_beyond = is_beyond || event.t_us >= to_us;
      if (event.t_us >= from_us && event.t_us < to_us) selected.push_back(event);
    }
    if (!selected.empty()) visit(selected);
    selected.clear();
  }
  return absl::OkStatus();
}

}  // namespace evpose::client
