// SPDX-License-Identifier: Apache-2.0

// Progress on standard error: a bar on a terminal, otherwise a line from time to time.
#pragma once

#include <optional>
#include <string>

#include "absl/time/time.h"
#include "client/cli/common/cli_context.h"

namespace evpose::client {

// Not thread-safe.
class ProgressLine {
 public:
  explicit ProgressLine(CliContext& context) : context_(context) {}
  ~ProgressLine() { Clear(); }

  // `ratio` is in [0, 1], or negative if the end is unknown. Draws at most ten times per second on a terminal, and
  // prints a line every five seconds otherwise, so that callers can call it at any rate.
  void Show(double ratio, const std::string& text);
  // Removes the bar.
  void Clear();

 private:
  CliContext& context_;
  std::optional<absl::Time> shown_at_;
  bool is_drawn_ = false;
};

}  // namespace evpose::client
