// SPDX-License-Identifier: Apache-2.0

// Tests ModelService.GetModelGeometry through raw stubs.
#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <functional>
#include <future>

#include "server/rpc/model_geometry_reactor.h"
#include "server/rpc/server_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

class ModelGeometryTest : public RpcTest {
 protected:
  grpc::Status Geometry(const std::string& model, uint32_t max_faces, v1::ModelGeometry* geometry) {
    grpc::ClientContext context;
    v1::GetModelGeometryRequest request;
    request.set_name(model);
    request.set_max_faces(max_faces);
    return models_->GetModelGeometry(&context, request, geometry);
  }
};

TEST_F(ModelGeometryTest, ReturnsTheMeshAndTheEdgesInMetres) {
  v1::ModelGeometry geometry;
  ASSERT_EQ(Describe(Geometry(UploadCube(), 0, &geometry)), "OK");
  EXPECT_EQ(geometry.vertices_m_size(), 3 * 8);
  EXPECT_EQ(geometry.faces_size(), 3 * 12);
  EXPECT_EQ(geometry.edges_m_size(), 6 * 12);
  EXPECT_FALSE(geometry.simplified());
  EXPECT_LT(*std::max_element(geometry.faces().begin(), geometry.faces().end()), 8u);
  const auto [low, high] = std::minmax_element(geometry.vertices_m().begin(), geometry.vertices_m().end());
  const auto [edge_low, edge_high] = std::minmax_element(geometry.edges_m().begin(), geometry.edges_m().end());
  EXPECT_EQ(*low, *edge_low);
  EXPECT_EQ(*high, *edge_high);
  // A session uses the model meanwhile.
  CreateSession();
  v1::ModelGeometry again;
  ASSERT_EQ(Describe(Geometry(UploadCube(), 100'000, &again)), "OK");
  EXPECT_EQ(again.SerializeAsString(), geometry.SerializeAsString());
}

TEST_F(ModelGeometryTest, SimplifiesToTheRequestedNumberOfFaces) {
  v1::ModelGeometry geometry;
  ASSERT_EQ(Describe(Geometry(UploadCube(), 4, &geometry)), "OK");
  EXPECT_TRUE(geometry.simplified());
  EXPECT_LE(geometry.faces_size(), 3 * 4);
  EXPECT_EQ(geometry.edges_m_size(), 6 * 12) << "the edges stay";
}

TEST_F(ModelGeometryTest, RequestsThatCannotBeServedReceiveAnError) {
  const std::string cube = UploadCube();
  v1::ModelGeometry geometry;
  EXPECT_EQ(Describe(Geometry(cube, 100'001, &geometry)), "INVALID_ARGUMENT max_faces");
  EXPECT_EQ(Describe(Geometry("models/unknown", 0, &geometry)), "NOT_FOUND MODEL_NOT_FOUND");
  EXPECT_EQ(Describe(Geometry("", 0, &geometry)), "NOT_FOUND MODEL_NOT_FOUND");
}

TEST_F(ModelGeometryTest, TheModelCountsAgainstTheMemoryOfSessions) {
  v1::ModelGeometry geometry;
  EXPECT_EQ(Describe(Geometry(UploadCube(), 0, &geometry)), "OK");
  EXPECT_EQ(server_->state().session_memory_bytes, 0u) << "only meanwhile";
  CreateSession();
  ServerOptions options = Options();
  options.max_session_memory = server_->state().session_memory_bytes + 1000;
  Connect(options);
  CreateSession();
  EXPECT_EQ(Describe(Geometry(UploadCube(), 0, &geometry)), "OK") << "the session was charged with this model";
  v1::Model other;
  ASSERT_EQ(Describe(Upload(UploadRequests(std::string(kCubeObj) + "# another\n"), &other)), "OK");
  EXPECT_EQ(Describe(Geometry(other.name(), 0, &geometry)), "RESOURCE_EXHAUSTED SESSION_MEMORY");
  EXPECT_EQ(server_->state().session_memory_bytes, options.max_session_memory - 1000);
}

TEST_F(ModelGeometryTest, AModelCanBeDeletedAfterwards) {
  const std::string cube = UploadCube();
  v1::ModelGeometry geometry;
  ASSERT_EQ(Describe(Geometry(cube, 0, &geometry)), "OK");
  grpc::ClientContext context;
  v1::DeleteModelRequest request;
  request.set_name(cube);
  google::protobuf::Empty response;
  EXPECT_EQ(Describe(models_->DeleteModel(&context, request, &response)), "OK");
  EXPECT_EQ(Describe(Geometry(cube, 0, &geometry)), "NOT_FOUND MODEL_NOT_FOUND");
}

// A store that calls a function of the test when it reads a model, and that can return an error.
class WatchedStore : public FaultInjectingStore {
 public:
  explicit WatchedStore(std::shared_ptr<Store> store,
                        std::shared_ptr<InjectedFault> of_store = std::make_shared<InjectedFault>())
      : FaultInjectingStore(std::move(store), of_store), fault(std::move(of_store)) {}
  absl::StatusOr<ModelRecord> ReadModel(absl::string_view tenant, absl::string_view name) const override {
    on_read();
    return FaultInjectingStore::ReadModel(tenant, name);
  }
  std::function<void()> on_read = [] {};
  const std::shared_ptr<InjectedFault> fault;
};

// The method, with the threads of the test.
class GeometryReactorTest : public ::testing::Test, public v1::ModelService::CallbackService {
 protected:
  GeometryReactorTest() {
    // The models of a server that has not loaded any.
    const std::string obj = kCubeObj;
    name_ = ModelRegistry::Create({}, store_)
                .value()
                ->Upload("", {}, "", std::make_shared<std::vector<uint8_t>>(obj.begin(), obj.end()))
                .value()
                .name;
    models_ = ModelRegistry::Create({}, store_).value();
    grpc::ServerBuilder builder;
    builder.RegisterService(this);
    server_ = builder.BuildAndStart();
    call_ =
        std::async(std::launch::async,
                   [stub = std::shared_ptr(v1::ModelService::NewStub(server_->InProcessChannel({}))), name = name_] {
                     grpc::ClientContext context;
                     v1::GetModelGeometryRequest request;
                     request.set_name(name);
                     v1::ModelGeometry geometry;
                     return Describe(stub->GetModelGeometry(&context, request, &geometry));
                   });
    reactor_ = started_.get_future().get();
  }
  grpc::ServerUnaryReactor* GetModelGeometry(grpc::CallbackServerContext* context,
                                             const v1::GetModelGeometryRequest* request,
                                             v1::ModelGeometry* response) override {
    auto* const reactor = StartGetModelGeometry(*models_, preparations_, *memory_, {quotas_, absl::Hours(1)}, Caller(),
                                                *context, *request, *response);
    started_.set_value(reactor);
    return reactor;
  }

  // The result of the call when the store returns this error.
  std::string ResultAfter(const absl::Status& error) {
    store_.fault->Set(error);
    threads_.run();
    return call_.get();
  }

  boost::asio::io_context threads_;
  SlowExecutor preparations_{threads_.get_executor(), {.running = 1}};
  WatchedStore store_{MakeMemoryStore()};
  std::shared_ptr<MemoryBudget> memory_ = MemoryBudget::Create({});
  TenantQuotas quotas_{{}};
  std::unique_ptr<ModelRegistry> models_;
  std::string name_;
  std::unique_ptr<grpc::Server> server_;
  std::promise<grpc::ServerUnaryReactor*> started_;
  std::future<std::string> call_;
  grpc::ServerUnaryReactor* reactor_ = nullptr;
};

TEST_F(GeometryReactorTest, WithoutACancellationItIsAnswered) {
  threads_.run();
  EXPECT_EQ(call_.get(), "OK");
}

TEST_F(GeometryReactorTest, ACallThatWaitsIsNotBegun) {
  store_.on_read = [] { ADD_FAILURE() << "the model is read"; };
  reactor_->OnCancel();
  threads_.run();
  EXPECT_EQ(call_.get(), "CANCELLED");
}

TEST_F(GeometryReactorTest, ACallThatReadsTheModelEndsBehindIt) {
  store_.on_read = [this] { reactor_->OnCancel(); };
  threads_.run();
  EXPECT_EQ(call_.get(), "CANCELLED");
}

TEST_F(GeometryReactorTest, AStoreThatDoesNotRespondIsUnavailable) {
  EXPECT_EQ(ResultAfter(absl::UnavailableError("gone")), "UNAVAILABLE STORE_UNAVAILABLE");
}

TEST_F(GeometryReactorTest, AStoreThatFailsIsAnInternalError) {
  EXPECT_EQ(ResultAfter(absl::InternalError("bad page")), "INTERNAL STORE_FAILED");
}

TEST_F(GeometryReactorTest, ADamagedModelHasAReason) {
  EXPECT_EQ(ResultAfter(absl::DataLossError("the model is damaged")), "DATA_LOSS MODEL_DAMAGED");
}

TEST_F(GeometryReactorTest, AServerThatShutsDownStartsNoCall) {
  preparations_.Stop();
  threads_.run();
  EXPECT_EQ(call_.get(), "UNAVAILABLE DRAINING");
}

}  // namespace
}  // namespace evpose::server
