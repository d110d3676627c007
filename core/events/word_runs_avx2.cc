// SPDX-License-Identifier: Apache-2.0

// Decoding of runs with AVX2, in blocks of eight words (EVT2.1: four).
#include <algorithm>
#include <array>
#include <bit>
#include <optional>

#include "core/events/word_runs.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace evpose {

#if defined(__x86_64__)

namespace {

constexpr int kLanes = 8;

// Control bytes of a shuffle of 16-bit lanes.
struct alignas(16) LaneShuffle {
  uint8_t bytes[16];

  constexpr void Set(size_t lane, size_t source) {
    bytes[2 * lane] = static_cast<uint8_t>(2 * source);
    bytes[2 * lane + 1] = static_cast<uint8_t>(2 * source + 1);
  }
};
using LaneShuffles = std::array<LaneShuffle, 1 << kLanes>;  // indexed by a set of lanes, a bit for each

// Shuffles that move the lanes of the set to the front, in the order that StoreFourInTurn() requires.
constexpr LaneShuffles MakeCompress() {
  constexpr size_t kPlace[] = {0, 2, 1, 3, 4, 6, 5, 7};
  LaneShuffles shuffles = {};
  for (size_t set = 0; set < shuffles.size(); ++set) {
    size_t count = 0;
    for (size_t lane = 0; lane < kLanes; ++lane) {
      if ((set >> lane & 1) != 0) shuffles[set].Set(kPlace[count++], lane);
    }
  }
  return shuffles;
}

// Shuffles that give every lane the last lane of the set at or before it; kNone if there is none.
constexpr uint8_t kNone = 0x80;
constexpr LaneShuffles MakeSpread() {
  LaneShuffles shuffles = {};
  for (size_t set = 0; set < shuffles.size(); ++set) {
    std::optional<size_t> last;
    for (size_t lane = 0; lane < kLanes; ++lane) {
      if ((set >> lane & 1) != 0) last = lane;
      if (last.has_value()) {
        shuffles[set].Set(lane, *last);
      } else {
        shuffles[set].bytes[2 * lane] = shuffles[set].bytes[2 * lane + 1] = kNone;
      }
    }
  }
  return shuffles;
}

constexpr LaneShuffles kCompress = MakeCompress();
constexpr LaneShuffles kSpread = MakeSpread();

[[gnu::target("avx2"), gnu::always_inline]] inline __m128i Load(const LaneShuffle& shuffle) {
  return _mm_load_si128(reinterpret_cast<const __m128i*>(shuffle.bytes));
}

// Returns for each lane the last lane of the set at or before it; `carried` if there is none.
[[gnu::target("avx2"), gnu::always_inline]] inline __m128i Spread(__m128i lanes, uint32_t set, __m128i carried) {
  const __m128i shuffle = Load(kSpread[set]);
  return _mm_blendv_epi8(_mm_shuffle_epi8(lanes, shuffle), carried, shuffle);
}

[[gnu::target("avx2"), gnu::always_inline]] inline __m128i BroadcastLast(__m128i lanes) {
  return _mm_shuffle_epi8(lanes, _mm_set1_epi16(0x0f0e));
}

// Stores four events of their times and their other fields in the layout of StoreEvent().
[[gnu::target("avx2"), gnu::always_inline]] inline void StoreFour(Event* events, __m256i t_us, __m256i rest) {
  const __m256i even = _mm256_unpacklo_epi64(t_us, rest);
  const __m256i odd = _mm256_unpackhi_epi64(t_us, rest);
  auto* const out = reinterpret_cast<__m256i*>(events);
  _mm256_storeu_si256(out, _mm256_permute2x128_si256(even, odd, 0x20));
  _mm256_storeu_si256(out + 1, _mm256_permute2x128_si256(even, odd, 0x31));
}

// The same for lanes in the order first, third, second, fourth event, which saves one instruction.
[[gnu::target("avx2"), gnu::always_inline]] inline void StoreFourInTurn(Event* events, __m256i t_us, __m256i rest) {
  auto* const out = reinterpret_cast<__m256i*>(events);
  _mm256_storeu_si256(out, _mm256_unpacklo_epi64(t_us, rest));
  _mm256_storeu_si256(out + 1, _mm256_unpackhi_epi64(t_us, rest));
}

[[gnu::target("avx2"), gnu::always_inline]] inline __m128i Fill16(int64_t value) {
  return _mm_set1_epi16(static_cast<int16_t>(value));
}

// AVX2 compares signed numbers only: with the highest bit inverted ("turned") they have the order of unsigned ones.
constexpr int64_t kTurned = 0x8000;

struct Evt3Ends {
  __m128i x;  // turned, like the next two
  __m128i y;
  __m128i low;
  __m128i same_high;
};

[[gnu::target("avx2"), gnu::always_inline]] inline Evt3Ends EndsOf(const Evt3Run& run) {
  const int64_t until_mark_us = std::clamp<int64_t>(run.mark_due_us - run.base_us, 0, 0x1000);
  return {Fill16(run.width_px ^ kTurned), Fill16(run.height_px ^ kTurned), Fill16(until_mark_us ^ kTurned),
          Fill16(0x8000 | ((run.base_us >> 12) & 0xfff))};
}

// Sets of the eight words of a block, a bit for each: columns, rows, times, plain words.
struct Evt3Sets {
  uint32_t columns = 0;
  uint32_t rows = 0;
  uint32_t lows = 0;
  uint32_t plain = 0;
};

// The content of TIME_LOW words, turned; words of other types are out of its range.
[[gnu::target("avx2"), gnu::always_inline]] inline __m128i TurnedLows(__m128i words) {
  return _mm_xor_si128(words, Fill16(0x6000 ^ kTurned));
}

[[gnu::target("avx2"), gnu::always_inline]] inline Evt3Sets Classify(__m128i words, const Evt3Ends& ends) {
  const __m128i turned_x = _mm_and_si128(_mm_xor_si128(words, Fill16(0x2000 ^ kTurned)), Fill16(0xf7ff));
  const __m128i turned_y = _mm_xor_si128(words, Fill16(kTurned));
  const __m128i columns = _mm_cmpgt_epi16(ends.x, turned_x);
  const __m128i rows = _mm_cmpgt_epi16(ends.y, turned_y);
  const __m128i lows = _mm_cmpgt_epi16(ends.low, TurnedLows(words));
  const __m128i highs = _mm_cmpeq_epi16(words, ends.same_high);
  const __m128i plain = _mm_or_si128(_mm_or_si128(columns, rows), _mm_or_si128(lows, highs));
  const auto addresses = static_cast<uint32_t>(_mm_movemask_epi8(_mm_packs_epi16(columns, rows)));
  const auto others = static_cast<uint32_t>(_mm_movemask_epi8(_mm_packs_epi16(lows, plain)));
  return {addresses & 0xff, addresses >> kLanes, others & 0xff, others >> kLanes};
}

// Stores four events. Each lane of `xy` has the column in its low half and, in its high half, the row with the polarity
// as the highest bit; `lows` are turned TIME_LOWs, for which `base_us` is corrected.
[[gnu::target("avx2"), gnu::always_inline]] inline void StoreFourEvt3(Event* events, __m128i xy, __m128i lows,
                                                                      __m256i base_us) {
  const __m256i fields = _mm256_cvtepu32_epi64(xy);
  // The addition of the polarity to itself shifts it by one bit, to its place.
  const __m256i polarity = _mm256_and_si256(fields, _mm256_set1_epi64x(int64_t{1} << 31));
  StoreFourInTurn(events, _mm256_add_epi64(_mm256_cvtepu16_epi64(lows), base_us), _mm256_add_epi64(fields, polarity));
}

struct Evt3State256 {
  __m128i row;      // in all lanes, the row of the last word
  __m128i low;      // likewise, turned
  __m256i base_us;  // less kTurned
  Event* next;
};

[[gnu::target("avx2"), gnu::always_inline]] inline uint32_t RowOf(const Evt3State256& state) {
  return static_cast<uint32_t>(_mm_extract_epi16(state.row, 0));
}
[[gnu::target("avx2"), gnu::always_inline]] inline int64_t LowOf(const Evt3State256& state) {
  return _mm_extract_epi16(state.low, 0) ^ kTurned;
}

// Stores the events among the words of the sets, each with its time and row. Returns false, without an effect, if the
// time steps back.
[[gnu::target("avx2,popcnt"), gnu::always_inline]] inline bool AppendEvt3(__m128i words, const Evt3Sets& sets,
                                                                          Evt3State256& state) {
  const __m128i lows = Spread(TurnedLows(words), sets.lows, state.low);
  const __m128i steps_back = _mm_cmpgt_epi16(_mm_alignr_epi8(lows, state.low, 14), lows);
  if (_mm_testz_si128(steps_back, steps_back) == 0) [[unlikely]]
    return false;
  const __m128i rows = Spread(words, sets.rows, state.row);
  const __m128i polarity = _mm_and_si128(_mm_slli_epi16(words, 15 - 11), Fill16(0x8000));
  const __m128i compress = Load(kCompress[sets.columns]);
  const __m128i x = _mm_shuffle_epi8(_mm_and_si128(words, Fill16(0x7ff)), compress);
  const __m128i y = _mm_shuffle_epi8(_mm_or_si128(rows, polarity), compress);
  const __m128i event_lows = _mm_shuffle_epi8(lows, compress);
  StoreFourEvt3(state.next, _mm_unpacklo_epi16(x, y), event_lows, state.base_us);
  StoreFourEvt3(state.next + 4, _mm_unpackhi_epi16(x, y), _mm_srli_si128(event_lows, 8), state.base_us);
  state.row = BroadcastLast(rows);
  state.low = BroadcastLast(lows);
  state.next += std::popcount(sets.columns);
  return true;
}

[[gnu::target("avx2,popcnt")]] size_t DecodeEvt3Run256(const uint8_t* words, size_t count, Evt3Run& run, Event*& cursor,
                                                       const Event* limit) {
  const Evt3Ends ends = EndsOf(run);
  Evt3State256 state = {Fill16(run.row), Fill16(run.low_us ^ kTurned), _mm256_set1_epi64x(run.base_us - kTurned),
                        cursor};
  size_t index = 0;
  while (count - index >= kLanes && state.next < limit) {
    const __m128i block = _mm_loadu_si128(reinterpret_cast<const __m128i*>(words + 2 * index));
    const Evt3Sets sets = Classify(block, ends);
    if (sets.plain != 0xff) [[unlikely]] {
      const int num_leading = std::countr_one(sets.plain);
      const uint32_t leading = (1u << num_leading) - 1;
      if (!AppendEvt3(block, {sets.columns & leading, sets.rows & leading, sets.lows & leading, leading}, state)) break;
      index += static_cast<size_t>(num_leading);
      if (count - index < Evt3WholeVector::kWords || state.next >= limit) break;
      const Evt3WholeVector vector(words + 2 * index);
      if (!vector.IsInside(run.width_px)) break;
      state.next = vector.Store(run.base_us + LowOf(state), RowOf(state), run.base, state.next);
      index += Evt3WholeVector::kWords;
      continue;
    }
    if (!AppendEvt3(block, sets, state)) [[unlikely]]
      break;
    // A constant, so that the next block does not depend on the content of this one.
    index += kLanes;
  }
  cursor = state.next;
  run.row = RowOf(state);
  run.low_us = LowOf(state);
  return index;
}

[[gnu::target("avx2,popcnt")]] size_t DecodeEvt2Run256(const uint8_t* words, size_t count, Evt2Run& run, Event*& cursor,
                                                       const Event* limit) {
  const __m256i last_column = _mm256_set1_epi32(static_cast<int32_t>(run.width_px - 1));
  const __m256i last_row = _mm256_set1_epi32(static_cast<int32_t>(run.height_px - 1));
  const __m256i base_us = _mm256_set1_epi64x(run.base_us);
  const __m256i eleven_bits = _mm256_set1_epi32(0x7ff);
  const __m256i lane_before = _mm256_setr_epi32(0, 0, 1, 2, 3, 4, 5, 6);
  __m256i low = _mm256_set1_epi32(static_cast<int32_t>(run.low_us));
  Event* next = cursor;
  size_t index = 0;
  while (count - index >= kLanes && next < limit) {
    const __m256i block = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(words + 4 * index));
    const __m256i lows = _mm256_and_si256(_mm256_srli_epi32(block, 22), _mm256_set1_epi32(0x3f));
    const __m256i x = _mm256_and_si256(_mm256_srli_epi32(block, 11), eleven_bits);
    const __m256i y = _mm256_and_si256(block, eleven_bits);
    const __m256i lows_before = _mm256_blend_epi32(_mm256_permutevar8x32_epi32(lows, lane_before), low, 1);
    const __m256i type = _mm256_srli_epi32(block, 28);
    const __m256i outside = _mm256_or_si256(_mm256_cmpgt_epi32(x, last_column), _mm256_cmpgt_epi32(y, last_row));
    const __m256i special =
        _mm256_or_si256(_mm256_cmpgt_epi32(lows_before, lows), _mm256_cmpgt_epi32(type, _mm256_set1_epi32(1)));
    const __m256i xy = _mm256_or_si256(x, _mm256_slli_epi32(y, 16));
    // A 64-bit lane holds two words: first the even ones, then the odd ones.
    const __m256i low_half = _mm256_set1_epi64x(0xffffffff);
    const __m256i high_half = _mm256_slli_epi64(low_half, 32);
    const __m256i even_t = _mm256_add_epi64(_mm256_and_si256(lows, low_half), base_us);
    const __m256i odd_t = _mm256_add_epi64(_mm256_srli_epi64(lows, 32), base_us);
    const __m256i even_rest = _mm256_or_si256(_mm256_and_si256(xy, low_half), _mm256_slli_epi64(type, 32));
    const __m256i odd_rest = _mm256_or_si256(_mm256_srli_epi64(xy, 32), _mm256_and_si256(type, high_half));
    const __m256i e04 = _mm256_unpacklo_epi64(even_t, even_rest);
    const __m256i e26 = _mm256_unpackhi_epi64(even_t, even_rest);
    const __m256i e15 = _mm256_unpacklo_epi64(odd_t, odd_rest);
    const __m256i e37 = _mm256_unpackhi_epi64(odd_t, odd_rest);
    auto* const out = reinterpret_cast<__m256i*>(next);
    _mm256_storeu_si256(out, _mm256_permute2x128_si256(e04, e15, 0x20));
    _mm256_storeu_si256(out + 1, _mm256_permute2x128_si256(e26, e37, 0x20));
    _mm256_storeu_si256(out + 2, _mm256_permute2x128_si256(e04, e15, 0x31));
    _mm256_storeu_si256(out + 3, _mm256_permute2x128_si256(e26, e37, 0x31));
    const auto stops =
        static_cast<uint32_t>(_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_or_si256(outside, special))));
    const int num_plain = std::countr_zero(stops | 1u << kLanes);
    if (num_plain < kLanes) {
      next += num_plain;
      index += static_cast<size_t>(num_plain);
      break;
    }
    // Constants, so that the next block does not depend on the content of this one.
    next += kLanes;
    index += kLanes;
    low = _mm256_permutevar8x32_epi32(lows, _mm256_set1_epi32(kLanes - 1));
  }
  if (next != cursor) run.low_us = next[-1].t_us - run.base_us;
  cursor = next;
  return index;
}

// The fields of EVT2.1 words, one in each 64-bit lane.
struct Evt21Fields {
  __m256i low;
  __m256i x;  // column of the only pixel of the mask
  __m256i y;
  __m256i type;
  __m256i has_one_pixel;
};

[[gnu::target("avx2"), gnu::always_inline]] inline Evt21Fields Fields(__m256i block) {
  const __m256i eleven_bits = _mm256_set1_epi64x(0x7ff);
  const __m256i zero = _mm256_setzero_si256();
  const __m256i mask = _mm256_and_si256(block, _mm256_set1_epi64x(0xffffffff));
  const __m256i more = _mm256_and_si256(mask, _mm256_sub_epi64(mask, _mm256_set1_epi64x(1)));
  // The bit number of a power of two is its exponent as a float; bit 31 gives a negative number, whose sign is cut off.
  const __m256i exponents = _mm256_srli_epi32(_mm256_castps_si256(_mm256_cvtepi32_ps(mask)), 23);
  const __m256i pixel =
      _mm256_sub_epi64(_mm256_and_si256(exponents, _mm256_set1_epi64x(0xff)), _mm256_set1_epi64x(127));
  return {_mm256_and_si256(_mm256_srli_epi64(block, 32 + 22), _mm256_set1_epi64x(0x3f)),
          _mm256_add_epi64(_mm256_and_si256(_mm256_srli_epi64(block, 32 + 11), eleven_bits), pixel),
          _mm256_and_si256(_mm256_srli_epi64(block, 32), eleven_bits), _mm256_srli_epi64(block, 32 + 28),
          _mm256_andnot_si256(_mm256_cmpeq_epi64(mask, zero), _mm256_cmpeq_epi64(more, zero))};
}

[[gnu::target("avx2,popcnt")]] size_t DecodeEvt21Run256(const uint8_t* words, size_t count, Evt2Run& run,
                                                        Event*& cursor, const Event* limit) {
  constexpr int kWords = 4;
  const __m256i last_column = _mm256_set1_epi64x(run.width_px - 1);
  const __m256i last_row = _mm256_set1_epi64x(run.height_px - 1);
  const __m256i base_us = _mm256_set1_epi64x(run.base_us);
  __m256i low = _mm256_set1_epi64x(run.low_us);
  Event* next = cursor;
  size_t index = 0;
  while (count - index >= kWords && next < limit) {
    const Evt21Fields fields = Fields(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(words + 8 * index)));
    const __m256i lows_before =
        _mm256_blend_epi32(_mm256_permute4x64_epi64(fields.low, _MM_SHUFFLE(2, 1, 0, 0)), low, 3);
    const __m256i outside =
        _mm256_or_si256(_mm256_cmpgt_epi64(fields.x, last_column), _mm256_cmpgt_epi64(fields.y, last_row));
    const __m256i special = _mm256_or_si256(_mm256_cmpgt_epi64(lows_before, fields.low),
                                            _mm256_cmpgt_epi64(fields.type, _mm256_set1_epi64x(1)));
    const __m256i plain = _mm256_andnot_si256(_mm256_or_si256(outside, special), fields.has_one_pixel);
    const __m256i xy = _mm256_or_si256(fields.x, _mm256_slli_epi64(fields.y, 16));
    StoreFour(next, _mm256_add_epi64(fields.low, base_us), _mm256_or_si256(xy, _mm256_slli_epi64(fields.type, 32)));
    const int num_plain = std::countr_one(static_cast<uint32_t>(_mm256_movemask_pd(_mm256_castsi256_pd(plain))));
    if (num_plain < kWords) {
      next += num_plain;
      index += static_cast<size_t>(num_plain);
      break;
    }
    // Constants, so that the next block does not depend on the content of this one.
    next += kWords;
    index += kWords;
    low = _mm256_permute4x64_epi64(fields.low, _MM_SHUFFLE(3, 3, 3, 3));
  }
  if (next != cursor) run.low_us = next[-1].t_us - run.base_us;
  cursor = next;
  return index;
}

constexpr WordRuns kAvx2WordRuns = {DecodeEvt3Run256, DecodeEvt2Run256, DecodeEvt21Run256};

}  // namespace

const WordRuns* Avx2WordRuns() {
  static const bool has = __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("popcnt") != 0;
  return has ? &kAvx2WordRuns : nullptr;
}

#else

const WordRuns* Avx2WordRuns() { return nullptr; }

#endif

}  // namespace evpose
