// SPDX-License-Identifier: Apache-2.0
#include "client/containers/hdf5/ecf_codec.h"

#include <algorithm>
#include <array>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "core/base/byte_order.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Bits of the first word of a chunk, below the number of events.
constexpr uint32_t kPackedXp = 1;
constexpr uint32_t kPackedYxp = 2;
constexpr int kLayoutBits = 2;

constexpr int kTimeRunBits = 4;
constexpr int kRowRunBits = 5;
constexpr int kPolarityRunBits = 7;
// Value in place of a time step: the low half of the byte has four bits of a step of 15 us or more.
constexpr unsigned kLongTime = 15;
constexpr int kColumns = 5;  // columns after the first; a mask states which of them have events

// The value of a run whose length does not fit and is in the next 16 bits.
constexpr unsigned LongRun(int run_bits) { return (1u << run_bits) - 1; }

// Reads numbers from the front. Beyond the end all numbers are 0 and is_complete() is false.
class ChunkReader {
 public:
  explicit ChunkReader(absl::Span<const uint8_t> chunk) : chunk_(chunk) {}

  template <typename T>
  T Read() {
    if (chunk_.size() - position_ < sizeof(T)) {
      is_complete_ = false;
      position_ = chunk_.size();
      return 0;
    }
    const T value = LoadLittleEndian<T>(chunk_.data() + position_);
    position_ += sizeof(T);
    return value;
  }
  bool is_complete() const { return is_complete_; }
  absl::Status Damaged(absl::string_view what) const {
    return absl::DataLossError(
        absl::StrCat("byte ", position_, " of ", chunk_.size(), " of an ECF chunk: ", is_complete_ ? what : "it ends"));
  }

 private:
  const absl::Span<const uint8_t> chunk_;
  size_t position_ = 0;
  bool is_complete_ = true;
};

absl::Status DecodeTimes(ChunkReader& reader, absl::Span<Event> events) {
  // Unsigned: a step back is a step forward by 2^64 less its size.
  auto t_us = reader.Read<uint64_t>();
  for (size_t i = 0; i < events.size();) {
    auto byte = reader.Read<uint8_t>();
    uint64_t step_us = 0;
    for (int shift = 0; byte >> kTimeRunBits == kLongTime; shift += 4, byte = reader.Read<uint8_t>()) {
      if (shift == 64) return reader.Damaged("a time step has more than 64 bits");
      step_us |= uint64_t{byte & 15u} << shift;
    }
    size_t run = byte & LongRun(kTimeRunBits);
    if (run == LongRun(kTimeRunBits)) run = reader.Read<uint16_t>();
    t_us += step_us + (byte >> kTimeRunBits);
    if (!reader.is_complete() || run > events.size() - i) return reader.Damaged("more times than events");
    if (t_us > static_cast<uint64_t>(kMaxStateTimeUs)) return reader.Damaged("a time is out of range");
    for (const size_t end = i + run; i < end; ++i) events[i].t_us = static_cast<int64_t>(t_us);
  }
  return absl::OkStatus();
}

// Decodes runs of equal values: each word has the value and, in its lowest bits, the number of events that have it.
template <typename Word, int kRunBits, typename Assign>
absl::Status DecodeRuns(ChunkReader& reader, absl::Span<Event> events, const Assign& assign) {
  for (size_t i = 0; i < events.size();) {
    const Word word = reader.Read<Word>();
    size_t run = word & LongRun(kRunBits);
    if (run == LongRun(kRunBits)) run = reader.Read<uint16_t>();
    if (!reader.is_complete() || run > events.size() - i) return reader.Damaged("more rows or polarities than events");
    for (const size_t end = i + run; i < end; ++i) assign(events[i], static_cast<Word>(word >> kRunBits));
  }
  return absl::OkStatus();
}

absl::Status DecodeMaskedColumns(ChunkReader& reader, absl::Span<Event> events) {
  for (size_t i = 0; i < events.size();) {
    const auto word = reader.Read<uint16_t>();
    if (!reader.is_complete()) return reader.Damaged("");
    const auto x = static_cast<uint16_t>(word >> kColumns);
    events[i++].x = x;
    // Prophesee's encoder may mark columns after the last event of a chunk.
    for (int column = 1; column <= kColumns && i < events.size(); ++column) {
      if ((word >> (kColumns - column) & 1) != 0) events[i++].x = static_cast<uint16_t>(x + column);
    }
  }
  return absl::OkStatus();
}

// Four values, each of three quarters of a word, in three words; the first value begins at the highest bit.
template <typename Word>
struct Packing {
  static constexpr int kQuarter = sizeof(Word) * 2;
  static constexpr uint32_t Low(uint32_t value, int quarters) { return value & ((1u << (quarters * kQuarter)) - 1); }

  static std::array<uint32_t, 4> Unpack(const std::array<Word, 3>& words) {
    const uint32_t a = words[0], b = words[1], c = words[2];
    return {a >> kQuarter, Low(a, 1) | b >> 2 * kQuarter << kQuarter, Low(b, 2) | c >> 3 * kQuarter << 2 * kQuarter,
            Low(c, 3)};
  }
  static std::array<Word, 3> Pack(const std::array<uint32_t, 4>& values) {
    return {static_cast<Word>(values[0] << kQuarter | Low(values[1], 1)),
            static_cast<Word>(values[1] >> kQuarter << 2 * kQuarter | Low(values[2], 2)),
            static_cast<Word>(values[2] >> 2 * kQuarter << 3 * kQuarter | values[3])};
  }
};

template <typename Word, typename Assign>
absl::Status DecodePacked(ChunkReader& reader, absl::Span<Event> events, const Assign& assign) {
  for (size_t i = 0; i < events.size(); i += 4) {
    std::array<Word, 3> words;
    for (Word& word : words) word = reader.Read<Word>();
    if (!reader.is_complete()) return reader.Damaged("");
    const std::array<uint32_t, 4> values = Packing<Word>::Unpack(words);
    for (size_t j = 0; j < std::min<size_t>(4, events.size() - i); ++j) assign(events[i + j], values[j]);
  }
  return absl::OkStatus();
}

void AssignXp(Event& event, uint32_t value) {
  event.x = value >> 1 & kEcfMaxCoordinatePx;
  event.polarity = value & 1;
}

void AssignYxp(Event& event, uint32_t value) {
  AssignXp(event, value);
  event.y = value >> 12 & kEcfMaxCoordinatePx;
}

absl::Status DecodeAddresses(ChunkReader& reader, uint32_t layout, absl::Span<Event> events) {
  if ((layout & kPackedYxp) != 0) return DecodePacked<uint32_t>(reader, events, AssignYxp);
  EVPOSE_RETURN_IF_ERROR(
      (DecodeRuns<uint16_t, kRowRunBits>(reader, events, [](Event& event, uint16_t y) { event.y = y; })));
  if ((layout & kPackedXp) != 0) return DecodePacked<uint16_t>(reader, events, AssignXp);
  EVPOSE_RETURN_IF_ERROR(DecodeMaskedColumns(reader, events));
  return DecodeRuns<uint8_t, kPolarityRunBits>(reader, events, [](Event& event, uint8_t p) { event.polarity = p; });
}

void EncodeTimes(absl::Span<const Event> events, std::vector<uint8_t>& out) {
  auto t_us = static_cast<uint64_t>(events.front().t_us);
  AppendLittleEndian(t_us, out);
  for (size_t i = 0; i < events.size();) {
    const auto next_us = static_cast<uint64_t>(events[i].t_us);
    size_t end = i + 1;
    while (end < events.size() && events[end].t_us == events[i].t_us) ++end;
    uint64_t step_us = next_us - t_us;
    if (step_us >= kLongTime) {
      for (; step_us > 0; step_us >>= 4)
        out.push_back(static_cast<uint8_t>(kLongTime << kTimeRunBits | (step_us & 15)));
    }
    const size_t run = std::min<size_t>(end - i, LongRun(kTimeRunBits));
    out.push_back(static_cast<uint8_t>(step_us << kTimeRunBits | run));
    if (run == LongRun(kTimeRunBits)) AppendLittleEndian(static_cast<uint16_t>(end - i), out);
    t_us = next_us;
    i = end;
  }
}

template <typename Word, int kRunBits, typename Value>
void EncodeRuns(absl::Span<const Event> events, const Value& value, std::vector<uint8_t>& out) {
  for (size_t i = 0; i < events.size();) {
    size_t end = i + 1;
    while (end < events.size() && value(events[end]) == value(events[i])) ++end;
    const size_t run = std::min<size_t>(end - i, LongRun(kRunBits));
    AppendLittleEndian(static_cast<Word>(value(events[i]) << kRunBits | run), out);
    if (run == LongRun(kRunBits)) AppendLittleEndian(static_cast<uint16_t>(end - i), out);
    i = end;
  }
}

void EncodeMaskedColumns(absl::Span<const Event> events, std::vector<uint8_t>& out) {
  for (size_t i = 0; i < events.size();) {
    const int x = events[i++].x;
    unsigned mask = 0;
    for (int column = 1; column <= kColumns && i < events.size(); ++column) {
      if (events[i].x != x + column) continue;
      mask |= 1u << (kColumns - column);
      ++i;
    }
    AppendLittleEndian(static_cast<uint16_t>(static_cast<unsigned>(x) << kColumns | mask), out);
  }
}

template <typename Word, typename Value>
void EncodePacked(absl::Span<const Event> events, const Value& value, std::vector<uint8_t>& out) {
  for (size_t i = 0; i < events.size(); i += 4) {
    std::array<uint32_t, 4> values{};
    for (size_t j = 0; j < std::min<size_t>(4, events.size() - i); ++j) values[j] = value(events[i + j]);
    for (const Word word : Packing<Word>::Pack(values)) AppendLittleEndian(word, out);
  }
}

uint32_t Xp(const Event& event) { return static_cast<uint32_t>(event.x) << 1 | event.polarity; }
uint32_t Yxp(const Event& event) { return static_cast<uint32_t>(event.y) << 12 | Xp(event); }

absl::Status CheckEncodable(absl::Span<const Event> events) {
  if (events.empty() || events.size() > kEcfMaxEvents) {
    return absl::InvalidArgumentError(
        absl::StrCat("an ECF chunk has 1 to ", kEcfMaxEvents, " events, not ", events.size()));
  }
  for (size_t i = 0; i < events.size(); ++i) {
    const Event& event = events[i];
    if (event.x <= kEcfMaxCoordinatePx && event.y <= kEcfMaxCoordinatePx && event.polarity <= 1 && event.t_us >= 0 &&
        event.t_us <= kMaxStateTimeUs) {
      continue;
    }
    return absl::InvalidArgumentError(absl::StrCat("event ", i, " of a chunk (x ", event.x, ", y ", event.y, ", t ",
                                                   event.t_us, " us, polarity ", event.polarity,
                                                   ") does not fit ECF: x and y are at most ", kEcfMaxCoordinatePx));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status DecodeEcfChunk(absl::Span<const uint8_t> chunk, EventVector& events) {
  ChunkReader reader(chunk);
  const auto first = reader.Read<uint32_t>();
  const size_t count = first >> kLayoutBits;
  if (!reader.is_complete() || count > kEcfMaxEvents) return reader.Damaged(absl::StrCat(count, " events"));
  const size_t begin = events.size();
  events.resize(begin + count);
  const absl::Span<Event> added = absl::MakeSpan(events).subspan(begin);
  absl::Status status = DecodeTimes(reader, added);
  if (status.ok()) status = DecodeAddresses(reader, first & ((1u << kLayoutBits) - 1), added);
  if (!status.ok()) events.resize(begin);
  return status;
}

absl::Status EncodeEcfChunk(absl::Span<const Event> events, std::vector<uint8_t>& chunk) {
  EVPOSE_RETURN_IF_ERROR(CheckEncodable(events));
  std::vector<uint8_t> packed_yxp, rows, packed_xp, columns;
  EncodePacked<uint32_t>(events, Yxp, packed_yxp);
  EncodeRuns<uint16_t, kRowRunBits>(
      events, [](const Event& event) { return event.y; }, rows);
  EncodePacked<uint16_t>(events, Xp, packed_xp);
  EncodeMaskedColumns(events, columns);
  EncodeRuns<uint8_t, kPolarityRunBits>(
      events, [](const Event& event) { return event.polarity; }, columns);
  const bool packs_xp = packed_xp.size() < columns.size();
  const std::vector<uint8_t>& row_wise = packs_xp ? packed_xp : columns;
  const bool packs_yxp = packed_yxp.size() < rows.size() + row_wise.size();
  const uint32_t layout = packs_yxp ? kPackedYxp : packs_xp ? kPackedXp : 0;
  AppendLittleEndian(static_cast<uint32_t>(events.size() << kLayoutBits) | layout, chunk);
  EncodeTimes(events, chunk);
  if (packs_yxp) {
    chunk.insert(chunk.end(), packed_yxp.begin(), packed_yxp.end());
  } else {
    chunk.insert(chunk.end(), rows.begin(), rows.end());
    chunk.insert(chunk.end(), row_wise.begin(), row_wise.end());
  }
  return absl::OkStatus();
}

}  // namespace evpose::client
