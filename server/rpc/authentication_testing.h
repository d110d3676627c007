// SPDX-License-Identifier: Apache-2.0

// Servers with tokens and certificates, and their clients, for tests.
#pragma once

#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/support/client_interceptor.h>

#include <future>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/base/certificates_testing.h"
#include "server/auth/files_testing.h"
#include "server/auth/token_file.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {

// Adds the metadata "authorization" to every call of a channel.
class TokenInterceptor : public grpc::experimental::Interceptor {
 public:
  explicit TokenInterceptor(const std::string& value) : value_(value) {}
  void Intercept(grpc::experimental::InterceptorBatchMethods* methods) override {
    using grpc::experimental::InterceptionHookPoints;
    if (methods->QueryInterceptionHookPoint(InterceptionHookPoints::PRE_SEND_INITIAL_METADATA)) {
      methods->GetSendInitialMetadata()->emplace("authorization", value_);
    }
    methods->Proceed();
  }

 private:
  const std::string value_;
};
class TokenInterceptorFactory : public grpc::experimental::ClientInterceptorFactoryInterface {
 public:
  explicit TokenInterceptorFactory(const std::string& value) : value_(value) {}
  grpc::experimental::Interceptor* CreateClientInterceptor(grpc::experimental::ClientRpcInfo*) override {
    return new TokenInterceptor(value_);
  }

 private:
  const std::string value_;
};

// Opens a new connection. `token` empty: without a token.
inline std::shared_ptr<grpc::Channel> OpenChannel(int port, const std::string& token,
                                                  const std::shared_ptr<grpc::ChannelCredentials>& credentials) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  std::vector<std::unique_ptr<grpc::experimental::ClientInterceptorFactoryInterface>> interceptors;
  if (!token.empty()) interceptors.push_back(std::make_unique<TokenInterceptorFactory>("Bearer " + token));
  return grpc::experimental::CreateCustomChannelWithInterceptors("localhost:" + std::to_string(port), credentials,
                                                                 arguments, std::move(interceptors));
}
inline std::shared_ptr<grpc::Channel> OpenChannel(int port, const std::string& token) {
  return OpenChannel(port, token, grpc::InsecureChannelCredentials());
}

inline std::shared_ptr<grpc::ChannelCredentials> Tls(const std::string& ca_pem, const TestCertificate& own = {}) {
  return grpc::SslCredentials({ca_pem, own.key_pem, own.certificate_pem});
}

// Calls any method with one empty message, and closes the client's half.
inline grpc::Status CallWithEmptyMessage(const std::shared_ptr<grpc::Channel>& channel, const std::string& method) {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  grpc::ByteBuffer request, response;
  const grpc::Slice nothing;
  request = grpc::ByteBuffer(&nothing, 1);
  std::promise<grpc::Status> done;
  stub.UnaryCall(&context, method, grpc::StubOptions(), &request, &response,
                 [&done](grpc::Status status) { done.set_value(std::move(status)); });
  return done.get_future().get();
}

class TokensTest : public RpcTest {
 protected:
  TokensTest() : TokensTest(Options()) {}
  explicit TokensTest(ServerOptions options) : RpcTest(WithoutSocket()) {
    options.listen_address = "127.0.0.1:0";
    options.token_file = WriteTokens({lab_, field_, operator_});
    server_ = StartServer(options, FakeTrackers(gate_)).value();
    Use(OpenChannel(server_->port(), lab_.token));
  }
  static ServerOptions WithoutSocket() { return Options(); }

  std::string WriteTokens(const std::vector<NewToken>& tokens) const {
    std::string text;
    for (const NewToken& token : tokens) text += token.line + "\n";
    return files_.Write("tokens", text);
  }

  const TestFiles files_;
  const NewToken lab_ = MakeToken("lab", false).value();
  const NewToken field_ = MakeToken("field", false).value();
  const NewToken operator_ = MakeToken("admin", true).value();
};

class TlsTest : public RpcTest {
 protected:
  ServerOptions TlsOptions(bool has_client_ca) {
    ServerOptions options = Options();
    options.listen_address = "127.0.0.1:0";
    Write(authority_.Issue());
    options.tls = {files_.Path("server.crt"), files_.Path("server.key"), ""};
    if (has_client_ca) options.tls.client_ca = files_.Write("clients.crt", clients_.pem());
    return options;
  }
  void Start(const ServerOptions& options) { server_ = StartServer(options, FakeTrackers(gate_)).value(); }
  void Write(const TestCertificate& certificate) {
    files_.Write("server.crt", certificate.certificate_pem);
    files_.Write("server.key", certificate.key_pem);
    certificate_pem_ = certificate.certificate_pem;
  }
  std::shared_ptr<grpc::Channel> ConnectTls(const std::string& token = "", const TestCertificate& own = {}) {
    return OpenChannel(server_->port(), token, Tls(authority_.pem(), own));
  }
  // Calls GetServerInfo and returns the status. `shown_pem` receives the certificate of the server.
  static std::string Call(const std::shared_ptr<grpc::Channel>& channel, std::string* shown_pem = nullptr) {
    grpc::ClientContext context;
    v1::ServerInfo info;
    const grpc::Status status = v1::AdminService::NewStub(channel)->GetServerInfo(&context, {}, &info);
    if (shown_pem != nullptr && context.auth_context() != nullptr) {
      const auto shown = context.auth_context()->FindPropertyValues(GRPC_X509_PEM_CERT_PROPERTY_NAME);
      if (!shown.empty()) *shown_pem = std::string(shown[0].data(), shown[0].size());
    }
    return Describe(status);
  }

  const TestFiles files_;
  const TestAuthority authority_;
  const TestAuthority clients_{"clients"};
  std::string certificate_pem_;
};

}  // namespace evpose::server
