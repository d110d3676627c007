// SPDX-License-Identifier: Apache-2.0
#include "client/cli/common/progress.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

constexpr int kBarWidth = 24;
constexpr absl::Duration kRedraw = absl::Milliseconds(100);
constexpr absl::Duration kLineEvery = absl::Seconds(5);

std::string Bar(double ratio) {
  if (ratio < 0.0) return "";
  const size_t filled = static_cast<size_t>(std::min(ratio, 1.0) * kBarWidth);
  return absl::StrCat("[", std::string(filled, '#'), std::string(kBarWidth - filled, '.'), "] ");
}

}  // namespace

void ProgressLine::Show(double ratio, const std::string& text) {
  const absl::Time now = SystemClock().Now();
  // Work that ends before the first line is due prints no line.
  if (!shown_at_) shown_at_ = context_.is_err_terminal ? absl::InfinitePast() : now;
  if (now - *shown_at_ < (context_.is_err_terminal ? kRedraw : kLineEvery)) return;
  shown_at_ = now;
  if (context_.is_err_terminal) {
    context_.err << "\r\x1b[K" << Bar(ratio) << text << std::flush;
    is_drawn_ = true;
  } else {
    context_.err << text << std::endl;
  }
}

void ProgressLine::Clear() {
  if (is_drawn_) context_.err << "\r\x1b[K" << std::flush;
  is_drawn_ = false;
}

}  // namespace evpose::client
