// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/allocation_counter.h"

#include <execinfo.h>
#include <malloc.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstdlib>

// The functions of glibc itself; a program may define the public ones.
// NOLINTBEGIN(bugprone-reserved-identifier): their names
extern "C" {
void* __libc_malloc(size_t size);
void* __libc_calloc(size_t count, size_t size);
void* __libc_realloc(void* memory, size_t size);
void* __libc_memalign(size_t alignment, size_t size);
}
// NOLINTEND(bugprone-reserved-identifier)

namespace evpose::bench {
namespace {

constexpr int kMaxFrames = 24;

std::atomic<bool> g_is_counting = false;
std::atomic<size_t> g_count = 0;
std::array<void*, kMaxFrames> g_origin = {};
std::atomic<int> g_origin_frames = 0;

void Count() {
  if (!g_is_counting) return;
  if (g_count++ > 0) return;
  g_origin_frames = backtrace(g_origin.data(), kMaxFrames);
}

}  // namespace

AllocationCounter::AllocationCounter() {
  // The first call of backtrace() loads a library, which allocates; so it is made here, before counting.
  backtrace(g_origin.data(), kMaxFrames);
  g_count = 0;
  g_origin_frames = 0;
  g_is_counting = true;
}

AllocationCounter::~AllocationCounter() { g_is_counting = false; }

size_t AllocationCounter::count() const { return g_count; }

std::string AllocationCounter::FirstOrigin() const {
  g_is_counting = false;
  std::string text;
  char** const names = backtrace_symbols(g_origin.data(), g_origin_frames);
  for (int i = 0; names != nullptr && i < g_origin_frames; ++i) text.append(names[i]).append("\n");
  std::free(names);
  return text;
}

}  // namespace evpose::bench

extern "C" {

void* malloc(size_t size) noexcept {
  evpose::bench::Count();
  return __libc_malloc(size);
}
void* calloc(size_t count, size_t size) noexcept {
  evpose::bench::Count();
  return __libc_calloc(count, size);
}
void* realloc(void* memory, size_t size) noexcept {
  evpose::bench::Count();
  return __libc_realloc(memory, size);
}
void* memalign(size_t alignment, size_t size) noexcept {
  evpose::bench::Count();
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(size_t alignment, size_t size) noexcept {
  evpose::bench::Count();
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** memory, size_t alignment, size_t size) noexcept {
  evpose::bench::Count();
  *memory = __libc_memalign(alignment, size);
  return *memory == nullptr ? ENOMEM : 0;
}

}  // extern "C"
