// SPDX-License-Identifier: Apache-2.0

// Progress on standard error: a bar that is redrawn on a terminal, now and then a line elsewhere.
#pragma once

#include <optional>
#include <string>

#include "absl/time/time.h"
#include "client/cli/common/cli_context.h"

namespace evpose::client {

// One thread at a time.
class ProgressLine {
 public:
  explicit ProgressLine(CliContext& context) : context_(context) {}
  ~ProgressLine() { Clear(); }

  // `ratio` in [0, 1], or negative when the end is not known. Draws at most ten times a second on a terminal and
  // prints a line every five seconds elsewhere, so that callers need not count.
  void Show(double ratio, const std::string& text);
  // Removes the bar.
  void Clear();

 private:
  CliContext& context_;
  std::optional<absl::Time> shown_at_;
  bool is_drawn_ = false;
};

}  // namespace evpose::client
