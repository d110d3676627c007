// SPDX-License-Identifier: Apache-2.0

// Decoding of runs with AVX-512, in blocks of sixteen words (EVT2.1: eight). A word is a lane, a set of words a mask.
#include <algorithm>
#include <array>
#include <bit>

#include "core/events/word_runs.h"
#include "core/events/word_types.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace evpose {

#if defined(__x86_64__)

namespace {

#define EVPOSE_AVX512 gnu::target("avx512f,avx512bw,avx512cd,avx512vbmi,popcnt")
#define EVPOSE_AVX512_INLINE EVPOSE_AVX512, gnu::always_inline

// The words before the first one that is not in the set.
constexpr uint32_t LeadingWords(uint32_t set) { return set & ~(set + 1); }

[[EVPOSE_AVX512_INLINE]] inline __m512i Fill32(uint32_t value) {
  return _mm512_set1_epi32(static_cast<int32_t>(value));
}

[[EVPOSE_AVX512_INLINE]] inline __m512i Fill64(uint64_t value) {
  return _mm512_set1_epi64(static_cast<int64_t>(value));
}

// Four events with this time and zeros in their other fields.
[[EVPOSE_AVX512_INLINE]] inline __m512i FourOfTime(int64_t t_us) { return _mm512_maskz_set1_epi64(0x55, t_us); }

// EVT3.

constexpr size_t kEvt3Lanes = 16;
constexpr uint32_t kAllEvt3Lanes = 0xffff;

[[EVPOSE_AVX512_INLINE]] inline uint32_t LastLane(__m512i lanes) {
  return static_cast<uint32_t>(_mm_extract_epi32(_mm512_extracti32x4_epi32(lanes, 3), 3));
}

// Returns for each lane the last lane of the set at or before it; the last lane of `carried` if there is none.
[[EVPOSE_AVX512_INLINE]] inline __m512i Latest(__m512i lanes, uint32_t set, __m512i carried) {
  const __m512i up_to_lane = _mm512_setr_epi32(0x1, 0x3, 0x7, 0xf, 0x1f, 0x3f, 0x7f, 0xff, 0x1ff, 0x3ff, 0x7ff, 0xfff,
                                               0x1fff, 0x3fff, 0x7fff, 0xffff);
  const __m512i before = _mm512_and_si512(Fill32(set), up_to_lane);
  // -1 without an earlier lane; as an index, -1 selects the last lane of the second operand.
  const __m512i latest = _mm512_sub_epi32(Fill32(31), _mm512_lzcnt_epi32(before));
  return _mm512_permutex2var_epi32(lanes, latest, carried);
}

struct Evt3Bounds {
  __m512i width;
  __m512i height;
  __m512i low_end;
  __m512i same_high;
};

[[EVPOSE_AVX512_INLINE]] inline Evt3Bounds BoundsOf(const Evt3Run& run) {
  const int64_t until_mark_us = std::clamp<int64_t>(run.mark_due_us - run.base_us, 0, 0x1000);
  const auto high = static_cast<uint32_t>((run.base_us >> 12) & 0xfff);
  return {Fill32(run.width_px), Fill32(run.height_px), Fill32(static_cast<uint32_t>(until_mark_us)),
          Fill32(evt3::kTimeHigh << 12 | high)};
}

// Each word interpreted as each of the three types, and the sets of words that have the type; a word of another type is
// out of bounds.
struct Evt3Block {
  __m512i x;
  __m512i y;
  __m512i low;
  __m512i polarity;  // in the lowest bit of byte 2
  uint32_t columns = 0;
  uint32_t rows = 0;
  uint32_t lows = 0;
  uint32_t plain = 0;
};

[[EVPOSE_AVX512_INLINE]] inline Evt3Block ReadBlock(const uint8_t* words, const Evt3Bounds& bounds) {
  const __m512i block = _mm512_cvtepu16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(words)));
  Evt3Block read;
  read.x = _mm512_and_si512(_mm512_xor_si512(block, Fill32(evt3::kAddrX << 12)), Fill32(0xf7ff));
  read.y = block;  // type 0
  read.low = _mm512_xor_si512(block, Fill32(evt3::kTimeLow << 12));
  read.polarity = _mm512_and_si512(_mm512_slli_epi32(block, 16 - 11), Fill32(1 << 16));
  read.columns = _mm512_cmplt_epu32_mask(read.x, bounds.width);
  read.rows = _mm512_cmplt_epu32_mask(read.y, bounds.height);
  read.lows = _mm512_cmplt_epu32_mask(read.low, bounds.low_end);
  read.plain = read.columns | read.rows | read.lows | _mm512_cmpeq_epi32_mask(block, bounds.same_high);
  return read;
}

// The positions of the bytes of four events in two vectors, from lane `first` of both on: one with time and polarity
// (above it a byte of zeros), one with column and row.
constexpr std::array<uint8_t, 64> EventBytes(size_t first) {
  std::array<uint8_t, 64> bytes = {};
  for (size_t i = 0; i < bytes.size(); ++i) {
    const size_t lane = first + i / sizeof(Event), byte = i % sizeof(Event);
    size_t source = 4 * lane + 3;
    if (byte < 2) source = 4 * lane + byte;
    if (byte >= offsetof(Event, x) && byte < offsetof(Event, polarity)) source = 64 + 4 * lane + byte % 4;
    if (byte == offsetof(Event, polarity)) source = 4 * lane + 2;
    bytes[i] = static_cast<uint8_t>(source);
  }
  return bytes;
}

template <size_t first>
[[EVPOSE_AVX512_INLINE]] inline void StoreFour512(Event* events, __m512i time_polarity, __m512i xy, __m512i base_us) {
  alignas(64) static constexpr std::array<uint8_t, 64> kBytes = EventBytes(first);
  const __m512i fields = _mm512_permutex2var_epi8(time_polarity, _mm512_load_si512(kBytes.data()), xy);
  _mm512_storeu_si512(events + first, _mm512_add_epi64(fields, base_us));
}

struct Evt3Output {
  __m512i row;  // in the last lane, the row of the last word
  __m512i low;  // likewise
  __m512i base_us;
  Event* next;
};

// Stores the events among the words of a set, each with its time and row. Returns false, without an effect, if the time
// steps back.
[[EVPOSE_AVX512_INLINE]] inline bool Append(const Evt3Block& block, uint32_t set, Evt3Output& output) {
  const __m512i low = Latest(block.low, block.lows & set, output.low);
  const __m512i low_before = _mm512_alignr_epi32(low, output.low, kEvt3Lanes - 1);
  if (_mm512_cmplt_epu32_mask(low, low_before) != 0) [[unlikely]]
    return false;
  const __m512i row = Latest(block.y, block.rows & set, output.row);
  const auto columns = static_cast<__mmask16>(block.columns & set);
  const __m512i time_polarity = _mm512_maskz_compress_epi32(columns, _mm512_or_si512(low, block.polarity));
  const __m512i xy = _mm512_maskz_compress_epi32(columns, _mm512_or_si512(block.x, _mm512_slli_epi32(row, 16)));
  StoreFour512<0>(output.next, time_polarity, xy, output.base_us);
  StoreFour512<4>(output.next, time_polarity, xy, output.base_us);
  StoreFour512<8>(output.next, time_polarity, xy, output.base_us);
  StoreFour512<12>(output.next, time_polarity, xy, output.base_us);
  output.row = row;
  output.low = low;
  output.next += std::popcount(static_cast<uint32_t>(columns));
  return true;
}

[[EVPOSE_AVX512]] size_t DecodeEvt3Run512(const uint8_t* words, size_t count, Evt3Run& run, Event*& cursor,
                                          const Event* limit) {
  const Evt3Bounds bounds = BoundsOf(run);
  Evt3Output output = {Fill32(run.row), Fill32(static_cast<uint32_t>(run.low_us)), FourOfTime(run.base_us), cursor};
  size_t index = 0;
  while (count - index >= kEvt3Lanes && output.next < limit) {
    const Evt3Block block = ReadBlock(words + 2 * index, bounds);
    if (block.plain != kAllEvt3Lanes) [[unlikely]] {
      const uint32_t leading = LeadingWords(block.plain);
      if (!Append(block, leading, output)) break;
      index += static_cast<size_t>(std::popcount(leading));
      if (count - index < Evt3WholeVector::kWords || output.next >= limit) break;
      const Evt3WholeVector vector(words + 2 * index);
      if (!vector.IsInside(run.width_px)) break;
      output.next = vector.Store(run.base_us + LastLane(output.low), LastLane(output.row), run.base, output.next);
      index += Evt3WholeVector::kWords;
      continue;
    }
    if (!Append(block, kAllEvt3Lanes, output)) [[unlikely]]
      break;
    // A constant, so that the next block does not depend on the content of this one.
    index += kEvt3Lanes;
  }
  cursor = output.next;
  run.row = LastLane(output.row);
  run.low_us = LastLane(output.low);
  return index;
}

// EVT2 and EVT2.1.

// Fields of an EVT2 word, or of the upper half of an EVT2.1 word.
constexpr uint32_t kEvt2Low = 0x3f << 22;
constexpr uint32_t kEvt2X = 0x7ff << 11;
constexpr uint32_t kEvt2Y = 0x7ff;
constexpr uint32_t kEvt2TypeEnd = (evt2::kCdOn + 1) << 28;

// The word of the current TIME_HIGH.
constexpr uint32_t SameHigh(const Evt2Run& run) {
  return evt2::kTimeHigh << 28 | static_cast<uint32_t>((run.base_us >> 6) & 0xfffffff);
}

// Stores four events of four pairs of 64-bit lanes: each pair has the same word twice, from bit `first_bit` of the lane
// on.
template <int first_bit>
[[EVPOSE_AVX512_INLINE]] inline void StoreFourTwice(Event* events, __m512i twice, __m512i base_us) {
  constexpr auto bit_of_byte = [](int bit, int byte) {
    return static_cast<int64_t>((first_bit + bit) % 64) << 8 * byte;
  };
  constexpr int64_t kTimeBits = bit_of_byte(22, 0);
  constexpr int64_t kRestBits =
      bit_of_byte(11, 0) | bit_of_byte(19, 1) | bit_of_byte(0, 2) | bit_of_byte(8, 3) | bit_of_byte(28, 4);
  const __m512i bits = _mm512_set4_epi64(kRestBits, kTimeBits, kRestBits, kTimeBits);
  const __m512i fields = _mm512_set4_epi64(0x1'07ff'07ff, 0x3f, 0x1'07ff'07ff, 0x3f);
  const __m512i event = _mm512_and_si512(_mm512_multishift_epi64_epi8(bits, twice), fields);
  // An OR instead of an addition, because the lowest bits of the base are zeros.
  _mm512_storeu_si512(events, _mm512_or_si512(event, base_us));
}

// Bit masks of the words of a block that are events, and of those that are plain.
struct Evt2Sets {
  uint32_t events = 0;
  uint32_t plain = 0;
};

class Evt2Lanes {
 public:
  static constexpr size_t kLanes = 16;

  [[EVPOSE_AVX512_INLINE]] explicit Evt2Lanes(const Evt2Run& run, bool high_is_plain)
      : width_(Fill32(run.width_px << 11)),
        height_(Fill32(run.height_px)),
        same_high_(Fill32(SameHigh(run))),
        high_is_plain_(high_is_plain ? 0xffff : 0) {}

  [[EVPOSE_AVX512_INLINE]] static __m512i Low(uint32_t low_us) { return Fill32(low_us << 22); }

  [[EVPOSE_AVX512_INLINE]] Evt2Sets Classify(__m512i block) const {
    __mmask16 events = _mm512_cmplt_epu32_mask(block, Fill32(kEvt2TypeEnd));
    events = _mm512_mask_cmplt_epu32_mask(events, _mm512_and_si512(block, Fill32(kEvt2X)), width_);
    events = _mm512_mask_cmplt_epu32_mask(events, _mm512_and_si512(block, Fill32(kEvt2Y)), height_);
    const __mmask16 highs = _mm512_mask_cmpeq_epi32_mask(high_is_plain_, block, same_high_);
    return {events, static_cast<uint32_t>(events | highs)};
  }

  // Moves the words of the set to the front; the bits after them are ones.
  [[EVPOSE_AVX512_INLINE]] static __m512i Compress(uint32_t set, __m512i block) {
    return _mm512_mask_compress_epi32(Fill32(0xffff'ffff), static_cast<__mmask16>(set), block);
  }

  [[EVPOSE_AVX512_INLINE]] static __m512i Lows(__m512i events) { return _mm512_and_si512(events, Fill32(kEvt2Low)); }

  // Whether a lane is less than the one before it; the last lane of `carried` comes before the first.
  [[EVPOSE_AVX512_INLINE]] static bool StepsBack(__m512i lows, __m512i carried) {
    return _mm512_cmplt_epu32_mask(lows, _mm512_alignr_epi32(lows, carried, kLanes - 1)) != 0;
  }

  [[EVPOSE_AVX512_INLINE]] static __m512i Broadcast(__m512i lanes, uint32_t lane) {
    return _mm512_permutexvar_epi32(Fill32(lane), lanes);
  }

  [[EVPOSE_AVX512_INLINE]] static void Store(Event* events, __m512i words, __m512i base_us) {
    const __m512i twice = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
    for (uint32_t first = 0; first < kLanes; first += 4) {
      const __m512i lanes = _mm512_add_epi32(twice, Fill32(first));
      StoreFourTwice<0>(events + first, _mm512_permutexvar_epi32(lanes, words), base_us);
    }
  }

 private:
  __m512i width_;
  __m512i height_;
  __m512i same_high_;
  __mmask16 high_is_plain_;
};

class Evt21Lanes {
 public:
  static constexpr size_t kLanes = 8;

  [[EVPOSE_AVX512_INLINE]] explicit Evt21Lanes(const Evt2Run& run, bool high_is_plain)
      : width_(Upper(run.width_px << 11)),
        height_(Upper(run.height_px)),
        same_high_(Upper(SameHigh(run))),
        high_is_plain_(high_is_plain ? 0xff : 0) {}

  [[EVPOSE_AVX512_INLINE]] static __m512i Low(uint32_t low_us) { return Upper(low_us << 22); }

  [[EVPOSE_AVX512_INLINE]] Evt2Sets Classify(__m512i block) const {
    const __m512i pixels = _mm512_and_si512(block, Fill64(0xffff'ffff));
    const __m512i x = _mm512_add_epi64(_mm512_and_si512(block, Upper(kEvt2X)), ColumnsToPixel(block));
    __mmask8 events = _mm512_cmplt_epu64_mask(block, Upper(kEvt2TypeEnd));
    events = _mm512_mask_cmplt_epu64_mask(events, x, width_);
    events = _mm512_mask_cmplt_epu64_mask(events, _mm512_and_si512(block, Upper(kEvt2Y)), height_);
    // Masks of exactly one pixel.
    events = _mm512_mask_test_epi64_mask(events, pixels, pixels);
    events = _mm512_mask_testn_epi64_mask(events, pixels, _mm512_sub_epi64(pixels, Fill64(1)));
    const __m512i upper = _mm512_xor_si512(block, pixels);
    const __mmask8 highs = _mm512_mask_cmpeq_epi64_mask(high_is_plain_, upper, same_high_);
    return {events, static_cast<uint32_t>(events | highs)};
  }

  // The same, with the column of the pixel in place of that of the mask.
  [[EVPOSE_AVX512_INLINE]] static __m512i Compress(uint32_t set, __m512i block) {
    const __m512i words = _mm512_add_epi64(block, ColumnsToPixel(block));
    return _mm512_mask_compress_epi64(Fill32(0xffff'ffff), static_cast<__mmask8>(set), words);
  }

  [[EVPOSE_AVX512_INLINE]] static __m512i Lows(__m512i events) { return _mm512_and_si512(events, Upper(kEvt2Low)); }

  [[EVPOSE_AVX512_INLINE]] static bool StepsBack(__m512i lows, __m512i carried) {
    return _mm512_cmplt_epu64_mask(lows, _mm512_alignr_epi64(lows, carried, kLanes - 1)) != 0;
  }

  [[EVPOSE_AVX512_INLINE]] static __m512i Broadcast(__m512i lanes, uint32_t lane) {
    return _mm512_permutexvar_epi64(Fill64(lane), lanes);
  }

  [[EVPOSE_AVX512_INLINE]] static void Store(Event* events, __m512i words, __m512i base_us) {
    const __m512i twice = _mm512_setr_epi64(0, 0, 1, 1, 2, 2, 3, 3);
    for (uint32_t first = 0; first < kLanes; first += 4) {
      const __m512i lanes = _mm512_add_epi64(twice, Fill64(first));
      StoreFourTwice<32>(events + first, _mm512_permutexvar_epi64(lanes, words), base_us);
    }
  }

 private:
  [[EVPOSE_AVX512_INLINE]] static __m512i Upper(uint32_t half) { return Fill64(uint64_t{half} << 32); }

  // The distance from the first column of the mask to its pixel, at the position of a word's column.
  [[EVPOSE_AVX512_INLINE]] static __m512i ColumnsToPixel(__m512i block) {
    const __m512i pixels = _mm512_and_si512(block, Fill64(0xffff'ffff));
    const __m512i pixel = _mm512_sub_epi64(Fill64(63), _mm512_lzcnt_epi64(pixels));
    return _mm512_slli_epi64(pixel, 32 + 11);
  }

  __m512i width_;
  __m512i height_;
  __m512i same_high_;
  __mmask8 high_is_plain_;
};

struct Evt2Output {
  __m512i low;  // in all lanes, the low bits of the last event
  __m512i base_us;
  Event* next;
};

// Stores the words of a set, which are events. Returns false, without an effect, if the time steps back.
template <typename Lanes>
[[EVPOSE_AVX512_INLINE]] inline bool Append(__m512i block, uint32_t events, Evt2Output& output) {
  const __m512i words = Lanes::Compress(events, block);
  const __m512i lows = Lanes::Lows(words);
  if (Lanes::StepsBack(lows, output.low)) [[unlikely]]
    return false;
  const auto num_events = static_cast<uint32_t>(std::popcount(events));
  Lanes::Store(output.next, words, output.base_us);
  // Without an event this takes the last lane, which has ones: the next block then looks like a step back and ends the
  // run, which costs time only.
  output.low = Lanes::Broadcast(lows, num_events - 1);
  output.next += num_events;
  return true;
}

template <typename Lanes>
[[EVPOSE_AVX512]] size_t DecodeEvt2Run512(const uint8_t* words, size_t count, Evt2Run& run, Event*& cursor,
                                          const Event* limit) {
  constexpr size_t kWordBytes = 64 / Lanes::kLanes;
  constexpr uint32_t kAllLanes = (1u << Lanes::kLanes) - 1;
  const Lanes lanes(run, run.base_us + 0x3f < run.mark_due_us);
  Evt2Output output = {Lanes::Low(static_cast<uint32_t>(run.low_us)), FourOfTime(run.base_us), cursor};
  size_t index = 0;
  while (count - index >= Lanes::kLanes && output.next < limit) {
    const __m512i block = _mm512_loadu_si512(words + kWordBytes * index);
    const Evt2Sets sets = lanes.Classify(block);
    if (sets.plain != kAllLanes) [[unlikely]] {
      const uint32_t leading = LeadingWords(sets.plain);
      if (Append<Lanes>(block, sets.events & leading, output)) index += static_cast<size_t>(std::popcount(leading));
      break;
    }
    if (!Append<Lanes>(block, sets.events, output)) [[unlikely]]
      break;
    index += Lanes::kLanes;
  }
  if (output.next != cursor) run.low_us = output.next[-1].t_us - run.base_us;
  cursor = output.next;
  return index;
}

constexpr WordRuns kAvx512WordRuns = {DecodeEvt3Run512, DecodeEvt2Run512<Evt2Lanes>, DecodeEvt2Run512<Evt21Lanes>};

#undef EVPOSE_AVX512_INLINE
#undef EVPOSE_AVX512

}  // namespace

const WordRuns* Avx512WordRuns() {
  static const bool has = __builtin_cpu_supports("avx512f") != 0 && __builtin_cpu_supports("avx512bw") != 0 &&
                          __builtin_cpu_supports("avx512cd") != 0 && __builtin_cpu_supports("avx512vbmi") != 0 &&
                          __builtin_cpu_supports("popcnt") != 0;
  return has ? &kAvx512WordRuns : nullptr;
}

#else

const WordRuns* Avx512WordRuns() { return nullptr; }

#endif

}  // namespace evpose
