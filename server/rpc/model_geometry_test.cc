// SPDX-License-Identifier: Apache-2.0

// Tests ModelService.GetModelGeometry through raw stubs.
#include <algorithm>

#include "server/rpc/server_testing.h"

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
  EXPECT_FALSE(geometry.is_simplified());
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
  EXPECT_TRUE(geometry.is_simplified());
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

}  // namespace
}  // namespace evpose::server
