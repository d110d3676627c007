// SPDX-License-Identifier: Apache-2.0
#include "core/diagnosis/finding.h"

#include <utility>

namespace evpose {

std::string_view VerdictName(Verdict verdict) {
  switch (verdict) {
    case Verdict::kOk:
      return "ok";
    case Verdict::kAdvice:
      return "advice";
    case Verdict::kProblem:
      return "problem";
    case Verdict::kNotChecked:
      return "not checked";
  }
  return "";
}

void SetVerdict(double value, const Limits& limits, const std::string& unit, Finding& finding) {
  const bool is_problem = value > limits.problem;
  finding.value = value;
  finding.limit = is_problem ? limits.problem : limits.advice;
  finding.unit = unit;
  finding.verdict = is_problem ? Verdict::kProblem : value > limits.advice ? Verdict::kAdvice : Verdict::kOk;
}

void SetMeasured(double value, double limit, std::string unit, Finding& finding) {
  finding.value = value;
  finding.limit = limit;
  finding.unit = std::move(unit);
}

Finding NotChecked(const std::string& check, const std::string& reason) {
  Finding finding;
  finding.check = check;
  finding.verdict = Verdict::kNotChecked;
  finding.text = reason;
  return finding;
}

}  // namespace evpose
