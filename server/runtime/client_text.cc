// SPDX-License-Identifier: Apache-2.0
#include "server/runtime/client_text.h"

#include <algorithm>
#include <array>
#include <boost/locale/utf.hpp>
#include <iterator>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace evpose::server {
namespace {

using Utf8 = boost::locale::utf::utf_traits<char>;
using boost::locale::utf::code_point;

// Inclusive ranges: C0; DEL and C1; Arabic letter mark; zero-width characters and direction marks; separators of lines
// and paragraphs, embeddings and overrides of direction; invisible operators and isolates; byte order mark.
constexpr std::array<std::pair<code_point, code_point>, 7> kControls = {{{0x00, 0x1F},
                                                                         {0x7F, 0x9F},
                                                                         {0x061C, 0x061C},
                                                                         {0x200B, 0x200F},
                                                                         {0x2028, 0x202E},
                                                                         {0x2060, 0x206F},
                                                                         {0xFEFF, 0xFEFF}}};

}  // namespace

std::string Shortened(absl::string_view text) {
  const bool is_long = text.size() > kMaxNameBytes;
  return absl::StrCat(absl::CHexEscape(text.substr(0, kMaxNameBytes)), is_long ? "..." : "");
}

bool IsPlainText(absl::string_view text) {
  const char* position = text.data();
  const char* const end = position + text.size();
  while (position != end) {
    const code_point point = Utf8::decode(position, end);
    if (point == boost::locale::utf::illegal || point == boost::locale::utf::incomplete) return false;
    const bool is_control = std::any_of(kControls.begin(), kControls.end(), [point](const auto& range) {
      return range.first <= point && point <= range.second;
    });
    if (is_control) return false;
  }
  return true;
}

}  // namespace evpose::server
