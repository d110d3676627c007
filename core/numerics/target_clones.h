// SPDX-License-Identifier: Apache-2.0

// Compiles a hot loop for several instruction sets; the program loader chooses the best one that the processor has.
// The clones give the same bits: the build forbids fused multiply-adds (-ffp-contract=off), and vector instructions
// round each element like the scalar ones.
#pragma once

#include "core/base/sanitized.h"

// There are no clones under a sanitizer, because the loader makes the choice before the sanitizer's runtime is
// initialised, and none with clang, which builds with sanitizers only.
#if defined(__x86_64__) && !defined(__clang__) && !defined(EVPOSE_SANITIZED)
#define EVPOSE_CLONES __attribute__((target_clones("default", "avx2", "arch=x86-64-v4")))
#else
#define EVPOSE_CLONES
#endif
