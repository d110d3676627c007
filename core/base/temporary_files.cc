// SPDX-License-Identifier: Apache-2.0
#include "core/base/temporary_files.h"

#include <unistd.h>

#include <array>
#include <atomic>
#include <climits>
#include <cstring>

namespace evpose {
namespace {

enum class SlotState { kFree, kClaimed, kUsed };

// A signal handler may neither lock nor allocate: hence the fixed size.
struct Slot {
  std::atomic<SlotState> state = SlotState::kFree;
  std::array<char, PATH_MAX> path;
};
static_assert(std::atomic<SlotState>::is_always_lock_free, "a signal handler must not lock");

std::array<Slot, 16> g_slots;

}  // namespace

void RegisterTemporaryFile(const std::string& path) {
  if (path.size() >= PATH_MAX) return;
  for (Slot& slot : g_slots) {
    SlotState free = SlotState::kFree;
    if (!slot.state.compare_exchange_strong(free, SlotState::kClaimed)) continue;
    std::memcpy(slot.path.data(), path.c_str(), path.size() + 1);
    slot.state = SlotState::kUsed;
    return;
  }
}

void UnregisterTemporaryFile(const std::string& path) {
  for (Slot& slot : g_slots) {
    if (slot.state == SlotState::kUsed && path == slot.path.data()) slot.state = SlotState::kFree;
  }
}

void RemoveTemporaryFiles() {
  for (Slot& slot : g_slots) {
    if (slot.state == SlotState::kUsed) unlink(slot.path.data());
  }
}

}  // namespace evpose
