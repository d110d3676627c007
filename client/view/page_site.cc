// SPDX-License-Identifier: Apache-2.0
#include "client/view/page_site.h"

#include <zlib.h>

#include <algorithm>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/cleanup/cleanup.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "server/runtime/random_name.h"

namespace evpose::client {
namespace {

constexpr absl::string_view kHttpPort = ":80";   // browsers leave it out
constexpr int kGzipWindowBits = 16 + MAX_WBITS;  // zlib: a gzip header, with any window

}  // namespace

bool AcceptsGzip(absl::string_view accept_encoding) {
  for (const absl::string_view part : absl::StrSplit(accept_encoding, ',')) {
    const std::pair<absl::string_view, absl::string_view> coding = absl::StrSplit(part, absl::MaxSplits(';', 1));
    if (!absl::EqualsIgnoreCase(absl::StripAsciiWhitespace(coding.first), "gzip")) continue;
    // A weight of 0 excludes the coding.
    absl::string_view weight = absl::StripAsciiWhitespace(coding.second);
    double value = 1.0;
    return !absl::ConsumePrefix(&weight, "q=") || !absl::SimpleAtod(weight, &value) || value > 0.0;
  }
  return false;
}

absl::StatusOr<std::string> Decompress(absl::string_view bytes) {
  z_stream stream = {};
  if (inflateInit2(&stream, kGzipWindowBits) != Z_OK) return absl::ResourceExhaustedError("no memory for a file\n");
  const absl::Cleanup end = [&stream] { inflateEnd(&stream); };
  stream.next_in = const_cast<Bytef*>(reinterpret_cast<const Bytef*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  std::string plain;
  int result = Z_OK;
  while (result == Z_OK) {
    char piece[16384];
    stream.next_out = reinterpret_cast<Bytef*>(piece);
    stream.avail_out = sizeof(piece);
    result = inflate(&stream, Z_NO_FLUSH);
    plain.append(piece, sizeof(piece) - stream.avail_out);
  }
  if (result == Z_STREAM_END) return plain;
  return absl::InternalError("a file of the page in this program is damaged\n");
}

PageSite::PageSite(absl::Span<const PageFile> files, const server::ListenAddress& address,
                   const std::vector<std::string>& hosts, std::string key)
    : files_(files.begin(), files.end()), key_(std::move(key)) {
  for (const std::string& name : {address.host, std::string("127.0.0.1"), std::string("localhost")}) {
    const std::string host = absl::AsciiStrToLower(server::ListenAddress{name, address.port}.WithPort(address.port));
    if (absl::c_linear_search(hosts_, host)) continue;
    hosts_.push_back(host);
    if (absl::EndsWith(host, kHttpPort)) hosts_.emplace_back(absl::StripSuffix(host, kHttpPort));
  }
  for (const std::string& host : hosts) hosts_.push_back(absl::AsciiStrToLower(host));
}

absl::Status PageSite::CheckHost(absl::string_view host) const {
  if (absl::c_linear_search(hosts_, absl::AsciiStrToLower(host))) return absl::OkStatus();
  return absl::PermissionDeniedError(absl::StrCat("this page is served as ", absl::StrJoin(hosts_, ", "),
                                                  " only; evpose view --allow-host NAME:PORT permits another name\n"));
}

absl::Status PageSite::CheckOrigin(absl::string_view origin, absl::string_view host) const {
  for (const char* const scheme : {"http://", "https://"}) {
    if (absl::AsciiStrToLower(origin) == absl::AsciiStrToLower(absl::StrCat(scheme, host))) return absl::OkStatus();
  }
  return absl::PermissionDeniedError("only the page of this server may open its stream\n");
}

bool PageSite::IsKey(absl::string_view key) const { return server::SecretsEqual(key, key_); }

const PageFile* PageSite::Find(absl::string_view target) const {
  const absl::string_view path = target.substr(0, target.find('?'));
  const auto found =
      std::find_if(files_.begin(), files_.end(), [path](const PageFile& file) { return file.path == path; });
  return found == files_.end() ? nullptr : &*found;
}

std::vector<std::pair<std::string, std::string>> PageSite::Headers(absl::string_view host) const {
  // Not all browsers take a WebSocket of the same host as 'self', so that its address is given, too; a policy cannot
  // have IPv6 addresses.
  const bool is_ipv6 = absl::StartsWith(host, "[");
  const std::string policy =
      absl::StrCat("default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'",
                   is_ipv6 ? "" : absl::StrCat(" ws://", host, " wss://", host),
                   "; frame-ancestors 'none'; base-uri 'none'; form-action 'none'");
  return {{"Content-Security-Policy", policy},
          {"X-Content-Type-Options", "nosniff"},
          {"Referrer-Policy", "no-referrer"},
          {"Cross-Origin-Opener-Policy", "same-origin"},
          {"Cross-Origin-Resource-Policy", "same-origin"},
          {"Cache-Control", "no-store"}};
}

}  // namespace evpose::client
