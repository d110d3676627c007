// SPDX-License-Identifier: Apache-2.0

// Keeps one large block of memory between executions. Assimp allocates a buffer of 16 MB for every OBJ file, and
// AddressSanitizer requests such a block from the system and returns it each time: 4096 page faults, which took three
// quarters of the target's time. The kept block has the sanitizer's redzones while it is used and is poisoned while it
// is free; all other blocks are allocated by the sanitizer.
#include <sanitizer/asan_interface.h>

#include <cstddef>
#include <new>

#include "tests/fuzz/require.h"

namespace evpose {
namespace {

constexpr std::size_t kKeptBytes = 4096 * 4096;

// Not synchronized, because the target has one thread.
constinit void* kept_block = nullptr;
constinit bool kept_block_is_used = false;

void* TakeKeptBlock() {
  if (kept_block == nullptr) kept_block = ::operator new(kKeptBytes, std::nothrow);
  __asan_unpoison_memory_region(kept_block, kKeptBytes);
  kept_block_is_used = true;
  return kept_block;
}

void GiveKeptBlockBack() {
  EVPOSE_FUZZ_REQUIRE(kept_block_is_used);
  __asan_poison_memory_region(kept_block, kKeptBytes);
  kept_block_is_used = false;
}

}  // namespace
}  // namespace evpose

void operator delete(void* block, std::size_t size, std::align_val_t alignment) noexcept;  // not declared by clang 14

// Other requests are forwarded to the sanitizer's operators of the same kind with one more argument, so that it still
// detects mismatched deallocation and wrong sizes.
void* operator new(std::size_t size) {
  if (size == evpose::kKeptBytes && !evpose::kept_block_is_used) return evpose::TakeKeptBlock();
  return ::operator new(size, std::nothrow);
}
void operator delete(void* block) noexcept {
  if (block != nullptr && block == evpose::kept_block) return evpose::GiveKeptBlockBack();
  ::operator delete(block, std::nothrow);
}
void operator delete(void* block, std::size_t size) noexcept {
  if (block == nullptr || block != evpose::kept_block) return ::operator delete (block, size, std::align_val_t{1});
  EVPOSE_FUZZ_REQUIRE(size == evpose::kKeptBytes);
  evpose::GiveKeptBlockBack();
}
