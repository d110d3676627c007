// SPDX-License-Identifier: Apache-2.0
#include "core/windows/pixel_history.h"

#include <algorithm>

namespace evpose {
namespace {

// Saved format: a pixel has one of three states, so five pixels fit into one byte with values up to 3^5 - 1 = 242. The
// byte 255 and a varint n repeat the previous byte n times, because large parts of an image may have no event yet.
constexpr size_t kGroup = 5;        // pixels per byte
constexpr uint32_t kStates = 3;     // states of a pixel: 0, 1, kNothing
constexpr uint8_t kMaxGroup = 242;  // 3^5 - 1
constexpr uint8_t kRepeat = 255;    // the marker of a repetition, which is no group
constexpr size_t kMinRun = 3;       // repetitions; shorter runs need as many bytes without the marker

uint8_t PackGroup(const uint8_t* pixels, size_t count) {
  uint32_t group = 0;
  for (size_t i = 0; i < count; ++i) group = group * kStates + pixels[i];
  return static_cast<uint8_t>(group);
}

// Unpacks a group of `count` pixels. Returns false if the byte is no such group.
bool UnpackGroup(uint8_t group, uint8_t* pixels, size_t count) {
  for (size_t i = count; i-- > 0; group /= kStates) pixels[i] = group % kStates;
  return group == 0;
}

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
  for (size_t begin = 0; begin < last_.size(); begin += kGroup) {
    const uint8_t group = PackGroup(&last_[begin], std::min(kGroup, last_.size() - begin));
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
  for (size_t begin = 0; begin < last_.size() && reader.ok(); begin += kGroup) {
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
    const bool is_good = UnpackGroup(last, &last_[begin], std::min(kGroup, last_.size() - begin));
    reader.Check(is_good, "a group of pixel states is invalid");
  }
  reader.Check(run == 0, "there are more pixel states than the sensor has pixels");
}

}  // namespace evpose
