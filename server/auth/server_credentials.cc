// SPDX-License-Identifier: Apache-2.0
#include "server/auth/server_credentials.h"

#include <grpc/grpc.h>
#include <grpc/grpc_security.h>

#include <string>
#include <utility>

namespace evpose::server {
namespace {

class TlsServerCredentials : public grpc::ServerCredentials {
 public:
  TlsServerCredentials(std::unique_ptr<TlsFiles> files, bool has_client_certificates)
      : files_(std::move(files)),
        credentials_(grpc_ssl_server_credentials_create_with_options(
            grpc_ssl_server_credentials_create_options_using_config_fetcher(
                has_client_certificates ? GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY
                                        : GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE,
                Fetch, this))) {}

  ~TlsServerCredentials() override { grpc_server_credentials_release(credentials_); }
  TlsServerCredentials(const TlsServerCredentials&) = delete;
  TlsServerCredentials& operator=(const TlsServerCredentials&) = delete;

  // Not supported: the services authenticate calls, because their errors carry details and those of a processor cannot.
  void SetAuthMetadataProcessor(const std::shared_ptr<grpc::AuthMetadataProcessor>&) override {}

 private:
  int AddPortToServer(const std::string& address, grpc_server* server) override {
    return grpc_server_add_http2_port(server, address.c_str(), credentials_);
  }

  // gRPC calls this function under a lock, so one call at a time; the first call is made when the port is added.
  static grpc_ssl_certificate_config_reload_status Fetch(void* self, grpc_ssl_server_certificate_config** config) {
    return static_cast<TlsServerCredentials*>(self)->FetchConfig(config);
  }
  grpc_ssl_certificate_config_reload_status FetchConfig(grpc_ssl_server_certificate_config** config) {
    std::shared_ptr<const TlsMaterial> material = files_->Current();
    if (material == material_in_use_) return GRPC_SSL_CERTIFICATE_CONFIG_RELOAD_UNCHANGED;
    const grpc_ssl_pem_key_cert_pair pair = {material->key_pem.c_str(), material->certificate_pem.c_str()};
    // gRPC 1.51 asserts that authorities are given, even when client certificates are not requested and the authorities
    // are not used.
    const std::string& authorities =
        material->client_ca_pem.empty() ? material->certificate_pem : material->client_ca_pem;
    *config = grpc_ssl_server_certificate_config_create(authorities.c_str(), &pair, 1);
    material_in_use_ = std::move(material);
    return GRPC_SSL_CERTIFICATE_CONFIG_RELOAD_NEW;
  }

  const std::unique_ptr<TlsFiles> files_;
  std::shared_ptr<const TlsMaterial> material_in_use_;
  grpc_server_credentials* const credentials_;
};

}  // namespace

std::shared_ptr<grpc::ServerCredentials> MakeTlsServerCredentials(std::unique_ptr<TlsFiles> files,
                                                                  bool has_client_certificates) {
  return std::make_shared<TlsServerCredentials>(std::move(files), has_client_certificates);
}

}  // namespace evpose::server
