// SPDX-License-Identifier: Apache-2.0
#include "core/base/trace_context.h"

#include <openssl/evp.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <random>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace evpose {
namespace {

constexpr size_t kTraceIdDigits = 32;
constexpr size_t kSpanIdDigits = 16;
// 00-{trace ID}-{span ID}-{flags, 2 digits}; a later version may have more behind it.
constexpr size_t kTraceIdPlace = 3;
constexpr size_t kSpanIdPlace = kTraceIdPlace + kTraceIdDigits + 1;
constexpr size_t kFlagsPlace = kSpanIdPlace + kSpanIdDigits + 1;
constexpr size_t kVersion0Length = kFlagsPlace + 2;

bool IsLowerHex(absl::string_view text) {
  return std::all_of(text.begin(), text.end(), [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

bool IsId(absl::string_view text) { return IsLowerHex(text) && text.find_first_not_of('0') != text.npos; }

bool IsLengthGood(absl::string_view version, absl::string_view header) {
  if (version == "00") return header.size() == kVersion0Length;
  return header.size() == kVersion0Length || header[kVersion0Length] == '-';
}

}  // namespace

std::string TraceIdOf(absl::string_view session) {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest = {};
  EVP_Digest(session.data(), session.size(), digest.data(), nullptr, EVP_sha256(), nullptr);
  return absl::BytesToHexString({reinterpret_cast<const char*>(digest.data()), kTraceIdDigits / 2});
}

std::string NewSpanId() {
  std::random_device device;
  uint64_t id = 0;
  while (id == 0) id = (uint64_t{device()} << 32) | device();
  return absl::StrCat(absl::Hex(id, absl::kZeroPad16));
}

std::string Traceparent(const TraceContext& context) {
  return absl::StrCat("00-", context.trace_id, "-", context.span_id, "-01");
}

std::optional<TraceContext> ParseTraceparent(absl::string_view header) {
  if (header.size() < kVersion0Length) return std::nullopt;
  const absl::string_view version = header.substr(0, 2);
  const absl::string_view trace_id = header.substr(kTraceIdPlace, kTraceIdDigits);
  const absl::string_view span_id = header.substr(kSpanIdPlace, kSpanIdDigits);
  const bool has_dashes =
      header[kTraceIdPlace - 1] == '-' && header[kSpanIdPlace - 1] == '-' && header[kFlagsPlace - 1] == '-';
  const bool is_good = has_dashes && IsLowerHex(version) && version != "ff" && IsLengthGood(version, header) &&
                       IsId(trace_id) && IsId(span_id) && IsLowerHex(header.substr(kFlagsPlace, 2));
  if (!is_good) return std::nullopt;
  return TraceContext{std::string(trace_id), std::string(span_id)};
}

}  // namespace evpose
