// SPDX-License-Identifier: Apache-2.0
#include "client/lib/tls_probe.h"

#include <arpa/inet.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>
#include <unistd.h>

#include <memory>
#include <utility>
#include <vector>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "client/lib/server_address.h"
#include "client/lib/tcp_probe.h"

namespace evpose::client {
namespace {

struct Free {
  void operator()(SSL_CTX* context) const { SSL_CTX_free(context); }
  void operator()(SSL* ssl) const { SSL_free(ssl); }
  void operator()(X509* certificate) const { X509_free(certificate); }
  void operator()(GENERAL_NAMES* names) const { GENERAL_NAMES_free(names); }
};
template <typename T>
using Owned = std::unique_ptr<T, Free>;

Owned<SSL_CTX> MakeContext(const TlsOptions& tls) {
  Owned<SSL_CTX> context(SSL_CTX_new(TLS_client_method()));
  if (context == nullptr) return context;
  // The handshake continues if the server's certificate is invalid; the certificate is verified afterwards.
  SSL_CTX_set_verify(context.get(), SSL_VERIFY_NONE, nullptr);
  static constexpr unsigned char kHttp2[] = {2, 'h', '2'};
  SSL_CTX_set_alpn_protos(context.get(), kHttp2, sizeof(kHttp2));
  if (tls.ca_file.empty()) {
    SSL_CTX_set_default_verify_paths(context.get());
  } else {
    SSL_CTX_load_verify_locations(context.get(), tls.ca_file.c_str(), nullptr);
  }
  if (!tls.certificate_file.empty()) {
    SSL_CTX_use_certificate_chain_file(context.get(), tls.certificate_file.c_str());
    SSL_CTX_use_PrivateKey_file(context.get(), tls.key_file.c_str(), SSL_FILETYPE_PEM);
  }
  return context;
}

void ExpectHost(SSL* ssl, const std::string& host) {
  X509_VERIFY_PARAM* expected = SSL_get0_param(ssl);
  if (X509_VERIFY_PARAM_set1_ip_asc(expected, host.c_str()) == 1) return;
  X509_VERIFY_PARAM_set1_host(expected, host.c_str(), host.size());
  SSL_set_tlsext_host_name(ssl, host.c_str());
}

// The certificate is untrusted: control characters are escaped, and the lengths of addresses are checked.
std::string NameText(const GENERAL_NAME& name) {
  const ASN1_STRING* const value = name.type == GEN_DNS     ? name.d.dNSName
                                   : name.type == GEN_IPADD ? name.d.iPAddress
                                                            : nullptr;
  if (value == nullptr) return "";
  const unsigned char* const data = ASN1_STRING_get0_data(value);
  const auto size = static_cast<size_t>(ASN1_STRING_length(value));
  if (name.type == GEN_DNS) {
    return absl::CHexEscape(std::string(reinterpret_cast<const char*>(data), size));
  }
  if (size != sizeof(in_addr) && size != sizeof(in6_addr)) return "";
  char text[INET6_ADDRSTRLEN] = {};
  const char* const printed = inet_ntop(size == sizeof(in_addr) ? AF_INET : AF_INET6, data, text, sizeof(text));
  return printed == nullptr ? "" : printed;
}

std::string ExplainServerCertificate(SSL* ssl, const std::string& host) {
  const Owned<X509> certificate(SSL_get1_peer_certificate(ssl));
  const long result = SSL_get_verify_result(ssl);
  switch (result) {
    case X509_V_OK:
      return "";
    case X509_V_ERR_HOSTNAME_MISMATCH:
    case X509_V_ERR_IP_ADDRESS_MISMATCH:
      return absl::StrCat("its certificate is not for ", host, " but for ", HostsOf(certificate.get()),
                          ": connect to one of these names, or use a certificate for this name");
    case X509_V_ERR_CERT_HAS_EXPIRED:
      return "its certificate has expired: the server's operator must renew it";
    case X509_V_ERR_CERT_NOT_YET_VALID:
      return "its certificate is not valid yet: check the clock of this machine";
    case X509_V_ERR_UNABLE_TO_GET_ISSUER_CERT:
    case X509_V_ERR_UNABLE_TO_GET_ISSUER_CERT_LOCALLY:
    case X509_V_ERR_UNABLE_TO_VERIFY_LEAF_SIGNATURE:
    case X509_V_ERR_CERT_SIGNATURE_FAILURE:
    case X509_V_ERR_DEPTH_ZERO_SELF_SIGNED_CERT:
    case X509_V_ERR_SELF_SIGNED_CERT_IN_CHAIN:
      return "its certificate is signed by an authority that this machine does not trust: give the authority's "
             "certificate with --tls-ca";
    default:
      return absl::StrCat("its certificate cannot be verified: ", X509_verify_cert_error_string(result));
  }
}

// A server refuses the client's certificate after the handshake has succeeded for the client. A gRPC server sends the
// first bytes in HTTP/2, so that the end of the connection before them is a refusal, with an alert for the reason or,
// as with gRPC 1.51, without.
std::string ExplainClientCertificate(SSL* ssl, const TlsOptions& tls) {
  char byte = 0;
  const int result = SSL_read(ssl, &byte, 1);
  if (result > 0 || SSL_get_error(ssl, result) == SSL_ERROR_WANT_READ) return "";  // timeout without data
  if (tls.certificate_file.empty()) return "it requires a certificate from its clients: give --tls-cert and --tls-key";
  return absl::StrCat("it rejects the certificate ", tls.certificate_file,
                      ": the certificate must be valid and signed by an authority in the server's --tls-client-ca");
}

std::string ExplainHandshake() {
  const unsigned long error = ERR_peek_error();
  const int reason = ERR_GET_REASON(error);
  const bool is_of_tls = ERR_GET_LIB(error) == ERR_LIB_SSL && reason != SSL_R_WRONG_VERSION_NUMBER &&
                         reason != SSL_R_UNEXPECTED_EOF_WHILE_READING;
  if (is_of_tls) return absl::StrCat("the TLS handshake fails: ", ERR_reason_error_string(error));
  return "it does not use TLS: omit --tls and --tls-ca if an unencrypted connection is intended";
}

}  // namespace

std::string HostsOf(const X509* certificate) {
  const Owned<GENERAL_NAMES> names(
      static_cast<GENERAL_NAMES*>(X509_get_ext_d2i(certificate, NID_subject_alt_name, nullptr, nullptr)));
  std::vector<std::string> texts;
  for (int i = 0; i < sk_GENERAL_NAME_num(names.get()); ++i) {
    std::string text = NameText(*sk_GENERAL_NAME_value(names.get(), i));
    if (!text.empty()) texts.push_back(std::move(text));
  }
  return texts.empty() ? "no host" : absl::StrJoin(texts, ", ");
}

std::string ExplainTls(const std::string& address, const TlsOptions& tls, absl::Duration timeout) {
  const auto parsed = ParseServerAddress(address);
  TcpFailure failure;
  const int fd = parsed.ok() ? ConnectTcp(*parsed, timeout, failure) : -1;
  if (fd < 0) return "";
  const absl::Cleanup close_socket = [fd] { close(fd); };
  ERR_clear_error();
  const absl::Cleanup clear_errors = [] { ERR_clear_error(); };
  const Owned<SSL_CTX> context = MakeContext(tls);
  const Owned<SSL> ssl(context == nullptr ? nullptr : SSL_new(context.get()));
  if (ssl == nullptr || SSL_set_fd(ssl.get(), fd) != 1) return "";
  ExpectHost(ssl.get(), parsed->host);
  ERR_clear_error();
  const bool has_tls = SSL_connect(ssl.get()) == 1;
  if (!tls.is_on) return has_tls ? "it requires TLS: give --tls, or --tls-ca with the authority's certificate" : "";
  if (!has_tls) return ExplainHandshake();
  std::string why = ExplainServerCertificate(ssl.get(), parsed->host);
  return why.empty() ? ExplainClientCertificate(ssl.get(), tls) : why;
}

}  // namespace evpose::client
