// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/man_page.h"

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "core/command_line/wrap.h"

namespace evpose {
namespace {

// Columns: with the indentation of a manual page, an example fits a terminal of 80 columns.
constexpr size_t kExampleWidth = 72;

// Text in which no character has a meaning for roff. A hyphen that may be copied to a shell is a minus.
std::string Escape(absl::string_view text) {
  std::string escaped = absl::StrReplaceAll(
      text,
      {{"\\", "\\(rs"}, {"-", "\\-"}, {"^", "\\(ha"}, {"~", "\\(ti"}, {"`", "\\(ga"}, {"'", "\\(aq"}, {"\"", "\\(dq"}});
  const bool is_request = absl::StartsWith(escaped, ".");
  return is_request ? absl::StrCat("\\&", escaped) : escaped;
}

std::string Bold(absl::string_view text) { return absl::StrCat("\\fB", Escape(text), "\\fR"); }
std::string Italic(absl::string_view text) { return absl::StrCat("\\fI", Escape(text), "\\fR"); }

// Lines of source are short, as editors and diffs expect.
void AppendText(absl::string_view words, std::string& text) {
  for (const std::string& line : WrapWords(words, kExampleWidth)) absl::StrAppend(&text, Escape(line), "\n");
}

void AppendSection(absl::string_view title, std::string& text) {
  absl::StrAppend(&text, ".SH ", absl::AsciiStrToUpper(title), "\n");
}

void AppendEntry(const std::string& term, const std::string& description, std::string& text) {
  absl::StrAppend(&text, ".TP\n", term, "\n");
  AppendText(description, text);
}

std::string OptionTerm(const HelpOption& option) {
  if (option.is_positional()) return Italic(option.Term());
  const std::string names =
      absl::StrJoin(option.names, ", ", [](std::string* out, const std::string& name) { *out += Bold(name); });
  return option.value.empty() ? names : absl::StrCat(names, " ", Italic(option.value));
}

void AppendCommands(const HelpPage& page, std::string& text) {
  if (page.commands.empty()) return;
  AppendSection("Commands", text);
  for (const HelpCommandGroup& group : page.commands) {
    if (page.commands.size() > 1) absl::StrAppend(&text, ".SS ", Escape(group.title), "\n");
    for (const HelpCommand& command : group.commands) AppendEntry(Bold(command.name), command.description, text);
  }
}

void AppendNotes(const std::vector<HelpNote>& notes, std::string& text) {
  if (notes.empty()) return;
  AppendSection("Notes", text);
  for (const HelpNote& note : notes) {
    if (!note.term.empty()) {
      AppendEntry(Bold(note.term), note.text, text);
      continue;
    }
    if (!absl::EndsWith(text, "NOTES\n")) absl::StrAppend(&text, ".PP\n");
    AppendText(note.text, text);
  }
}

void AppendExamples(const std::vector<HelpExample>& examples, std::string& text) {
  if (examples.empty()) return;
  AppendSection("Examples", text);
  bool is_open = false;
  for (const HelpExample& line : examples) {
    if (line.is_command != is_open) absl::StrAppend(&text, is_open ? ".EE\n.PP\n" : ".EX\n");
    is_open = line.is_command;
    if (!line.is_command) AppendText(line.text, text);
    if (!line.is_command) continue;
    for (const std::string& part : WrapCommand(line.text, kExampleWidth)) absl::StrAppend(&text, Escape(part), "\n");
  }
  if (is_open) absl::StrAppend(&text, ".EE\n");
}

// "Print the poses" as the last part of the line of NAME, in which apropos searches.
std::string NameDescription(const HelpPage& page) {
  std::string text = page.description.substr(0, page.description.find(". "));
  if (text.size() > 1 && absl::ascii_islower(text[1])) text[0] = absl::ascii_tolower(text[0]);
  return text;
}

}  // namespace

std::string ManPageName(const HelpPage& page) { return absl::StrReplaceAll(page.name, {{" ", "-"}}); }

std::string FormatManPage(const HelpPage& page, int section, const std::string& version,
                          const std::vector<std::string>& see_also) {
  const std::string name = ManPageName(page);
  std::string text = absl::StrCat(".TH ", absl::AsciiStrToUpper(Escape(name)), " ", section, " \"\" \"evpose ", version,
                                  "\" \"evpose manual\"\n.ad l\n.nh\n");
  AppendSection("Name", text);
  absl::StrAppend(&text, Escape(name), " \\- ", Escape(NameDescription(page)), "\n");
  AppendSection("Synopsis", text);
  for (const std::string& usage : page.usages) {
    absl::StrAppend(&text, &usage == &page.usages.front() ? "" : ".br\n", Bold(page.name), " ", Escape(usage), "\n");
  }
  AppendSection("Description", text);
  AppendText(absl::StrCat(page.description, "."), text);
  AppendCommands(page, text);
  AppendSection("Options", text);
  for (const HelpGroup& group : page.groups) {
    absl::StrAppend(&text, ".SS ", Escape(group.title), "\n");
    for (const HelpOption& option : group.options) AppendEntry(OptionTerm(option), option.Text(), text);
  }
  AppendNotes(page.notes, text);
  AppendSection("Exit status", text);
  for (const HelpNote& status : page.exit_statuses) AppendEntry(Bold(status.term), status.text, text);
  AppendExamples(page.examples, text);
  if (see_also.empty()) return text;
  AppendSection("See also", text);
  const auto append_bold = [](std::string* out, const std::string& other) {
    const size_t bracket = other.find('(');
    absl::StrAppend(out, Bold(other.substr(0, bracket)), other.substr(bracket));
  };
  absl::StrAppend(&text, absl::StrJoin(see_also, ",\n", append_bold), "\n");
  return text;
}

}  // namespace evpose
