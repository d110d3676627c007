// SPDX-License-Identifier: Apache-2.0
#include "server/http/operator_pages.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "core/base/status_macros.h"
#include "server/telemetry/prometheus_text.h"

namespace evpose::server {
namespace {

HttpPage NotReady(absl::string_view why) {
  return {.status = 503, .body = absl::StrCat(absl::StrReplaceAll(why, {{"\n", " "}}), "\n")};
}

HttpPage Starting() {
  return NotReady("the server is starting: it reads the lists of models and sessions from its store");
}

}  // namespace

absl::StatusOr<std::unique_ptr<OperatorPages>> OperatorPages::Start(const std::string& listen_address,
                                                                    BuildVersion build) {
  std::unique_ptr<OperatorPages> pages(new OperatorPages(std::move(build)));
  const HttpServer::Pages made = {
      {"/metrics", [pages = pages.get()](const std::string& accept) { return pages->Metrics(accept); }},
      {"/healthz", [](const std::string&) { return HttpPage{.body = "alive\n"}; }},
      {"/readyz", [pages = pages.get()](const std::string&) { return pages->Readiness(); }},
  };
  EVPOSE_ASSIGN_OR_RETURN(pages->http_, HttpServer::Start(listen_address, made));
  return pages;
}

HttpPage OperatorPages::Metrics(const std::string& accept) const {
  const Server* const shown = server_;
  if (shown == nullptr) return Starting();
  if (PrefersOpenMetrics(accept)) {
    return {.content_type = kOpenMetricsContentType, .body = OpenMetricsText(shown->metrics(), shown->state(), build_)};
  }
  return {.content_type = kPrometheusContentType, .body = PrometheusText(shown->metrics(), shown->state(), build_)};
}

HttpPage OperatorPages::Readiness() const {
  const Server* const shown = server_;
  if (shown == nullptr) return Starting();
  const absl::Status readiness = shown->state().readiness;
  if (!readiness.ok()) return NotReady(readiness.message());
  return {.body = "ready\n"};
}

}  // namespace evpose::server
