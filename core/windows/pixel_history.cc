// SPDX-License-Identifier: Apache-2.0
#include "core/windows/pixel_history.h"

#include <algorithm>

#include "core/base/yield_point.h"

namespace evpose {
namespace {

// Saved format: a pixel has one of three states, so five pixels fit into one byte with values up to 3^5 - 1 = 242. The
// byte 255 and a varint n repeat the previous byte n times, because large parts of an image may have no event yet.
constexpr size_t kGroup = 5;        // pixels per byte
constexpr uint32_t kStates = 3;     // states of a pixel: OFF, ON, no event yet
constexpr uint8_t kMaxGroup = 242;  // 3^5 - 1
constexpr uint8_t kRepeat = 255;    // the marker of a repetition, which is no group
constexpr size_t kMinRun = 3;       // repetitions; shorter runs need as many bytes without the marker

// The yield points of the writer alone are too rare: a long run of equal groups takes few bytes.
constexpr size_t kGroupsBetweenYields = 4096;

}  // namespace

void PixelHistory::SaveState(StateWriter& writer) const {
  size_t run = 0;  // number of further groups equal to the last one written
  uint8_t last = kRepeat;
  const auto end_run = [&] {
    if (run >= kMinRun) {
      writer.Raw(&kRepeat, 1);
      writer.Varint(run);
    } else {
      for (size_t i = 0; i < run; ++i) writer.Raw(&last, 1);
    }
    run = 0;
  };
  for (size_t begin = 0; begin < num_pixels(); begin += kGroup) {
    if (begin % (kGroup * kGroupsBetweenYields) == 0) YieldPoint();
    uint32_t states = 0;
    for (size_t i = begin; i < std::min(begin + kGroup, num_pixels()); ++i) states = states * kStates + StateOf(i);
    const auto group = static_cast<uint8_t>(states);
    if (group == last) {
      ++run;
      continue;
    }
    end_run();
    writer.Raw(&group, 1);
    last = group;
  }
  end_run();
}

void PixelHistory::LoadState(StateReader& reader) {
  uint64_t run = 0;
  uint8_t last = kRepeat;
  for (size_t begin = 0; begin < num_pixels() && reader.ok(); begin += kGroup) {
    if (run > 0) {
      --run;
    } else {
      uint8_t byte = 0;
      reader.Raw(&byte, 1);
      if (byte == kRepeat) {
        reader.Varint(run);
        reader.Check(last <= kMaxGroup && run > 0, "a repetition of pixel states follows no group");
        --run;
      } else {
        last = byte;
      }
    }
    uint32_t states = last;
    for (size_t i = std::min(begin + kGroup, num_pixels()); i-- > begin; states /= kStates) {
      last_[i / 4] = static_cast<uint8_t>(last_[i / 4] ^ (StateOf(i) ^ states % kStates) << 2 * (i % 4));
    }
    reader.Check(states == 0, "a group of pixel states is invalid");
  }
  reader.Check(run == 0, "there are more pixel states than the sensor has pixels");
}

}  // namespace evpose
