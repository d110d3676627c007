// SPDX-License-Identifier: Apache-2.0

// Tests ModelService through a raw stub.
#include "server/rpc/model_service.h"

#include "absl/strings/escaping.h"
#include "core/base/byte_order.h"
#include "core/numerics/hash.h"
#include "server/rpc/server_testing.h"

namespace evpose::server {
namespace {

class ModelServiceTest : public RpcTest {};

TEST_F(ModelServiceTest, RejectsInvalidPageTokensOfModels) {
  const auto list = [this](int32_t page_size, const std::string& page_token) {
    grpc::ClientContext context;
    v1::ListModelsRequest request;
    request.set_page_size(page_size);
    request.set_page_token(page_token);
    v1::ListModelsResponse response;
    return Describe(models_->ListModels(&context, request, &response));
  };
  EXPECT_EQ(list(-1, ""), "INVALID_ARGUMENT page_size");
  EXPECT_EQ(list(1, "sessions/1"), "INVALID_ARGUMENT page_token");
  EXPECT_EQ(list(1, UploadCube()), "OK");
}

TEST_F(ModelServiceTest, UploadsAModelInPiecesOnce) {
  const std::string file = kCubeObj;
  std::vector<v1::UploadModelRequest> requests = UploadRequests(file);
  requests[0].mutable_header()->set_sha256(absl::HexStringToBytes(Sha256Hex(AsBytes(file))));
  requests[1].set_chunk(file.substr(0, 100));
  requests.emplace_back().set_chunk(file.substr(100));
  v1::Model model;
  ASSERT_EQ(Describe(Upload(requests, &model)), "OK");
  EXPECT_THAT(model.name(), testing::MatchesRegex("models/[0-9a-f]{64}"));
  EXPECT_EQ(model.num_faces(), 12u);
  EXPECT_EQ(model.num_lines(), 12u);
  EXPECT_EQ(model.num_symmetries(), 24u);
  EXPECT_EQ(model.metres_per_unit(), 1.0);
  EXPECT_EQ(model.crease_angle_deg(), 30.0);
  EXPECT_NEAR(model.diameter_m(), 0.2 * std::sqrt(3.0), 1e-6);
  EXPECT_EQ(model.sha256(), requests[0].header().sha256());
  EXPECT_EQ(UploadCube(), model.name());

  grpc::ClientContext get_context;
  v1::GetModelRequest get;
  get.set_name(model.name());
  v1::Model found;
  ASSERT_EQ(Describe(models_->GetModel(&get_context, get, &found)), "OK");
  EXPECT_EQ(found.SerializeAsString(), model.SerializeAsString());
  grpc::ClientContext list_context;
  v1::ListModelsResponse list;
  ASSERT_EQ(Describe(models_->ListModels(&list_context, {}, &list)), "OK");
  EXPECT_EQ(list.models_size(), 1);
}

TEST_F(ModelServiceTest, RefusesUploadsThatAreNoModel) {
  using Spoil = std::function<void(std::vector<v1::UploadModelRequest>&)>;
  const std::vector<std::pair<std::string, Spoil>> cases = {
      {"header", [](auto& requests) { requests.clear(); }},
      {"header", [](auto& requests) { requests.erase(requests.begin()); }},
      {"header", [](auto& requests) { requests.push_back(requests[0]); }},
      {"message", [](auto& requests) { requests.emplace_back(); }},
      {"header.format", [](auto& requests) { requests[0].mutable_header()->clear_format(); }},
      {"header.size_bytes", [](auto& requests) { requests[0].mutable_header()->set_size_bytes(0); }},
      {"header.size_bytes", [](auto& requests) { requests[0].mutable_header()->set_size_bytes(1u << 20); }},
      {"header.size_bytes", [](auto& requests) { requests.pop_back(); }},
      {"header.size_bytes", [](auto& requests) { requests.push_back(requests[1]); }},
      {"header.sha256", [](auto& requests) { requests[0].mutable_header()->set_sha256("short"); }},
      {"header.sha256", [](auto& requests) { requests[0].mutable_header()->set_sha256(std::string(32, 'x')); }},
      {"header.surface", [](auto& requests) { requests[0].mutable_header()->set_surface(v1::ModelSurface(9)); }},
      {"header", [](auto& requests) { requests[0].mutable_header()->set_metres_per_unit(-1); }},
      {"header", [](auto& requests) { requests[0].mutable_header()->set_crease_angle_deg(std::nan("")); }},
      {"chunk", [](auto& requests) { requests = UploadRequests("this is no model\n"); }},
      {"chunk", [](auto& requests) { requests[0].mutable_header()->set_format(v1::MODEL_FORMAT_STL); }},
      {"chunk", [](auto& requests) { requests[0].mutable_header()->set_format(v1::MODEL_FORMAT_MESH); }},
  };
  for (const auto& [field, spoil] : cases) {
    std::vector<v1::UploadModelRequest> requests = UploadRequests(kCubeObj);
    spoil(requests);
    v1::Model model;
    const grpc::Status status = Upload(requests, &model);
    EXPECT_EQ(Describe(status), "INVALID_ARGUMENT " + field) << status.error_message();
  }
}

TEST_F(ModelServiceTest, AFullModelStoreIsAnError) {
  std::string file = kCubeObj;
  file.resize(4096, '\n');
  for (int i = 0; i < 2; ++i) {
    file[4090] = static_cast<char>('0' + i);
    file[4089] = '#';
    v1::Model model;
    ASSERT_EQ(Describe(Upload(UploadRequests(file), &model)), "OK");
  }
  v1::Model model;
  const grpc::Status status = Upload(UploadRequests(kCubeObj), &model);
  EXPECT_EQ(Describe(status), "RESOURCE_EXHAUSTED MODEL_STORE_FULL");
  EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(status).violations(0).subject(), "max_model_store_bytes");

  // A repeated upload needs no space if its header has the digest.
  EXPECT_EQ(Describe(Upload(UploadRequests(file), &model)), "RESOURCE_EXHAUSTED MODEL_STORE_FULL");
  const std::string digest = Sha256Hex(AsBytes(file));
  std::vector<v1::UploadModelRequest> known = UploadRequests(file);
  known[0].mutable_header()->set_sha256(absl::HexStringToBytes(digest));
  EXPECT_EQ(Describe(Upload(known, &model)), "OK");
  EXPECT_EQ(absl::BytesToHexString(model.sha256()), digest);
  std::string other = file;
  other.back() = ' ';
  known[1].set_chunk(other);
  EXPECT_EQ(Describe(Upload(known, &model)), "INVALID_ARGUMENT header.sha256");
  known[1].set_chunk(file.substr(1));
  EXPECT_EQ(Describe(Upload(known, &model)), "INVALID_ARGUMENT header.size_bytes");
  known[1].set_chunk(file + " ");
  EXPECT_EQ(Describe(Upload(known, &model)), "INVALID_ARGUMENT header.size_bytes");
  known[0].mutable_header()->set_crease_angle_deg(20.0);
  EXPECT_EQ(Describe(Upload(known, &model)), "RESOURCE_EXHAUSTED MODEL_STORE_FULL")
      << "other parameters make another model";
}

TEST_F(ModelServiceTest, ATenantHasItsOwnLimitOfModelBytes) {
  const std::string file = kCubeObj;
  const std::string other = "# other\n" + file;
  ServerOptions options = Options();
  options.max_model_bytes = other.size();
  options.tenant.max_model_bytes = 6000;  // of one model with what is derived from it
  Connect(options);
  v1::Model model;
  ASSERT_EQ(Describe(Upload(UploadRequests(file), &model)), "OK");
  const grpc::Status status = Upload(UploadRequests(other), &model);
  EXPECT_EQ(Describe(status), "RESOURCE_EXHAUSTED TENANT_QUOTA");
  EXPECT_EQ(DetailOf<google::rpc::QuotaFailure>(status).violations(0).subject(), "tenant_model_bytes");
}

TEST_F(ModelServiceTest, DeletesUnusedModels) {
  const CreatedSession session = CreateSession();
  v1::DeleteModelRequest request;
  request.set_name(session.config().objects(0).model());
  const auto delete_model = [&] {
    grpc::ClientContext context;
    google::protobuf::Empty response;
    return Describe(models_->DeleteModel(&context, request, &response));
  };
  EXPECT_EQ(delete_model(), "FAILED_PRECONDITION MODEL_IN_USE");
  Delete(session.name());
  EXPECT_EQ(delete_model(), "OK");
  EXPECT_EQ(delete_model(), "NOT_FOUND MODEL_NOT_FOUND");
  request.set_allow_missing(true);
  EXPECT_EQ(delete_model(), "OK") << "the first response may have been lost";
  request.set_allow_missing(false);
  grpc::ClientContext context;
  v1::GetModelRequest get;
  get.set_name(request.name());
  v1::Model model;
  EXPECT_EQ(Describe(models_->GetModel(&context, get, &model)), "NOT_FOUND MODEL_NOT_FOUND");
  request.set_name("models/never");
  EXPECT_EQ(delete_model(), "NOT_FOUND MODEL_NOT_FOUND");
}

}  // namespace
}  // namespace evpose::server
