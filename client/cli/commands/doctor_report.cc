// SPDX-License-Identifier: Apache-2.0
#include "client/cli/commands/doctor_report.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/counted.h"

namespace evpose::client {
namespace {

constexpr char kIndent[] = "                            ";

std::string LimitText(double limit, const std::string& unit) {
  const bool is_large = unit == "events/s" && limit >= 1e5;
  return absl::StrFormat(" (limit %.4g %s)", is_large ? 1e-6 * limit : limit, is_large ? "Mev/s" : unit);
}

}  // namespace

std::string DoctorReport::Names(Verdict verdict) const {
  std::string names;
  for (const Finding& finding : findings) {
    if (finding.verdict == verdict) absl::StrAppend(&names, names.empty() ? "" : ", ", finding.check);
  }
  return names;
}

Json DoctorReport::ToJson() const {
  Json checks = Json::array();
  for (const Finding& finding : findings) {
    checks.push_back({{"check", finding.check},
                      {"result", std::string(VerdictName(finding.verdict))},
                      {"text", finding.text},
                      {"value", OrNull(finding.value)},
                      {"limit", OrNull(finding.limit)},
                      {"unit", finding.unit},
                      {"places", finding.places},
                      {"remedy", finding.remedy}});
  }
  std::vector<std::string> all = subjects;
  for (const auto& [index, subject] : later_subjects) all.push_back(subject);
  return {{"subjects", all}, {"checks", checks}};
}

void DoctorReport::Print(std::ostream& out) const {
  for (const std::string& subject : subjects) out << subject << "\n";
  for (size_t i = 0; i < findings.size(); ++i) {
    const Finding& finding = findings[i];
    if (const auto subject = later_subjects.find(i); subject != later_subjects.end()) out << subject->second << "\n";
    out << absl::StrFormat("%-11s  %-13s  %s", std::string(VerdictName(finding.verdict)), finding.check, finding.text);
    const bool is_bad = finding.verdict == Verdict::kAdvice || finding.verdict == Verdict::kProblem;
    if (is_bad && finding.limit) out << LimitText(*finding.limit, finding.unit);
    out << "\n";
    if (!is_bad) continue;
    for (const std::string& place : finding.places) out << kIndent << place << "\n";
    if (!finding.remedy.empty()) out << kIndent << "-> " << finding.remedy << "\n";
  }
  const auto count = [this](Verdict verdict) {
    return std::count_if(findings.begin(), findings.end(),
                         [verdict](const Finding& finding) { return finding.verdict == verdict; });
  };
  out << Counted(static_cast<uint64_t>(count(Verdict::kProblem)), "problem") << ", "
      << Counted(static_cast<uint64_t>(count(Verdict::kAdvice)), "piece of advice", "pieces of advice") << ", "
      << Counted(static_cast<uint64_t>(count(Verdict::kNotChecked)), "check") << " not made\n";
}

}  // namespace evpose::client
