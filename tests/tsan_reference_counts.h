// SPDX-License-Identifier: Apache-2.0

// Included first in the files that are compiled without ThreadSanitizer because they include gRPC
// (proto/CMakeLists.txt). The linker may choose their copies of std::shared_ptr's inline functions for instrumented
// code, too. So these functions report the order that the reference counts establish: a destruction is after the other
// releases.
#pragma once

extern "C" void __tsan_acquire(void* address);
extern "C" void __tsan_release(void* address);

// The macros that libstdc++ provides for race detectors (bits/c++config.h).
#define _GLIBCXX_SYNCHRONIZATION_HAPPENS_BEFORE(address) \
  __tsan_release(const_cast<void*>(static_cast<const void*>(address)))
#define _GLIBCXX_SYNCHRONIZATION_HAPPENS_AFTER(address) \
  __tsan_acquire(const_cast<void*>(static_cast<const void*>(address)))
