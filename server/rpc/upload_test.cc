// SPDX-License-Identifier: Apache-2.0

// Uploads of models as calls.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <future>

#include "absl/strings/escaping.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "core/base/byte_order.h"
#include "core/base/poll_testing.h"
#include "core/numerics/hash.h"
#include "evpose/v1/mesh.pb.h"
#include "server/rpc/server_testing.h"
#include "server/runtime/failing_allocations_testing.h"
#include "server/sessions/store_testing.h"
#include "server/stores/memory/memory_store.h"

namespace evpose::server {
namespace {

class UploadTest : public RpcTest {};

TEST_F(UploadTest, AnUploadHasADeadlineForTheWholeFile) {
  ServerOptions options = Options();
  options.attach_timeout = absl::Hours(1);
  options.upload_timeout = absl::Milliseconds(50);
  server_ = StartServer(options, FakeTrackers(gate_)).value();
  Use(server_->InProcessChannel());
  grpc::ClientContext context;
  v1::Model model;
  const auto stream = models_->UploadModel(&context, &model);
  v1::UploadModelRequest request = UploadHeader(options.max_model_bytes);
  for (bool is_open = stream->Write(request); is_open; is_open = stream->Write(request)) {
    request.set_chunk("");  // each message arrives in time
  }
  const grpc::Status status = stream->Finish();
  EXPECT_EQ(Describe(status), "DEADLINE_EXCEEDED UPLOAD_TIMEOUT");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("the file did not arrive within"));
}

// The cube of kCubeObj, whose faces are quadrilaterals.
v1::Mesh CubeMesh() {
  v1::Mesh mesh;
  for (int i = 0; i < 8; ++i) {
    for (const int bit : {1, 2, 4}) mesh.add_positions((i & bit) != 0 ? 0.1f : -0.1f);
  }
  for (const auto& [a, b, c, d] : {std::array{0, 2, 3, 1}, std::array{4, 5, 7, 6}, std::array{0, 1, 5, 4},
                                   std::array{2, 6, 7, 3}, std::array{0, 4, 6, 2}, std::array{1, 3, 7, 5}}) {
    for (const int corner : {a, b, c, a, c, d}) mesh.add_triangles(static_cast<uint32_t>(corner));
  }
  return mesh;
}

TEST_F(UploadTest, TheEndOfTheServerEndsAnUploadUnderWay) {
  ServerOptions options = Options();
  options.max_model_store_bytes = options.max_model_bytes;
  ConnectThroughSocket(options);
  grpc::ClientContext context;
  v1::Model model, other;
  const auto upload = models_->UploadModel(&context, &model);
  ASSERT_TRUE(WriteAllButOneByte(*upload, options.max_model_bytes));
  ASSERT_TRUE(
      Poll([&] { return Describe(Upload({UploadHeader(2)}, &other)) == "RESOURCE_EXHAUSTED MODEL_STORE_FULL"; }));
  auto end = std::async(std::launch::async, [&upload] { return Describe(upload->Finish()); });
  server_->Shutdown(absl::Seconds(1));
  EXPECT_EQ(end.get(), "UNAVAILABLE DRAINING");
}

TEST_F(UploadTest, UploadsAMesh) {
  v1::Model model;
  std::vector<v1::UploadModelRequest> requests = MeshUploadRequests(CubeMesh().SerializeAsString());
  ASSERT_EQ(Describe(Upload(requests, &model)), "OK");
  EXPECT_EQ(model.format(), v1::MODEL_FORMAT_MESH);
  EXPECT_EQ(model.surface(), v1::MODEL_SURFACE_SMOOTH);
  EXPECT_EQ(model.num_faces(), 12u);
  EXPECT_EQ(model.num_lines(), 12u);
  EXPECT_EQ(model.num_curves(), 0u);
  EXPECT_EQ(model.file_name(), "");
  EXPECT_EQ(model.num_symmetries(), 24u);
  EXPECT_NEAR(model.diameter_m(), 0.2 * std::sqrt(3.0), 1e-6);
  requests[0].mutable_header()->set_surface(v1::MODEL_SURFACE_AS_IS);
  v1::Model as_is;
  ASSERT_EQ(Describe(Upload(requests, &as_is)), "OK");
  EXPECT_EQ(as_is.surface(), v1::MODEL_SURFACE_AS_IS);
  EXPECT_NE(as_is.name(), model.name());
}

TEST_F(UploadTest, AFileNameIsPlainText) {
  std::vector<v1::UploadModelRequest> requests = MeshUploadRequests(CubeMesh().SerializeAsString());
  v1::Model model;
  const std::pair<std::string, std::string> errors[] = {
      {std::string(256, 'a'), "header.file_name: has 256 bytes; a file name has at most 255"},
      {"a\nb", "header.file_name: has a character that is not printable: remove it"}};
  for (const auto& [name, error] : errors) {
    requests[0].mutable_header()->set_file_name(name);
    const grpc::Status status = Upload(requests, &model);
    EXPECT_EQ(Describe(status), "INVALID_ARGUMENT header.file_name");
    EXPECT_EQ(status.error_message(), error);
  }
  requests[0].mutable_header()->set_file_name("cube of steel.stl");
  ASSERT_EQ(Describe(Upload(requests, &model)), "OK");
  EXPECT_EQ(model.file_name(), "cube of steel.stl");
}

TEST_F(UploadTest, RefusesAMeshWithItsFieldAndIndex) {
  v1::Mesh mesh = CubeMesh();
  mesh.set_triangles(7, 8);
  v1::Model model;
  const grpc::Status status = Upload(MeshUploadRequests(mesh.SerializeAsString()), &model);
  EXPECT_EQ(Describe(status), "INVALID_ARGUMENT chunk");
  EXPECT_THAT(status.error_message(), testing::HasSubstr("Mesh.triangles[7]: is 8, but there are 8 points"));
}

// A shared store with a function that is called on the thread that has searched for a model.
class StoreWithHook : public FaultInjectingStore {
 public:
  explicit StoreWithHook(std::function<void()> on_search)
      : FaultInjectingStore(MakeMemoryStore(), std::make_shared<InjectedFault>()), on_search_(std::move(on_search)) {}
  absl::StatusOr<bool> HasModel(absl::string_view tenant, absl::string_view name) const override {
    auto has_model = FaultInjectingStore::HasModel(tenant, name);
    on_search_();
    return has_model;
  }

 private:
  const std::function<void()> on_search_;
};

// The second upload of a file, for which the server only asks its store.
class KnownFileTest : public RpcTest {
 protected:
  KnownFileTest() {
    ServerOptions options = Options();
    options.tenant.max_uploads = 1;
    server_ =
        StartServer(options, FakeTrackers(gate_), std::make_unique<StoreWithHook>([this] { on_search_(); })).value();
    Use(server_->InProcessChannel());
    UploadCube();
    known_[0].mutable_header()->set_sha256(absl::HexStringToBytes(Sha256Hex(AsBytes(kCubeObj))));
  }
  // "INVALID_ARGUMENT header.size_bytes" if the upload has got a place, because the file is missing.
  std::string BeginUpload() {
    v1::Model model;
    return Describe(Upload({UploadHeader(100)}, &model));
  }

  std::function<void()> on_search_ = [] {};
  std::vector<v1::UploadModelRequest> known_ = UploadRequests(kCubeObj);
};

TEST_F(KnownFileTest, WithoutMemoryForTheResponseTheCallEndsAndReleasesItsPlace) {
  on_search_ = [] { ThisThreadsFailingAllocation().successes_before = 0; };
  v1::Model model;
  EXPECT_EQ(Describe(Upload(known_, &model)), "RESOURCE_EXHAUSTED OUT_OF_MEMORY");
  on_search_ = [] {};
  EXPECT_EQ(BeginUpload(), "INVALID_ARGUMENT header.size_bytes");
  EXPECT_EQ(Describe(Upload(known_, &model)), "OK");
}

TEST_F(KnownFileTest, ACancelledCallEndsWhileTheStoreDoesNotRespond) {
  std::promise<void> has_begun, may_end;
  on_search_ = [&] {
    has_begun.set_value();
    may_end.get_future().wait();
  };
  grpc::ClientContext context;
  v1::Model model;
  const auto stream = models_->UploadModel(&context, &model);
  for (const v1::UploadModelRequest& request : known_) stream->Write(request);
  stream->WritesDone();
  has_begun.get_future().wait();
  context.TryCancel();
  EXPECT_EQ(stream->Finish().error_code(), grpc::StatusCode::CANCELLED);
  // The server learns of it a little later.
  std::string begun;
  EXPECT_TRUE(Poll([&] {
    begun = BeginUpload();
    return begun != "RESOURCE_EXHAUSTED TENANT_QUOTA";
  }));
  EXPECT_EQ(begun, "INVALID_ARGUMENT header.size_bytes");
  may_end.set_value();
  server_.reset();  // waits for the thread that uses both promises
}

}  // namespace
}  // namespace evpose::server
