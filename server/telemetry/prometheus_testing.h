// SPDX-License-Identifier: Apache-2.0

// A parser of Prometheus's text format for tests, as strict as that of Prometheus.
#pragma once

#include <gtest/gtest.h>

#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"

namespace evpose::server {

struct ParsedMetrics {
  std::map<std::string, std::string> types;  // by family
  std::map<std::string, std::string> helps;
  std::map<std::string, double>
      values;  // by series, name{label="value",...}, with the labels in their order in the text

  double At(const std::string& series) const {
    const auto found = values.find(series);
    EXPECT_NE(found, values.end()) << "there is no " << series;
    return found == values.end() ? -1.0 : found->second;
  }
};

// Parses `text`. An invalid line, a duplicate family or series, and a series outside its family fail the test.
inline ParsedMetrics ParseMetrics(const std::string& text) {
  static const std::regex kComment(R"re(# (HELP|TYPE) ([a-zA-Z_:][a-zA-Z0-9_:]*) (.+))re");
  static const std::regex kSample(R"re(([a-zA-Z_:][a-zA-Z0-9_:]*)(\{[a-zA-Z_][a-zA-Z0-9_]*="[^"\\\n]*")re"
                                  R"re((,[a-zA-Z_][a-zA-Z0-9_]*="[^"\\\n]*")*\})? (\S+))re");
  static const std::regex kHistogramSuffix("_(bucket|sum|count)$");
  ParsedMetrics parsed;
  std::string family;
  std::istringstream lines(text);
  EXPECT_TRUE(absl::EndsWith(text, "\n"));
  for (std::string line; std::getline(lines, line);) {
    std::smatch match;
    if (std::regex_match(line, match, kComment)) {
      auto& known = match[1] == "HELP" ? parsed.helps : parsed.types;
      EXPECT_TRUE(known.emplace(match[2], match[3]).second) << "twice: " << line;
      family = match[2];
    } else if (std::regex_match(line, match, kSample)) {
      std::string name = match[1];
      if (parsed.types[family] == "histogram") name = std::regex_replace(name, kHistogramSuffix, "");
      EXPECT_EQ(name, family) << line;
      double value = 0.0;
      EXPECT_TRUE(absl::SimpleAtod(match[4].str(), &value)) << line;
      EXPECT_TRUE(parsed.values.emplace(match[1].str() + match[2].str(), value).second) << "twice: " << line;
    } else {
      ADD_FAILURE() << "neither comment nor sample: " << line;
    }
  }
  return parsed;
}

}  // namespace evpose::server
