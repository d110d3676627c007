// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/wrap.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"

namespace evpose {
namespace {

// The words of a command; a quoted part belongs to one word, and the value of an option to the option.
std::vector<std::string> CommandWords(absl::string_view command) {
  std::vector<std::string> words;
  std::string word;
  bool is_option = false;
  const auto add = [&] {
    if (word.empty()) return;
    const bool is_value = is_option && word[0] != '-' && word[0] != '|' && word[0] != '>';
    is_option = absl::StartsWith(word, "--");
    if (is_value) {
      absl::StrAppend(&words.back(), " ", word);
    } else {
      words.push_back(word);
    }
    word.clear();
  };
  char quote = '\0';
  for (const char c : command) {
    if (c == quote) {
      quote = '\0';
    } else if (quote == '\0' && (c == '"' || c == '\'')) {
      quote = c;
    }
    if (c != ' ' || quote != '\0') {
      word.push_back(c);
    } else {
      add();
    }
  }
  add();
  return words;
}

}  // namespace

std::vector<std::string> WrapWords(absl::string_view text, size_t width) {
  std::vector<std::string> lines;
  for (const absl::string_view word : absl::StrSplit(text, absl::ByAnyChar(" \n"), absl::SkipEmpty())) {
    if (!lines.empty() && lines.back().size() + 1 + word.size() <= width) {
      absl::StrAppend(&lines.back(), " ", word);
    } else {
      lines.emplace_back(word);
    }
  }
  return lines;
}

std::vector<std::string> WrapCommand(absl::string_view command, size_t width) {
  std::vector<std::string> lines;
  const std::vector<std::string> words = CommandWords(command);
  for (size_t i = 0; i < words.size(); ++i) {
    // A line that is not the last has a backslash.
    const size_t end = i + 1 < words.size() ? 2 : 0;
    if (!lines.empty() && lines.back().size() + 1 + words[i].size() + end <= width) {
      absl::StrAppend(&lines.back(), " ", words[i]);
      continue;
    }
    if (!lines.empty()) absl::StrAppend(&lines.back(), " \\");
    lines.push_back(absl::StrCat(lines.empty() ? "" : "  ", words[i]));
  }
  return lines;
}

}  // namespace evpose
