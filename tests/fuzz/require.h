// SPDX-License-Identifier: Apache-2.0

// What a fuzz target claims: a claim that does not hold ends the program, which is a finding.
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
