// SPDX-License-Identifier: Apache-2.0
#include "core/windows/pixel_history.h"

#include <algorithm>
#include <string>

namespace evpose {
namespace {

// A pixel is one of three things: five pixels make a byte up to 242. What is left tells that the byte before it comes
// again, so many times: large parts of an image may have sent nothing yet.
constexpr size_t kGroup = 5;
constexpr uint32_t kStates = 3;
constexpr uint8_t kMaxGroup = 242;
constexpr uint8_t kRepeat = 255;
constexpr size_t kMinRun = 3;  // shorter ones take as much room

uint8_t PackGroup(const uint8_t* pixels, size_t count) {
  uint32_t group = 0;
  for (size_t i = 0; i < count; ++i) group = group * kStates + pixels[i];
  return static_cast<uint8_t>(group);
}

// False when that many pixels do not make such a group.
bool UnpackGroup(uint8_t group, uint8_t* pixels, size_t count) {
  for (size_t i = count; i-- > 0; group /= kStates) pixels[i] = group % kStates;
  return group == 0;
}

}  // namespace

void PixelHistory::SaveState(StateWriter& writer) const {
  size_t run = 0;  // of groups like the last, beyond it
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
        reader.Check(last <= kMaxGroup && run > 0, "pixels that repeat nothing");
        --run;
      } else {
        last = byte;
      }
    }
    const bool is_good = UnpackGroup(last, &last_[begin], std::min(kGroup, last_.size() - begin));
    reader.Check(is_good, "pixels that are in no state");
  }
  reader.Check(run == 0, "more pixels than the sensor has");
}

}  // namespace evpose
