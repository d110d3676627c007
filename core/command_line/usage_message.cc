// SPDX-License-Identifier: Apache-2.0
#include "core/command_line/usage_message.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/string_view.h"
#include "absl/strings/strip.h"
#include "core/command_line/help_page.h"
#include "core/command_line/suggestion.h"

namespace evpose {
namespace {

// Returns the option that the parser calls by this name in its errors; null if there is none.
const CLI::Option* FindOption(const CLI::App& command, absl::string_view name) {
  for (const CLI::Option* const option : command.get_options()) {
    if (name == option->get_name()) return option;
  }
  return nullptr;
}

// The name that --help has: that of an argument without an option is in capitals.
std::string NameInHelp(const CLI::App& command, absl::string_view name) {
  const CLI::Option* const option = FindOption(command, name);
  return option != nullptr && option->get_positional() ? PositionalName(*option) : std::string(name);
}

std::string Quoted(absl::string_view text) { return absl::StrCat("\"", text, "\""); }

// Divides `text` at the first `separator`; false if it has none.
bool Divide(absl::string_view text, absl::string_view separator, absl::string_view& before, absl::string_view& after) {
  const size_t position = text.find(separator);
  if (position == absl::string_view::npos) return false;
  before = text.substr(0, position);
  after = text.substr(position + separator.size());
  return true;
}

// "0.001000" -> "0.001"
std::string ShortNumber(absl::string_view number) {
  if (!absl::StrContains(number, '.')) return std::string(number);
  while (absl::EndsWith(number, "0")) number.remove_suffix(1);
  absl::ConsumeSuffix(&number, ".");
  return std::string(number);
}

// Names the option, and the environment variable if the value is that of the variable.
std::string SourceOfValue(const CLI::App& command, absl::string_view name) {
  const CLI::Option* const option = FindOption(command, name);
  if (option == nullptr || option->get_envname().empty()) return NameInHelp(command, name);
  // NOLINTNEXTLINE(concurrency-mt-unsafe): arguments are parsed before the program has a second thread
  const char* const value = std::getenv(option->get_envname().c_str());
  if (value == nullptr || option->results() != std::vector<std::string>{value}) return std::string(name);
  // The parser lists the options of the command line only.
  const std::vector<CLI::Option*>& given = command.parse_order();
  if (std::find(given.begin(), given.end(), option) != given.end()) return std::string(name);
  return absl::StrCat("the environment variable ", option->get_envname(), ", which stands for ", name);
}

// The option as --help describes it; one without content if it has no help.
HelpOption HelpOf(const CLI::App& command, absl::string_view name) {
  const HelpPage page = DescribeCommand(command);
  for (const HelpGroup& group : page.groups) {
    for (const HelpOption& option : group.options) {
      if (std::find(option.names.begin(), option.names.end(), name) != option.names.end()) return option;
    }
  }
  return {};
}

// "--out FILE", as --help prints it.
std::string WithValue(const CLI::App& command, absl::string_view name) {
  const std::string value = HelpOf(command, name).value;
  return absl::StrCat(name, value.empty() ? "" : " ", value);
}

// What is wrong with the value of an option that takes numbers and has no check of its own.
std::string DescribeNumber(absl::string_view value) {
  double number = 0.0;
  if (!absl::SimpleAtod(value, &number)) return " is not a number";
  if (number < 0.0) return " is not a whole number of at least 0";
  return number == std::floor(number) && number < 1e9 ? " is not a number that it accepts"
                                                      : " is not a whole number in its range";
}

std::string DescribeMissing(const CLI::App& command, absl::string_view text) {
  absl::string_view name = text;
  if (!absl::ConsumeSuffix(&name, " is required")) return std::string(text);
  const CLI::Option* const option = FindOption(command, name);
  if (option == nullptr) return std::string(text);
  const std::string argument = option->get_positional() ? PositionalName(*option) : WithValue(command, name);
  return absl::StrCat("give ", argument, ", which is required");
}

// The error of a check of a value.
std::string DescribeValue(const CLI::App& command, absl::string_view text) {
  absl::string_view name, what, value, limits, from, to;
  if (!Divide(text, ": ", name, what)) return std::string(text);
  std::string description(what);
  if (Divide(what, " not in range ", value, limits) && Divide(limits, " to ", from, to)) {
    absl::ConsumePrefix(&value, "Value ");
    // The limits of a range of integers have no decimal point; 1e9 and 2.5 are not read as integers.
    const bool is_whole = !absl::StrContains(from, '.') && !absl::StrContains(to, '.');
    description = absl::StrCat(Quoted(value), is_whole ? " is not a whole number from " : " is not a number from ",
                               ShortNumber(from), " to ", ShortNumber(to));
  } else if (Divide(what, " not in {", value, limits) && absl::ConsumeSuffix(&limits, "}")) {
    description = absl::StrCat(Quoted(value), " is none of ", absl::StrReplaceAll(limits, {{",", ", "}}));
  }
  return absl::StrCat(SourceOfValue(command, name), ": ", description);
}

// The error of a value that is not of the option's type.
std::string DescribeConversion(const CLI::App& command, absl::string_view text) {
  absl::string_view pair = text, name, value;
  if (!absl::ConsumePrefix(&pair, "Could not convert: ") || !Divide(pair, " = ", name, value)) return std::string(text);
  const CLI::Option* const option = FindOption(command, name);
  if (option != nullptr && option->get_items_expected_max() == 0) {
    return absl::StrCat(name, " has no value, but ", Quoted(value), " was given");
  }
  const bool is_boolean = option != nullptr && option->get_type_name() == "BOOLEAN";
  const std::vector<std::string> choices = HelpOf(command, name).choices;
  const std::string what = is_boolean        ? " is neither true nor false"
                           : choices.empty() ? DescribeNumber(value)
                                             : absl::StrCat(" is none of ", absl::StrJoin(choices, ", "));
  return absl::StrCat(SourceOfValue(command, name), ": ", Quoted(value), what);
}

// The error of an option with too few or too many values.
std::string DescribeNumberOfValues(const CLI::App& command, absl::string_view text) {
  absl::string_view name, what, limit, given;
  if (!Divide(text, ": ", name, what)) return std::string(text);
  if (Divide(what, " required ", limit, given) && absl::ConsumeSuffix(&given, " missing")) {
    if (limit != "1") return absl::StrCat(name, " needs ", limit, " values");
    return absl::StrCat(name, " has no value: give ", WithValue(command, name));
  }
  if (Divide(what, " required but received ", limit, given)) {
    if (limit == "At Most 1") return absl::StrCat(name, " was given ", given, " times: give it once");
    return absl::StrCat(name, " needs ", absl::AsciiStrToLower(limit), " values, but the number given is ", given);
  }
  return std::string(text);
}

// The words that the parser could not use, in their order.
std::vector<std::string> UnusedWords(const CLI::App& command) {
  std::vector<std::string> words;
  for (const CLI::App* each = &command; each != nullptr && words.empty(); each = each->get_parent()) {
    words = each->remaining();
  }
  return words;
}

// Returns what is wrong with the word, with the option that it was probably meant to be.
std::string DescribeUnknownOption(const CLI::App& command, const std::string& word) {
  const std::string name = word.substr(0, word.find('='));
  std::vector<std::string> names;
  for (const CLI::Option* const option : command.get_options()) {
    for (const std::string& long_name : option->get_lnames()) names.push_back("--" + long_name);
  }
  const std::string nearest = absl::StartsWith(name, "--") ? NearestName(name, names) : "";
  return absl::StrCat("there is no option ", name,
                      nearest.empty() ? "" : absl::StrCat("; did you mean ", nearest, "?"));
}

// Returns the text for the first unknown option, if there is one, as it may also be why another option is missing;
// otherwise for the first excess argument; empty if all words were used.
std::string DescribeUnusedWords(const CLI::App& command) {
  const std::vector<std::string> words = UnusedWords(command);
  const auto is_option = [](const std::string& word) { return word.size() > 1 && word[0] == '-' && word != "--"; };
  const auto option = std::find_if(words.begin(), words.end(), is_option);
  if (option != words.end()) return DescribeUnknownOption(command, *option);
  if (words.empty()) return "";
  return absl::StrCat("the argument ", Quoted(words.front()),
                      " is one too many; a value that contains spaces must be in quotation marks");
}

std::string Describe(const CLI::App& command, const CLI::Error& error) {
  const std::string text = error.what();
  absl::string_view first, second;
  switch (static_cast<CLI::ExitCodes>(error.get_exit_code())) {
    case CLI::ExitCodes::RequiredError: {
      // A required option may be missing because its name is misspelled. The parser reports what is missing first.
      const std::string unused = DescribeUnusedWords(command);
      return absl::StartsWith(unused, "there is no option") ? unused : DescribeMissing(command, text);
    }
    case CLI::ExitCodes::ExtrasError: {
      const std::string unused = DescribeUnusedWords(command);
      return unused.empty() ? text : unused;
    }
    case CLI::ExitCodes::ValidationError:
      return DescribeValue(command, text);
    case CLI::ExitCodes::ConversionError:
      return DescribeConversion(command, text);
    case CLI::ExitCodes::ArgumentMismatch:
      return DescribeNumberOfValues(command, text);
    case CLI::ExitCodes::RequiresError:
      if (Divide(text, " requires ", first, second)) return absl::StrCat(text, ": give ", second, ", too");
      return text;
    case CLI::ExitCodes::ExcludesError:
      if (!Divide(text, " excludes ", first, second)) return text;
      return absl::StrCat(NameInHelp(command, first), " and ", NameInHelp(command, second),
                          " exclude each other: give one of them");
    default:
      return text;
  }
}

}  // namespace

std::string UsageMessage(const CLI::App& command, const CLI::Error& error) {
  const std::string description = Describe(command, error);
  return absl::StrCat(FullCommandName(command), ": ", description, absl::EndsWith(description, "?") ? " " : "; ",
                      HelpHint(command));
}

std::string HelpHint(const CLI::App& command) {
  const bool has_commands = !command.get_subcommands([](const CLI::App*) { return true; }).empty();
  return absl::StrCat(FullCommandName(command), " --help lists the ", has_commands ? "commands" : "options");
}

}  // namespace evpose
