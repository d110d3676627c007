// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/help_page.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"

namespace evpose {
namespace {

// If an option excludes more options than this, its description states so, and the facts of both sides do not.
constexpr size_t kMaxShownExclusions = 3;

// "1e+06" is printed as "1000000".
std::string PlainNumber(const std::string& text) {
  double number = 0.0;
  if (!absl::SimpleAtod(text, &number) || std::abs(number) > 1e9 || number != static_cast<int64_t>(number)) return text;
  return absl::StrCat(static_cast<int64_t>(number));
}

// Removes [begin, end) from the type, with the colon before it.
void Cut(size_t begin, size_t end, std::string& type) {
  if (begin > 0 && type[begin - 1] == ':') --begin;
  type.erase(begin, end - begin);
}

// Reads the checks that CLI11 appends to the type of an option, "FLOAT:FLOAT in [0 - 1]", and removes them.
void ReadType(std::string type, HelpOption& option) {
  if (const size_t begin = type.find('{'); begin != std::string::npos) {
    const size_t end = type.find('}', begin);
    for (const absl::string_view choice : absl::StrSplit(type.substr(begin + 1, end - begin - 1), ',')) {
      option.choices.emplace_back(choice.substr(0, choice.find("->")));
    }
    Cut(begin, end + 1, type);
  }
  constexpr absl::string_view kIn = " in [";
  if (const size_t in = type.find(kIn.data()); in != std::string::npos) {
    const size_t end = type.find(']', in);
    const std::vector<std::string> limits =
        absl::StrSplit(type.substr(in + kIn.size(), end - in - kIn.size()), absl::MaxSplits(" - ", 1));
    option.facts.push_back(absl::StrCat("range: ", PlainNumber(limits.front()), " to ", PlainNumber(limits.back())));
    Cut(type.rfind(':', in) + 1, end + 1, type);
  }
  for (const char* const check : {"NONNEGATIVE", "POSITIVE"}) {
    if (absl::EndsWith(type, check)) Cut(type.size() - std::string(check).size(), type.size(), type);
  }
  if (type == "TEXT" || type == "ENUM" || type.empty()) type = option.choices.empty() ? "TEXT" : "NAME";
  if (type == "INT" || type == "UINT") type = "N";
  if (type == "FLOAT") type = "NUMBER";
  option.value = type;
  if (absl::StrContains(type, "FILE")) option.kind = ValueKind::kFile;
  if (absl::StrContains(type, "DIR")) option.kind = ValueKind::kDirectory;
}

// The names, sorted, of the options that exclude this one, without those that exclude many.
std::string Exclusions(const CLI::Option& option) {
  std::vector<std::string> names;
  for (const CLI::Option* const other : option.get_excludes()) {
    if (other->get_excludes().size() <= kMaxShownExclusions) names.push_back(other->get_name());
  }
  std::sort(names.begin(), names.end());
  return absl::StrJoin(names, ", ");
}

void AddFacts(const CLI::Option& option, HelpOption& help) {
  const bool is_flag = option.get_expected_max() == 0;
  if (option.get_required()) help.facts.insert(help.facts.begin(), "required");
  if (!is_flag && !option.get_default_str().empty()) {
    help.facts.insert(help.facts.begin(), absl::StrCat("default: ", PlainNumber(option.get_default_str())));
  }
  if (!help.choices.empty()) help.facts.push_back(absl::StrCat("values: ", absl::StrJoin(help.choices, ", ")));
  if (!option.get_envname().empty()) help.facts.push_back(absl::StrCat("environment: ", option.get_envname()));
  // The options of the connection all need --server.
  if (option.get_group() != kConnectionGroup) {
    std::vector<std::string> needed;
    for (const CLI::Option* const other : option.get_needs()) {
      needed.push_back(other->get_positional() ? PositionalName(*other) : other->get_name());
    }
    std::sort(needed.begin(), needed.end());
    if (!needed.empty()) help.facts.push_back(absl::StrCat("with: ", absl::StrJoin(needed, ", ")));
  }
  if (option.get_excludes().size() <= kMaxShownExclusions) {
    const std::string excluded = Exclusions(option);
    if (!excluded.empty()) help.facts.push_back(absl::StrCat("not with: ", excluded));
  }
}

HelpOption DescribeOption(const CLI::Option& option) {
  HelpOption help;
  for (const std::string& name : option.get_snames()) help.names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) help.names.push_back("--" + name);
  help.description = option.get_description();
  help.is_required = option.get_required();
  const bool is_flag = option.get_expected_max() == 0;
  help.is_repeated = option.get_items_expected_max() > 1;
  if (!is_flag) ReadType(option.get_type_name(), help);
  if (help.is_positional()) help.value = PositionalName(option);
  AddFacts(option, help);
  return help;
}

// Position of a group in the help.
int Rank(const std::string& group) {
  constexpr std::array<const char*, 3> kFirst = {kInputGroup, kOutputGroup, kTrackingGroup};
  constexpr std::array<const char*, 4> kLast = {kConnectionGroup, kOutageGroup, kGeneralGroup, kResearchGroup};
  const auto first = std::find(kFirst.begin(), kFirst.end(), group);
  if (first != kFirst.end()) return static_cast<int>(first - kFirst.begin()) - 10;
  const auto last = std::find(kLast.begin(), kLast.end(), group);
  return last == kLast.end() ? 0 : static_cast<int>(last - kLast.begin()) + 10;
}

std::vector<HelpGroup> DescribeGroups(const CLI::App& command) {
  std::vector<HelpGroup> groups;
  for (const CLI::Option* const option : command.get_options()) {
    if (option->get_group().empty()) continue;  // hidden
    const bool is_general = option == command.get_help_ptr() || option == command.get_version_ptr();
    const std::string title = is_general ? kGeneralGroup : option->get_group();
    auto group = std::find_if(groups.begin(), groups.end(), [&](const HelpGroup& each) { return each.title == title; });
    if (group == groups.end()) group = groups.insert(groups.end(), HelpGroup{title, {}});
    group->options.push_back(DescribeOption(*option));
  }
  std::stable_sort(groups.begin(), groups.end(),
                   [](const HelpGroup& a, const HelpGroup& b) { return Rank(a.title) < Rank(b.title); });
  return groups;
}

std::vector<HelpCommandGroup> DescribeCommands(const CLI::App& command) {
  std::vector<HelpCommandGroup> groups;
  for (const CLI::App* const below : command.get_subcommands([](const CLI::App*) { return true; })) {
    if (below->get_group().empty()) continue;  // hidden
    const std::string title = below->get_group() == "Subcommands" ? "Commands" : below->get_group();
    auto group =
        std::find_if(groups.begin(), groups.end(), [&](const HelpCommandGroup& each) { return each.title == title; });
    if (group == groups.end()) group = groups.insert(groups.end(), HelpCommandGroup{title, {}});
    group->commands.push_back({below->get_name(), below->get_description()});
  }
  return groups;
}

void ReadExamples(absl::string_view text, std::vector<HelpExample>& examples) {
  bool is_continued = false;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    const bool is_command = is_continued || absl::StartsWith(line, "  ");
    absl::string_view words = absl::StripAsciiWhitespace(line);
    if (words.empty()) continue;
    const bool continues = absl::ConsumeSuffix(&words, " \\");
    const bool goes_on = !is_command && !examples.empty() && !examples.back().is_command;  // a remark of several lines
    if (is_continued || goes_on) {
      absl::StrAppend(&examples.back().text, " ", words);
    } else {
      examples.push_back({std::string(words), is_command});
    }
    is_continued = continues;
  }
}

// "  TERM  TEXT"; without two spaces inside, all of it is the term.
HelpNote ReadEntry(absl::string_view line) {
  const absl::string_view words = absl::StripAsciiWhitespace(line);
  const size_t gap = words.find("  ");
  if (gap == absl::string_view::npos) return {std::string(words), ""};
  return {std::string(words.substr(0, gap)), std::string(absl::StripAsciiWhitespace(words.substr(gap)))};
}

std::vector<HelpNote> ReadNotes(absl::string_view text) {
  constexpr size_t kContinuation = 4;  // least indentation of a line that continues an entry
  std::vector<HelpNote> notes;
  bool begins_paragraph = true;
  for (const absl::string_view line : absl::StrSplit(text, '\n')) {
    const size_t indentation = line.find_first_not_of(' ');
    if (indentation == absl::string_view::npos) {
      begins_paragraph = true;
    } else if (indentation == 0) {
      if (begins_paragraph || notes.empty() || !notes.back().term.empty()) notes.push_back({});
      absl::StrAppend(&notes.back().text, notes.back().text.empty() ? "" : " ", line);
      begins_paragraph = false;
    } else if (indentation >= kContinuation && !notes.empty() && !notes.back().term.empty()) {
      absl::StrAppend(&notes.back().text, " ", absl::StripAsciiWhitespace(line));
    } else {
      notes.push_back(ReadEntry(line));
    }
  }
  return notes;
}

// Moves the entries below a paragraph with this text out of the notes.
std::vector<HelpNote> TakeEntries(absl::string_view text, std::vector<HelpNote>& notes) {
  const auto title = std::find_if(notes.begin(), notes.end(),
                                  [&](const HelpNote& note) { return note.term.empty() && note.text == text; });
  if (title == notes.end()) return {};
  const auto end = std::find_if(title + 1, notes.end(), [](const HelpNote& note) { return note.term.empty(); });
  std::vector<HelpNote> entries(title + 1, end);
  notes.erase(title, end);
  return entries;
}

std::vector<HelpNote> TakeExitStatuses(std::vector<HelpNote>& notes) {
  std::vector<HelpNote> statuses = TakeEntries("Exit status:", notes);
  if (!statuses.empty()) return statuses;
  return {{"0", "Success"},
          {"1", "Failure; its cause and remedy are on standard error"},
          {"2", "Wrong usage: an unknown or missing option, or a value of a wrong form"}};
}

// The positional arguments and the required options.
std::string UsageOfParser(const HelpPage& page) {
  std::vector<std::string> words;
  if (!page.commands.empty()) words.emplace_back("COMMAND");
  std::vector<std::string> required;
  for (const HelpGroup& group : page.groups) {
    for (const HelpOption& option : group.options) {
      if (option.is_positional()) {
        words.push_back(option.is_required ? option.Term() : absl::StrCat("[", option.Term(), "]"));
      } else if (option.is_required) {
        required.push_back(absl::StrCat(option.names.back(), " ", option.value));
      }
    }
  }
  words.insert(words.end(), required.begin(), required.end());
  return absl::StrJoin(words, " ");
}

std::vector<std::string> TakeUsages(HelpPage& page) {
  std::vector<std::string> usages;
  for (const HelpNote& entry : TakeEntries("Usage:", page.notes)) {
    usages.push_back(absl::StrCat(entry.term, entry.text.empty() ? "" : " ", entry.text));
  }
  if (usages.empty()) usages.push_back(UsageOfParser(page));
  for (std::string& usage : usages) absl::StrAppend(&usage, usage.empty() ? "" : " ", "[OPTION]...");
  return usages;
}

}  // namespace

std::string PositionalName(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  return absl::StrContains(type, '|') ? type : absl::AsciiStrToUpper(option.get_name(true));
}

std::string HelpOption::Term() const {
  if (is_positional()) return is_repeated ? absl::StrCat(value, "...") : value;
  return absl::StrCat(absl::StrJoin(names, ", "), value.empty() ? "" : " ", value);
}

std::string HelpOption::Text() const {
  std::string text = description;
  for (const std::string& fact : facts) absl::StrAppend(&text, " [", fact, "]");
  return text;
}

HelpPage DescribeCommand(const CLI::App& command) {
  HelpPage page;
  page.name = FullCommandName(command);
  page.description = command.get_description();
  page.groups = DescribeGroups(command);
  page.commands = DescribeCommands(command);
  const std::string footer = command.get_footer();
  constexpr absl::string_view kExample = "Example:\n";
  const size_t example = absl::StartsWith(footer, kExample) ? 0 : footer.find(absl::StrCat("\n", kExample));
  page.notes = ReadNotes(absl::string_view(footer).substr(0, example));
  page.exit_statuses = TakeExitStatuses(page.notes);
  page.usages = TakeUsages(page);
  if (example == std::string::npos) return page;
  ReadExamples(absl::string_view(footer).substr(example + kExample.size()), page.examples);
  return page;
}

std::string FullCommandName(const CLI::App& command) {
  const CLI::App* const parent = command.get_parent();
  return parent == nullptr ? command.get_name() : absl::StrCat(FullCommandName(*parent), " ", command.get_name());
}

std::vector<const CLI::App*> AllCommands(const CLI::App& program) {
  std::vector<const CLI::App*> commands = {&program};
  for (const CLI::App* const below : program.get_subcommands([](const CLI::App*) { return true; })) {
    const std::vector<const CLI::App*> more = AllCommands(*below);
    commands.insert(commands.end(), more.begin(), more.end());
  }
  return commands;
}

}  // namespace evpose
