// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/help.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <memory>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "core/command_line/usage_message.h"
#include "core/command_line/wrap.h"

namespace evpose {
namespace {

// Columns: a narrower terminal breaks words, longer lines are hard to read.
constexpr size_t kMinWidth = 40;
constexpr size_t kDefaultWidth = 80;
constexpr size_t kMaxWidth = 100;
constexpr size_t kIndentation = 2;
constexpr size_t kTextColumn = 26;  // of the descriptions of options

void AppendLines(const std::vector<std::string>& lines, size_t indentation, std::string& text) {
  for (const std::string& line : lines) absl::StrAppend(&text, std::string(indentation, ' '), line, "\n");
}

// A term with its text in a column; a term that reaches into the column has lines of its own.
void AppendEntry(const std::string& term, const std::string& description, size_t column, size_t width,
                 std::string& text) {
  const std::vector<std::string> lines = WrapWords(description, width - column);
  const bool fits = kIndentation + term.size() + 2 <= column;
  if (!fits || lines.empty()) {
    AppendLines(WrapWords(term, width - kIndentation), kIndentation, text);
    AppendLines(lines, column, text);
    return;
  }
  absl::StrAppend(&text, std::string(kIndentation, ' '), term, std::string(column - kIndentation - term.size(), ' '),
                  lines.front(), "\n");
  AppendLines({lines.begin() + 1, lines.end()}, column, text);
}

// The column after the longest of the terms, at most kTextColumn.
template <typename Items, typename Term>
size_t ColumnAfter(const Items& items, const Term& term_of) {
  size_t longest = 0;
  for (const auto& item : items) longest = std::max(longest, term_of(item).size());
  return std::min(kTextColumn, kIndentation + longest + 2);
}

void AppendEntries(const std::vector<HelpNote>& entries, size_t width, std::string& text) {
  const size_t column = ColumnAfter(entries, [](const HelpNote& entry) { return entry.term; });
  for (const HelpNote& entry : entries) AppendEntry(entry.term, entry.text, column, width, text);
}

void AppendNotes(const std::vector<HelpNote>& notes, size_t width, std::string& text) {
  for (size_t i = 0; i < notes.size();) {
    if (notes[i].term.empty()) {
      absl::StrAppend(&text, "\n");
      AppendLines(WrapWords(notes[i].text, width), 0, text);
      ++i;
      continue;
    }
    std::vector<HelpNote> entries;
    for (; i < notes.size() && !notes[i].term.empty(); ++i) entries.push_back(notes[i]);
    AppendEntries(entries, width, text);
  }
}

void AppendCommands(const HelpPage& page, size_t width, std::string& text) {
  std::vector<HelpCommand> all;
  for (const HelpCommandGroup& group : page.commands)
    all.insert(all.end(), group.commands.begin(), group.commands.end());
  const size_t column = ColumnAfter(all, [](const HelpCommand& command) { return command.name; });
  for (const HelpCommandGroup& group : page.commands) {
    absl::StrAppend(&text, "\n", group.title, ":\n");
    for (const HelpCommand& each : group.commands) AppendEntry(each.name, each.description, column, width, text);
  }
}

void AppendUsages(const HelpPage& page, size_t width, std::string& text) {
  constexpr absl::string_view kTitle = "Usage: ";
  constexpr size_t kMaxIndentation = 16;  // of the lines that continue a usage, which are below the first argument
  const size_t indentation = std::min(kTitle.size() + page.name.size() + 1, kMaxIndentation);
  for (const std::string& words : page.usages) {
    const std::vector<std::string> lines = WrapWords(absl::StrCat(page.name, " ", words), width - indentation);
    const bool is_first = &words == &page.usages.front();
    absl::StrAppend(&text, is_first ? "\n" : "", is_first ? kTitle : std::string(kTitle.size(), ' '), lines.front(),
                    "\n");
    AppendLines({lines.begin() + 1, lines.end()}, indentation, text);
  }
}

class ProjectFormatter final : public CLI::FormatterBase {
 public:
  std::string make_help(const CLI::App* app, std::string, CLI::AppFormatMode) const override {
    return FormatHelp(DescribeCommand(*app), TextWidth(STDOUT_FILENO));
  }
};

}  // namespace

std::string FormatHelp(const HelpPage& page, size_t width) {
  std::string text;
  AppendLines(WrapWords(page.description, width), 0, text);
  AppendUsages(page, width, text);
  AppendCommands(page, width, text);
  for (const HelpGroup& group : page.groups) {
    absl::StrAppend(&text, "\n", group.title, ":\n");
    for (const HelpOption& option : group.options) AppendEntry(option.Term(), option.Text(), kTextColumn, width, text);
  }
  AppendNotes(page.notes, width, text);
  absl::StrAppend(&text, "\nExit status:\n");
  AppendEntries(page.exit_statuses, width, text);
  if (!page.examples.empty()) absl::StrAppend(&text, "\nExample:\n");
  for (const HelpExample& line : page.examples) {
    if (line.is_command) AppendLines(WrapCommand(line.text, width - kIndentation), kIndentation, text);
    if (!line.is_command) AppendLines(WrapWords(line.text, width), 0, text);
  }
  return text;
}

size_t TerminalColumns(int descriptor) {
  winsize size = {};
  return ioctl(descriptor, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : kDefaultWidth;
}

size_t TextWidth(int descriptor) {
  size_t width = 0;
  const char* const columns = std::getenv("COLUMNS");
  if (columns == nullptr || !absl::SimpleAtoi(columns, &width) || width == 0) width = TerminalColumns(descriptor);
  return std::clamp(width, kMinWidth, kMaxWidth);
}

void UseHelp(CLI::App& program) {
  program.formatter(std::make_shared<ProjectFormatter>());
  if (program.get_help_ptr() != nullptr) program.get_help_ptr()->description("Print this help");
  if (program.get_version_ptr() != nullptr) program.get_version_ptr()->description("Print the version");
  for (CLI::App* const below : program.get_subcommands([](CLI::App*) { return true; })) UseHelp(*below);
}

std::optional<int> ParseOrAnswer(CLI::App& program, int argc, const char* const* argv) {
  constexpr int kWrongUsage = 2;
  program.failure_message(
      [](const CLI::App* parser, const CLI::Error& error) { return UsageMessage(*parser, error) + "\n"; });
  try {
    program.parse(argc, argv);
    return std::nullopt;
  } catch (const CLI::ParseError& error) {
    return program.exit(error) == 0 ? 0 : kWrongUsage;
  }
}

int RunProgram(absl::string_view name, absl::FunctionRef<absl::StatusOr<int>()> run) {
  constexpr int kFailed = 1;
  try {
    const absl::StatusOr<int> status = run();
    if (status.ok()) return *status;
    std::cerr << name << ": " << status.status().message() << std::endl;
  } catch (const std::exception& error) {
    std::cerr << name << ": " << error.what() << std::endl;
  }
  return kFailed;
}

}  // namespace evpose
