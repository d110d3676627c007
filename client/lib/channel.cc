// SPDX-License-Identifier: Apache-2.0
#include "client/lib/channel.h"

#include <arpa/inet.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/support/client_interceptor.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "client/lib/server_address.h"
#include "core/base/certificates.h"
#include "core/base/status_macros.h"

namespace evpose::client {
namespace {

// Adds the token to the metadata of every call. The call credentials of gRPC require TLS, which a server on this
// machine may not use.
class TokenInterceptor : public grpc::experimental::Interceptor {
 public:
  // `token`: empty if there is none.
  explicit TokenInterceptor(const std::string& token) : token_(token) {}
  void Intercept(grpc::experimental::InterceptorBatchMethods* methods) override {
    const auto begin = grpc::experimental::InterceptionHookPoints::PRE_SEND_INITIAL_METADATA;
    if (!token_.empty() && methods->QueryInterceptionHookPoint(begin)) {
      methods->GetSendInitialMetadata()->emplace("authorization", "Bearer " + token_);
    }
    methods->Proceed();
  }

 private:
  const std::string token_;
};
class TokenInterceptorFactory : public grpc::experimental::ClientInterceptorFactoryInterface {
 public:
  explicit TokenInterceptorFactory(const ClientOptions& options) : renew_(options.renew_token), token_(options.token) {}
  grpc::experimental::Interceptor* CreateClientInterceptor(grpc::experimental::ClientRpcInfo*) override {
    return new TokenInterceptor(TokenOfNow());
  }

 private:
  std::string TokenOfNow() {
    absl::StatusOr<std::string> renewed = renew_ ? renew_() : absl::StatusOr<std::string>(std::string());
    const std::lock_guard lock(mutex_);
    if (renewed.ok() && !renewed->empty() && IsToken(*renewed)) token_ = *std::move(renewed);
    return token_;
  }

  const std::function<absl::StatusOr<std::string>()> renew_;
  std::mutex mutex_;
  std::string token_;  // guarded by mutex_
};

absl::StatusOr<std::shared_ptr<grpc::ChannelCredentials>> MakeCredentials(const TlsOptions& tls) {
  if (!tls.is_on) return grpc::InsecureChannelCredentials();
  EVPOSE_ASSIGN_OR_RETURN(ClientPem pem, ReadClientPem(tls.ca_file, tls.certificate_file, tls.key_file, absl::Now()));
  return grpc::SslCredentials({.pem_root_certs = std::move(pem.authorities),
                               .pem_private_key = std::move(pem.key),
                               .pem_cert_chain = std::move(pem.certificate)});
}

}  // namespace

bool ServerAddress::IsLoopback() const {
  if (host == "localhost" || host == "::1") return true;
  in_addr ipv4 = {};
  return inet_pton(AF_INET, host.c_str(), &ipv4) == 1 && (ntohl(ipv4.s_addr) >> 24) == 127;
}

absl::StatusOr<ServerAddress> ParseServerAddress(const std::string& text) {
  if (absl::StartsWithIgnoreCase(text, "http://") || absl::StartsWithIgnoreCase(text, "https://")) {
    const bool is_encrypted = absl::StartsWithIgnoreCase(text, "https://");
    absl::string_view host = absl::string_view(text).substr(text.find("://") + 3);
    host = host.substr(0, host.find('/'));
    const bool has_port = absl::StrContains(host.substr(host.rfind(']') + 1), ':');  // an IPv6 address is in brackets
    return absl::InvalidArgumentError(absl::StrCat(
        "\"", text, "\" is a URL, but the address of a server is HOST:PORT: give ", host.empty() ? "HOST" : host,
        has_port ? "" : ":PORT", is_encrypted ? "; an encrypted connection needs TLS" : ""));
  }
  const size_t colon = text.rfind(':');
  uint32_t port = 0;
  const bool is_address = colon != std::string::npos && colon > 0 && absl::SimpleAtoi(text.substr(colon + 1), &port) &&
                          port >= 1 && port <= 65535;
  if (!is_address) {
    return absl::InvalidArgumentError(absl::StrCat("\"", text, "\" is not a server address; HOST:PORT is needed"));
  }
  ServerAddress address = {text.substr(0, colon), static_cast<int>(port)};
  const bool has_brackets = absl::StartsWith(address.host, "[") && absl::EndsWith(address.host, "]");
  if (has_brackets) address.host = address.host.substr(1, address.host.size() - 2);
  return address;
}

absl::StatusOr<std::shared_ptr<grpc::Channel>> MakeChannel(const std::string& address, const ClientOptions& options,
                                                           bool shares_connection) {
  EVPOSE_ASSIGN_OR_RETURN(const ServerAddress parsed, ParseServerAddress(address));
  const bool has_token = !options.token.empty() || options.renew_token != nullptr;
  if (has_token && !options.tls.is_on && !parsed.IsLoopback()) {
    return absl::FailedPreconditionError(absl::StrCat(
        address, ": the token would travel through the network in clear: connect with TLS (--tls or --tls-ca)"));
  }
  EVPOSE_ASSIGN_OR_RETURN(const auto credentials, MakeCredentials(options.tls));
  grpc::ChannelArguments arguments;
  // A server that is starting is found within a fraction of a second.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 100);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 5000);  // timeout of one attempt, for slow links
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 1000);
  // A dead link is detected within 30 s; the server permits a ping every 10 s.
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 20'000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 10'000);
  if (!shares_connection) arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  std::vector<std::unique_ptr<grpc::experimental::ClientInterceptorFactoryInterface>> interceptors;
  if (has_token) interceptors.push_back(std::make_unique<TokenInterceptorFactory>(options));
  return grpc::experimental::CreateCustomChannelWithInterceptors(address, credentials, arguments,
                                                                 std::move(interceptors));
}

bool ConnectNow(grpc::Channel& channel, absl::Duration longest, const std::stop_token& stop) {
  constexpr absl::Duration kStopPeriod = absl::Milliseconds(50);  // a request to stop takes effect within it
  const absl::Time deadline = absl::Now() + longest;
  grpc::experimental::ChannelResetConnectionBackoff(&channel);
  bool is_connected = false;
  while (!is_connected && !stop.stop_requested() && absl::Now() < deadline) {
    is_connected = channel.WaitForConnected(absl::ToChronoTime(std::min(absl::Now() + kStopPeriod, deadline)));
  }
  return is_connected;
}

}  // namespace evpose::client
