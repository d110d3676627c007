// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/completion.h"

#include <algorithm>
#include <map>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "core/command_line/help_page.h"

namespace evpose {
namespace {

// The words of the bash script for the kinds of values.
constexpr char kFile[] = "@file";
constexpr char kDirectory[] = "@directory";
constexpr char kText[] = "@text";

// The function of bash or zsh that completes a command.
std::string FunctionName(const std::string& command) {
  std::string name = absl::StrCat("_", command);
  for (char& c : name) {
    if (!absl::ascii_isalnum(c)) c = '_';
  }
  return name;
}

std::string ValueOf(const HelpOption& option) {
  if (!option.choices.empty()) return absl::StrJoin(option.choices, " ");
  switch (option.kind) {
    case ValueKind::kFile:
      return kFile;
    case ValueKind::kDirectory:
      return kDirectory;
    case ValueKind::kText:
      break;
  }
  return kText;
}

std::vector<std::string> CommandNames(const HelpPage& page) {
  std::vector<std::string> names;
  for (const HelpCommandGroup& group : page.commands) {
    for (const HelpCommand& command : group.commands) names.push_back(command.name);
  }
  return names;
}

std::string BashCommandCase(const HelpPage& page) {
  std::vector<std::string> options;
  std::string argument;
  for (const HelpGroup& group : page.groups) {
    for (const HelpOption& option : group.options) {
      options.insert(options.end(), option.names.begin(), option.names.end());
      // The files that a command reads, and those that it writes.
      if (option.is_positional() && argument.empty()) argument = ValueOf(option);
    }
  }
  return absl::StrCat("    \"", page.name, "\")\n      commands=\"", absl::StrJoin(CommandNames(page), " "),
                      "\" argument=\"", argument, "\"\n      options=\"", absl::StrJoin(options, " "),
                      "\"\n      ;;\n");
}

// The patterns of the options of a command, by their value.
void AddBashValues(const HelpPage& page, std::map<std::string, std::vector<std::string>>& patterns) {
  for (const HelpGroup& group : page.groups) {
    for (const HelpOption& option : group.options) {
      if (option.value.empty()) continue;
      for (const std::string& name : option.names) {
        patterns[ValueOf(option)].push_back(absl::StrCat("\"", page.name, " ", name, "\""));
      }
    }
  }
}

// @NAME@ is the name of the function, @PROGRAM@ that of the program.
constexpr char kBashFunction[] = R"(@NAME@() {
  local cur=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]} command=@PROGRAM@ option i
  local commands options argument value=""
  COMPREPLY=()
  @NAME@_command "$command"
  for ((i = 1; i < COMP_CWORD; i++)); do
    [[ -n ${COMP_WORDS[i]} && " $commands " == *" ${COMP_WORDS[i]} "* ]] || continue
    command+=" ${COMP_WORDS[i]}"
    @NAME@_command "$command"
  done
  # Bash divides words at "=": --option=VALUE and --option ID=VALUE.
  option=$before
  if [[ $cur == "=" ]]; then
    cur=""
  elif [[ $before == "=" ]] && ((COMP_CWORD >= 3)); then
    option=${COMP_WORDS[COMP_CWORD - 2]}
    [[ $option == -* ]] || option=${COMP_WORDS[COMP_CWORD - 3]}
  fi
  [[ $option != -* ]] || @NAME@_value "$command $option"
  if [[ -z $value ]]; then
    value=${commands:-${argument:-$options}}
    [[ $cur != -* ]] || value=$options
  fi
  case $value in
    @file)
      compopt -o filenames 2>/dev/null
      mapfile -t COMPREPLY < <(compgen -f -- "$cur")
      ;;
    @directory)
      compopt -o filenames 2>/dev/null
      mapfile -t COMPREPLY < <(compgen -d -- "$cur")
      ;;
    @text) ;;
    *) mapfile -t COMPREPLY < <(compgen -W "$value" -- "$cur") ;;
  esac
}
complete -F @NAME@ @PROGRAM@
)";

// Text inside single quotes and brackets of a specification of _arguments: the first sentence or part of one.
std::string ZshText(const std::string& text) {
  std::string first = text.substr(0, std::min(text.find(". "), std::min(text.find("; "), text.find(": "))));
  return absl::StrReplaceAll(first, {{"'", "'\\''"}, {"[", "("}, {"]", ")"}, {":", " "}, {"\\", ""}});
}

// ":FILE:_files"
std::string ZshValue(const HelpOption& option) {
  if (option.value.empty()) return "";
  std::string action = " ";
  if (!option.choices.empty()) {
    action = absl::StrCat("(", absl::StrJoin(option.choices, " "), ")");
  } else if (option.kind == ValueKind::kFile) {
    action = "_files";
  } else if (option.kind == ValueKind::kDirectory) {
    action = "_files -/";
  }
  const std::string name = absl::StrReplaceAll(option.value, {{":", "\\:"}, {"'", ""}, {"[", ""}, {"]", ""}});
  return absl::StrCat(":", name, ":", action);
}

void AppendZshOption(const HelpOption& option, std::vector<std::string>& specifications) {
  if (option.is_positional()) {
    specifications.push_back(absl::StrCat("'", option.is_repeated ? "*" : "", ZshValue(option), "'"));
    return;
  }
  const std::string once = option.is_repeated ? "*" : absl::StrCat("(", absl::StrJoin(option.names, " "), ")");
  for (const std::string& name : option.names) {
    const bool is_long = name.size() > 2;
    specifications.push_back(absl::StrCat("'", once, name, !option.value.empty() && is_long ? "=" : "", "[",
                                          ZshText(option.description), "]", ZshValue(option), "'"));
  }
}

std::string ZshFunction(const HelpPage& page) {
  std::vector<std::string> specifications;
  for (const HelpGroup& group : page.groups) {
    for (const HelpOption& option : group.options) AppendZshOption(option, specifications);
  }
  const std::vector<std::string> names = CommandNames(page);
  std::string text = absl::StrCat(FunctionName(page.name), "() {\n");
  if (names.empty()) {
    return absl::StrCat(text, "  _arguments \\\n    ", absl::StrJoin(specifications, " \\\n    "), "\n}\n\n");
  }
  absl::StrAppend(&text, "  local state line\n  _arguments -C \\\n    ", absl::StrJoin(specifications, " \\\n    "),
                  " \\\n    '1: :->command' '*:: :->arguments'\n  case $state in\n    command)\n"
                  "      local -a commands=(\n");
  for (const HelpCommandGroup& group : page.commands) {
    for (const HelpCommand& command : group.commands) {
      absl::StrAppend(&text, "        '", command.name, ":", ZshText(command.description), "'\n");
    }
  }
  absl::StrAppend(&text,
                  "      )\n      _describe command commands\n      ;;\n    arguments)\n      case $line[1] in\n");
  for (const std::string& name : names) {
    absl::StrAppend(&text, "        ", name, ") ", FunctionName(absl::StrCat(page.name, " ", name)), " ;;\n");
  }
  return absl::StrCat(text, "      esac\n      ;;\n  esac\n}\n\n");
}

}  // namespace

std::string BashCompletion(const CLI::App& program) {
  const std::string name = FunctionName(program.get_name());
  std::string cases;
  std::map<std::string, std::vector<std::string>> patterns;
  for (const CLI::App* const command : AllCommands(program)) {
    const HelpPage page = DescribeCommand(*command);
    absl::StrAppend(&cases, BashCommandCase(page));
    AddBashValues(page, patterns);
  }
  std::string values;
  for (const auto& [value, names] : patterns) {
    absl::StrAppend(&values, "    ", absl::StrJoin(names, " | \\\n      "), ")\n      value=\"", value,
                    "\"\n      ;;\n");
  }
  return absl::StrCat("# Completion of ", program.get_name(),
                      " for bash, made from its options; do not edit.\n\n# What may follow the command $1.\n", name,
                      "_command() {\n  commands=\"\" options=\"\" argument=\"\"\n  case $1 in\n", cases,
                      "  esac\n}\n\n# The value of \"COMMAND OPTION\": a kind, or the possible words.\n", name,
                      "_value() {\n  case $1 in\n", values, "  esac\n}\n\n",
                      absl::StrReplaceAll(kBashFunction, {{"@NAME@", name}, {"@PROGRAM@", program.get_name()}}));
}

std::string ZshCompletion(const CLI::App& program) {
  std::string text = absl::StrCat("#compdef ", program.get_name(), "\n# Completion of ", program.get_name(),
                                  " for zsh, made from its options; do not edit.\n\n");
  for (const CLI::App* const command : AllCommands(program))
    absl::StrAppend(&text, ZshFunction(DescribeCommand(*command)));
  return absl::StrCat(text, FunctionName(program.get_name()), " \"$@\"\n");
}

}  // namespace evpose
