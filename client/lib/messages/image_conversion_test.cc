// SPDX-License-Identifier: Apache-2.0

// Images of events and geometries, as a server sends them and as no server should.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <cmath>
#include <functional>
#include <string>

#include "client/lib/messages/conversion.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

// 3 x 3 cells: the values 0, 1, 2, 3, 0, ...
v1::EventImage SmallImage() {
  v1::EventImage image;
  image.set_from_t_us(10);
  image.set_to_t_us(20);
  image.set_cell_px(2);
  image.set_width(3);
  image.set_height(3);
  image.set_num_events(6);
  image.set_num_skipped(1);
  image.set_encoding(v1::EventImage::ENCODING_PACKED);
  image.set_cells(std::string("\xe4\xe4\x00", 3));
  v1::ObjectOutline& outline = *image.add_outlines();
  outline.set_object_id("cube");
  outline.set_state(v1::TRACK_STATE_DEGRADED);
  outline.set_t_us(15);
  outline.mutable_camera_from_object()->mutable_translation_m()->set_z(2.0);
  outline.mutable_camera_from_object()->mutable_rotation()->set_w(1.0);
  for (const float number : {1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f, 8.0f}) outline.add_segments_px(number);
  outline.set_kinds(std::string("\x03\x7f"));
  return image;
}

TEST(ImageConversion, AnImageIsUnpacked) {
  const EventImage image = FromProto(SmallImage()).value();
  EXPECT_EQ(image.from_t_us, 10);
  EXPECT_EQ(image.to_t_us, 20);
  EXPECT_EQ(image.cell_px, 2);
  EXPECT_EQ(image.num_events, 6u);
  EXPECT_EQ(image.num_skipped, 1u);
  ASSERT_EQ(image.cells.size(), 3u);
  for (int i = 0; i < 8; ++i) EXPECT_EQ(image.CellAt(i % 3, i / 3), i % 4);
  ASSERT_EQ(image.outlines.size(), 1u);
  const ObjectOutline& outline = image.outlines[0];
  EXPECT_EQ(outline.object_id, "cube");
  EXPECT_EQ(outline.state, TrackState::kDegraded);
  EXPECT_EQ(outline.t_us, 15);
  EXPECT_EQ(outline.camera_from_object.translation_m.z(), 2.0);
  ASSERT_EQ(outline.segments.size(), 2u);
  EXPECT_EQ(outline.segments[1].p1_px, Eigen::Vector2f(5, 6));
  EXPECT_EQ(outline.segments[1].p2_px, Eigen::Vector2f(7, 8));
  EXPECT_EQ(outline.segments[0].kind, EdgeKind::kOccludingContour);
  EXPECT_EQ(outline.segments[1].kind, EdgeKind::kUnknown) << "of a later server";
}

TEST(ImageConversion, CompressedCellsAreTheSame) {
  v1::EventImage message = SmallImage();
  const std::string cells = message.cells();
  std::string compressed(100, '\0');
  uLongf size = compressed.size();
  ASSERT_EQ(compress(reinterpret_cast<Bytef*>(compressed.data()), &size, reinterpret_cast<const Bytef*>(cells.data()),
                     cells.size()),
            Z_OK);
  message.set_encoding(v1::EventImage::ENCODING_ZLIB);
  message.set_cells(compressed.substr(0, size));
  EXPECT_EQ(FromProto(message)->cells, FromProto(SmallImage())->cells);
  message.set_height(2);
  EXPECT_THAT(FromProto(message).status().message(), HasSubstr("cannot be decompressed to its size")) << "too many";
  message.set_height(30);
  EXPECT_THAT(FromProto(message).status().message(), HasSubstr("cannot be decompressed to its size")) << "too few";
  message.set_cells("no zlib");
  EXPECT_THAT(FromProto(message).status().message(), HasSubstr("cannot be decompressed to its size"));
}

TEST(ImageConversion, AnImageThatContradictsItselfIsAnErrorOfTheServer) {
  const std::pair<std::function<void(v1::EventImage&)>, const char*> cases[] = {
      {[](auto& image) { image.set_width(0); }, "it has 0 x 3 cells"},
      {[](auto& image) { image.set_height(1u << 31); }, "it has 3 x 2147483648 cells"},
      {[](auto& image) { image.set_width(300); }, "its size and that of its cells contradict each other"},
      {[](auto& image) { image.set_cell_px(3); }, "cell_px is 3"},
      {[](auto& image) { image.clear_encoding(); }, "unknown encoding 0"},
      {[](auto& image) { image.mutable_outlines(0)->clear_kinds(); }, "segments and of kinds contradict"},
      {[](auto& image) { image.mutable_outlines(0)->set_segments_px(3, HUGE_VALF); }, "a pixel is not finite"},
      {[](auto& image) { image.mutable_outlines(0)->clear_camera_from_object(); }, "outline: "},
  };
  for (const auto& [change, expected] : cases) {
    v1::EventImage message = SmallImage();
    change(message);
    const absl::Status status = FromProto(message).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInternal) << expected;
    EXPECT_THAT(status.message(), HasSubstr(expected));
  }
}

v1::ModelGeometry TriangleGeometry() {
  v1::ModelGeometry geometry;
  for (const float number : {0.0f, 0.0f, 0.0f, 1.0f, 0.0f, 0.0f, 0.0f, 1.0f, 0.0f}) geometry.add_vertices_m(number);
  for (const uint32_t vertex : {0, 1, 2}) geometry.add_faces(vertex);
  for (const float number : {0.0f, 0.0f, 0.0f, 1.0f, 2.0f, 3.0f}) geometry.add_edges_m(number);
  geometry.set_simplified(true);
  return geometry;
}

TEST(ImageConversion, AGeometryHasItsVerticesFacesAndEdges) {
  const ModelGeometry geometry = FromProto(TriangleGeometry()).value();
  ASSERT_EQ(geometry.vertices_m.size(), 3u);
  EXPECT_EQ(geometry.vertices_m[2], Eigen::Vector3f(0, 1, 0));
  EXPECT_EQ(geometry.faces, (std::vector<std::array<uint32_t, 3>>{{0, 1, 2}}));
  ASSERT_EQ(geometry.edges_m.size(), 1u);
  EXPECT_EQ(geometry.edges_m[0][1], Eigen::Vector3f(1, 2, 3));
  EXPECT_TRUE(geometry.is_simplified);
}

TEST(ImageConversion, AGeometryThatContradictsItselfIsAnErrorOfTheServer) {
  const std::pair<std::function<void(v1::ModelGeometry&)>, const char*> cases[] = {
      {[](auto& geometry) { geometry.add_vertices_m(0); }, "whole vertices"},
      {[](auto& geometry) { geometry.add_faces(0); }, "whole vertices"},
      {[](auto& geometry) { geometry.add_edges_m(0); }, "whole vertices"},
      {[](auto& geometry) { geometry.set_faces(1, 3); }, "a vertex that does not exist"},
      {[](auto& geometry) { geometry.set_vertices_m(1, NAN); }, "not finite"},
      {[](auto& geometry) { geometry.set_edges_m(5, HUGE_VALF); }, "not finite"},
  };
  for (const auto& [change, expected] : cases) {
    v1::ModelGeometry message = TriangleGeometry();
    change(message);
    const absl::Status status = FromProto(message).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInternal) << expected;
    EXPECT_THAT(status.message(), HasSubstr(expected));
  }
}

}  // namespace
}  // namespace evpose::client
