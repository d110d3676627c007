// SPDX-License-Identifier: Apache-2.0

// Hot loops compiled for several instruction sets, of which each processor takes its best. Products and sums are never
// fused, and lanes are rounded one by one: the bits are the same whatever the set.
#pragma once

// Not under a sanitizer: the choice is made before its runtime is there.
#if defined(__x86_64__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define EVPOSE_CLONES __attribute__((target_clones("default", "avx2", "arch=x86-64-v4")))
#else
#define EVPOSE_CLONES
#endif
