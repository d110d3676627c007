// SPDX-License-Identifier: Apache-2.0

// The contents of the help of a command, taken from its parser: what --help, the manual page and the completion of
// shells have in common.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

namespace evpose {

// Groups of options, in the order in which --help prints them; those with other names come between kTrackingGroup and
// kConnectionGroup. Research options come last.
inline constexpr char kInputGroup[] = "Inputs";
inline constexpr char kOutputGroup[] = "Outputs";
inline constexpr char kTrackingGroup[] = "Tracking";
inline constexpr char kConnectionGroup[] = "Connection";
inline constexpr char kOutageGroup[] = "While the server is unreachable";
inline constexpr char kGeneralGroup[] = "General";
inline constexpr char kResearchGroup[] = "Research";

// The kind of a value, by which a shell completes it.
enum class ValueKind { kText, kFile, kDirectory };

// An option or a positional argument.
struct HelpOption {
  std::vector<std::string> names;  // "-o", "--out"; empty for a positional argument
  std::string value;               // "FILE"; empty for a flag
  ValueKind kind = ValueKind::kText;
  std::vector<std::string> choices;
  std::string description;         // a sentence without its full stop
  std::vector<std::string> facts;  // "required", "default: 1", "range: 0 to 1"
  bool is_required = false;
  bool is_repeated = false;  // takes several values, or may be given several times

  bool is_positional() const { return names.empty(); }
  // "-o, --out FILE"
  std::string Term() const;
  // The description followed by the facts in brackets.
  std::string Text() const;
};

struct HelpGroup {
  std::string title;
  std::vector<HelpOption> options;
};

struct HelpCommand {
  std::string name;  // "list"
  std::string description;
};

struct HelpCommandGroup {
  std::string title;
  std::vector<HelpCommand> commands;
};

// A paragraph, or an entry of a list with an indented text.
struct HelpNote {
  std::string term;  // empty for a paragraph
  std::string text;
};

// A line of the examples: a command or a remark between commands.
struct HelpExample {
  std::string text;
  bool is_command = false;
};

struct HelpPage {
  std::string name;  // "evpose replay"
  std::string description;
  std::vector<HelpGroup> groups;
  std::vector<HelpCommandGroup> commands;
  std::vector<HelpNote> notes;
  std::vector<HelpNote> exit_statuses;  // "0" and its meaning
  std::vector<HelpExample> examples;
  // The words after the name, "FILE --out FILE [OPTION]...", one text for each form of the command.
  std::vector<std::string> usages;
};

// Reads the footer as text in which single line feeds are spaces and empty lines end a paragraph. Indented lines are
// entries, "  TERM  TEXT", continued by lines with a deeper indentation. The entries below "Usage:" and "Exit status:"
// and the lines below "Example:" at the end have fields of their own. Without "Exit status:", the exit statuses are the
// project's. Without "Usage:", the usage has the positional arguments and the required options: the parser does not
// know that one of several options is required, or that the command has several forms.
HelpPage DescribeCommand(const CLI::App& command);

// "evpose sessions list"
std::string FullCommandName(const CLI::App& command);

// All commands of the parser, itself first, each before those below it.
std::vector<const CLI::App*> AllCommands(const CLI::App& program);

// The name of an argument without dashes in --help and in errors: "RECORDING". One that may be of several kinds is
// named after them, "FILE|SESSION".
std::string PositionalName(const CLI::Option& option);

}  // namespace evpose
