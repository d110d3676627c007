// SPDX-License-Identifier: Apache-2.0

// Work in a step of a session that the end of the server need not wait for.
#pragma once

namespace evpose::server {

// In its scope, a yield point (core/base/yield_point.h) ends the step by an exception after the scheduler has begun to
// end. What the work changes must be released by destructors, or must not be used afterwards; no destructor in the
// scope may reach a YieldPoint(). One scope for each thread at a time.
class ScopedEndableWork {
 public:
  ScopedEndableWork() { is_active = true; }
  ~ScopedEndableWork() { is_active = false; }
  ScopedEndableWork(const ScopedEndableWork&) = delete;
  ScopedEndableWork& operator=(const ScopedEndableWork&) = delete;

  static bool IsActive() { return is_active; }  // on the present thread

 private:
  static inline thread_local constinit bool is_active = false;
};

}  // namespace evpose::server
