// SPDX-License-Identifier: Apache-2.0
#include "server/telemetry/open_metrics.h"

#include <charconv>
#include <chrono>
#include <cmath>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/strip.h"

namespace evpose::server {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

std::string Escaped(const std::string& text) {
  return absl::StrReplaceAll(text, {{"\\", "\\\\"}, {"\n", "\\n"}, {"\"", "\\\""}});
}

// Returns the shortest text that is read as the same number.
std::string Number(double value) {
  if (std::isinf(value)) return value > 0.0 ? "+Inf" : "-Inf";
  if (std::isnan(value)) return "NaN";
  std::array<char, 32> text;
  const auto written = std::to_chars(text.data(), text.data() + text.size(), value);
  return {text.data(), written.ptr};
}

// Bounds of buckets are labels, and have one spelling: "1.0", not "1".
std::string Bound(double value) {
  const std::string text = std::isinf(value) ? "+Inf" : absl::StrCat(value);
  return text.find_first_not_of("0123456789") == std::string::npos ? text + ".0" : text;
}

// Returns {name="value",...}, or an empty text without labels.
std::string TextOf(const std::vector<ClientMetric::Label>& labels) {
  std::string text;
  for (const ClientMetric::Label& label : labels) {
    absl::StrAppend(&text, text.empty() ? "{" : ",", label.name, "=\"", Escaped(label.value), "\"");
  }
  return text.empty() ? text : text + "}";
}

// The labels of an exemplar may have 128 characters; these have 40.
std::string TextOf(const std::optional<Exemplar>& exemplar) {
  if (!exemplar.has_value()) return "";
  const auto seconds = [](auto duration) { return std::chrono::duration<double>(duration).count(); };
  return absl::StrFormat(" # {trace_id=\"%s\"} %s %.3f", exemplar->trace_id_text(), Number(seconds(exemplar->duration)),
                         seconds(exemplar->time.time_since_epoch()));
}

void WriteHistogram(const std::string& name, const ClientMetric::Histogram& histogram, const BucketExemplars& exemplars,
                    std::string& text) {
  for (size_t i = 0; i < histogram.bucket.size(); ++i) {
    const ClientMetric::Bucket& bucket = histogram.bucket[i];
    absl::StrAppend(&text, name, "_bucket{le=\"", Bound(bucket.upper_bound), "\"} ", bucket.cumulative_count,
                    i < exemplars.size() ? TextOf(exemplars[i]) : "", "\n");
  }
  absl::StrAppend(&text, name, "_sum ", Number(histogram.sample_sum), "\n");
  absl::StrAppend(&text, name, "_count ", histogram.sample_count, "\n");
}

void WriteFamily(const MetricFamily& family, const BucketExemplars& exemplars, std::string& text) {
  // The name of a family of counters is without the suffix that its series have.
  const std::string name(absl::StripSuffix(family.name, "_total"));
  const char* const type = family.type == MetricType::Counter     ? "counter"
                           : family.type == MetricType::Histogram ? "histogram"
                                                                  : "gauge";
  absl::StrAppend(&text, "# TYPE ", name, " ", type, "\n# HELP ", name, " ", Escaped(family.help), "\n");
  for (const ClientMetric& metric : family.metric) {
    if (family.type == MetricType::Histogram) {
      WriteHistogram(name, metric.histogram, exemplars, text);
    } else {
      const double value = family.type == MetricType::Counter ? metric.counter.value : metric.gauge.value;
      absl::StrAppend(&text, family.name, TextOf(metric.label), " ", Number(value), "\n");
    }
  }
}

}  // namespace

std::string OpenMetricsOf(const std::vector<MetricFamily>& families, const std::vector<BucketExemplars>& exemplars) {
  std::string text;
  for (size_t i = 0; i < families.size(); ++i) WriteFamily(families[i], exemplars[i], text);
  return text + "# EOF\n";
}

}  // namespace evpose::server
