// SPDX-License-Identifier: Apache-2.0

// Assertions of the fuzz targets. An assertion that fails aborts the program, which the fuzzer reports as a finding.
#pragma once

#include <cstdio>
#include <cstdlib>

#define EVPOSE_FUZZ_REQUIRE(condition)                                                    \
  do {                                                                                    \
    if (!(condition)) {                                                                   \
      std::fprintf(stderr, "%s:%d: does not hold: %s\n", __FILE__, __LINE__, #condition); \
      std::abort();                                                                       \
    }                                                                                     \
  } while (false)
