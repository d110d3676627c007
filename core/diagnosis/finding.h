// SPDX-License-Identifier: Apache-2.0

// The result of one check of a recording, a camera or a model.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace evpose {

enum class Verdict {
  kOk,
  kAdvice,      // tracking works, and would work better
  kProblem,     // tracking fails, or its poses are wrong
  kNotChecked,  // Finding::text says why
};

// "ok", "advice", "problem" or "not checked".
std::string_view VerdictName(Verdict verdict);

struct Finding {
  std::string check;  // "hot-pixels"
  Verdict verdict = Verdict::kOk;
  std::string text;             // what was measured; for kNotChecked the reason
  std::optional<double> value;  // the measured quantity, in `unit`
  std::optional<double> limit;  // that `value` has passed; for kOk the one of kAdvice
  std::string unit;
  std::vector<std::string> places;  // times and pixels, the worst first
  std::string remedy;               // empty for kOk
};

// The limits of a quantity, in its unit; larger values are worse.
struct Limits {
  double advice = 0.0;
  double problem = 0.0;
};

// Sets value, limit, unit and verdict of a finding.
void SetVerdict(double value, const Limits& limits, const std::string& unit, Finding& finding);

// Sets value, limit and unit of a finding, and leaves its verdict to the caller.
void SetMeasured(double value, double limit, std::string unit, Finding& finding);

Finding NotChecked(const std::string& check, const std::string& reason);

}  // namespace evpose
