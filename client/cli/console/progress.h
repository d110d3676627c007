// SPDX-License-Identifier: Apache-2.0

// Progress on standard error: a line that is rewritten on a terminal, otherwise a line from time to time.
#pragma once

#include <optional>
#include <string>

#include "absl/time/time.h"
#include "client/cli/console/cli_context.h"
#include "evpose/clock.h"

namespace evpose::client {

// Not thread-safe.
class ProgressLine {
 public:
  // `context` and `clock` must outlive it.
  explicit ProgressLine(const CliContext& context, Clock& clock = SystemClock()) : context_(context), clock_(clock) {}
  ~ProgressLine() { Clear(); }

  // `ratio` is in [0, 1], or negative if the end is unknown; it decreases when another task begins. After a while the
  // time left is added to the text. On a terminal that is too narrow, the text is cut after one of its parts, between
  // which there are two spaces; the time left never is. Draws at most ten times per second on a terminal, and prints a
  // line every five seconds otherwise, without control characters, so that callers can call it at any rate.
  void Show(double ratio, const std::string& text);
  // Removes the line from a terminal.
  void Clear();

 private:
  // "  12 s left", or an empty text as long as it cannot be estimated.
  std::string TimeLeft(double ratio, absl::Time now);

  const CliContext& context_;
  Clock& clock_;
  std::optional<absl::Time> shown_at_;
  std::optional<absl::Time> began_at_;
  double begin_ratio_ = 0.0;
  double ratio_ = 0.0;
  bool is_drawn_ = false;
};

// "12 s left", "4 min left", "2.5 h left"
std::string DescribeTimeLeft(absl::Duration left);

}  // namespace evpose::client
