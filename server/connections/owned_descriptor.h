// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <unistd.h>

namespace evpose::server {

// Closes the descriptor of a connection, also when an allocation fails.
class OwnedDescriptor {
 public:
  explicit OwnedDescriptor(int descriptor) : descriptor_(descriptor) {}
  ~OwnedDescriptor() {
    if (descriptor_ >= 0) close(descriptor_);
  }
  OwnedDescriptor(const OwnedDescriptor&) = delete;
  OwnedDescriptor& operator=(const OwnedDescriptor&) = delete;

  // Another object closes it.
  void Release() { descriptor_ = -1; }

 private:
  int descriptor_;
};

}  // namespace evpose::server
