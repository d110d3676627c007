// SPDX-License-Identifier: Apache-2.0

// Defines EVPOSE_SANITIZED in builds with AddressSanitizer or ThreadSanitizer: these reserve terabytes of address
// space, which cannot be limited, and their own memory grows with threads and cores. g++ and clang++ have different
// macros. A test that runs a sanitized program, but is not sanitized itself, gets the definition from its
// CMakeLists.txt.
#pragma once

#ifndef EVPOSE_SANITIZED
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define EVPOSE_SANITIZED
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define EVPOSE_SANITIZED
#endif
#endif
#endif
