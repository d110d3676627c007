// SPDX-License-Identifier: Apache-2.0

// Which of many to take when only so many can be: chosen at random, always in the same way.
#pragma once

#include <cstddef>

#include "core/numerics/random.h"

namespace evpose {

// Selection sampling (Knuth, The Art of Computer Programming 2, 3.4.2, algorithm S): exactly min(total, wanted) of
// `total` calls answer true, every choice as likely as any other. A regular stride would beat with the sensor's rows.
class EvenSample {
 public:
  EvenSample(size_t total, size_t wanted) : left_(total), wanted_(wanted) {}

  bool Takes() {
    const bool takes = wanted_ >= left_ || random_.UniformInt(left_) < wanted_;
    --left_;
    if (takes && wanted_ > 0) --wanted_;
    return takes;
  }

 private:
  size_t left_;
  size_t wanted_;
  Random random_{1};
};

}  // namespace evpose
