// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/progress.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace evpose::client {
namespace {

constexpr size_t kBarWidth = 24;  // columns: the line with the other numbers fits a terminal of 80
constexpr absl::Duration kRedraw = absl::Milliseconds(100);  // shorter times are not seen, and cost output
constexpr absl::Duration kLineEvery = absl::Seconds(5);      // where a line cannot be replaced, as in a log file
// Before this time and this share of the work, an estimate of the time left would depend mostly on the first steps.
constexpr absl::Duration kSettled = absl::Seconds(2);
constexpr double kSettledRatio = 0.02;

std::string Bar(double ratio) {
  if (ratio < 0.0) return "";
  const size_t filled = static_cast<size_t>(std::min(ratio, 1.0) * kBarWidth);
  return absl::StrCat("[", std::string(filled, '#'), std::string(kBarWidth - filled, '.'), "] ");
}

// Cuts a text of parts with two spaces between them to at most this size, after a part if the first one fits.
std::string CutAfterAPart(const std::string& text, size_t max_size) {
  if (text.size() <= max_size) return text;
  const size_t end = text.rfind("  ", max_size);
  return text.substr(0, end == std::string::npos || end == 0 ? max_size : end);
}

}  // namespace

std::string DescribeTimeLeft(absl::Duration left) {
  const double seconds = absl::ToDoubleSeconds(left);
  if (seconds < 99.5) return absl::StrFormat("%.0f s left", seconds);
  if (seconds < 99.5 * 60.0) return absl::StrFormat("%.0f min left", seconds / 60.0);
  return absl::StrFormat("%.1f h left", seconds / 3600.0);
}

std::string ProgressLine::TimeLeft(double ratio, absl::Time now) {
  if (!began_at_ || ratio < ratio_) {
    began_at_ = now;
    begin_ratio_ = ratio;
  }
  ratio_ = ratio;
  const double done = ratio - begin_ratio_;
  const absl::Duration elapsed = now - *began_at_;
  if (ratio < 0.0 || done < kSettledRatio || elapsed < kSettled) return "";
  return absl::StrCat("  ", DescribeTimeLeft(elapsed * ((1.0 - std::min(ratio, 1.0)) / done)));
}

void ProgressLine::Show(double ratio, const std::string& text) {
  const absl::Time now = clock_.Now();
  const std::string left = TimeLeft(ratio, now);
  // Work that ends before the first line is due prints no line.
  if (!shown_at_) shown_at_ = context_.is_err_terminal ? absl::InfinitePast() : now;
  if (now - *shown_at_ < (context_.is_err_terminal ? kRedraw : kLineEvery)) return;
  shown_at_ = now;
  if (!context_.is_err_terminal) {
    context_.err << text << left << std::endl;
    return;
  }
  // A line that is longer than the terminal could not be rewritten.
  const size_t width = context_.err_columns - 1;
  std::string line = absl::StrCat(Bar(ratio), text, left);
  if (line.size() > width) line = absl::StrCat(CutAfterAPart(text, width - std::min(width, left.size())), left);
  context_.err << "\r\x1b[K" << line.substr(0, width) << std::flush;
  is_drawn_ = true;
}

void ProgressLine::Clear() {
  if (is_drawn_) context_.err << "\r\x1b[K" << std::flush;
  is_drawn_ = false;
}

}  // namespace evpose::client
