// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/three_mf_reader.h"

#include <minizip/zip.h>

#include <Eigen/Geometry>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/string_view.h"
#include "core/base/temporary_directory_testing.h"
#include "core/mesh/meshes_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace evpose::client {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr char kRelationships[] =
    "<Relationships><Relationship "
    "Type=\"http://schemas.openxmlformats.org/package/2006/relationships/metadata/thumbnail\" "
    "Target=\"/Metadata/a.png\"/><Relationship Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\" "
    "Target=\"/3D/3dmodel.model\"/></Relationships>";
// A tetrahedron of the volume 1/6, with its corners at the origin and on the axes.
constexpr char kMesh[] =
    "<mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" z=\"0\"/><vertex x=\"0\" y=\"1\" "
    "z=\"0\"/>"
    "<vertex x=\"0\" y=\"0\" z=\"1\"/></vertices><triangles><triangle v1=\"0\" v2=\"2\" v3=\"1\"/>"
    "<triangle v1=\"0\" v2=\"1\" v3=\"3\"/><triangle v1=\"1\" v2=\"2\" v3=\"3\"/><triangle v1=\"2\" v2=\"0\" v3=\"3\"/>"
    "</triangles></mesh>";

using Parts = std::vector<std::pair<std::string, std::string>>;

std::string Object(int id, absl::string_view content, absl::string_view attributes = "") {
  return absl::StrCat("<object id=\"", id, "\" ", attributes, ">", content, "</object>");
}

std::string Model(absl::string_view objects, absl::string_view build, absl::string_view attributes = "unit=\"meter\"") {
  return absl::StrCat("<?xml version=\"1.0\"?><model ", attributes,
                      " xmlns:p=\"http://schemas.microsoft.com/3dmanufacturing/production/2015/06\">"
                      "<resources>",
                      objects, "</resources><build>", build, "</build></model>");
}

class ThreeMfReaderTest : public testing::Test {
 protected:
  // Reads an archive of these parts.
  absl::StatusOr<Scene> Read(const Parts& parts) const {
    const std::string path = directory_.File("a.3mf");
    const zipFile archive = zipOpen(path.c_str(), APPEND_STATUS_CREATE);
    for (const auto& [name, text] : parts) {
      zip_fileinfo info = {};
      zipOpenNewFileInZip(archive, name.c_str(), &info, nullptr, 0, nullptr, 0, nullptr, Z_DEFLATED, 9);
      zipWriteInFileInZip(archive, text.data(), static_cast<unsigned>(text.size()));
      zipCloseFileInZip(archive);
    }
    zipClose(archive, nullptr);
    return Read3mf(path, 100);
  }
  absl::StatusOr<Scene> ReadModel(const std::string& model) const {
    return Read({{"_rels/.rels", kRelationships}, {"3D/3dmodel.model", model}});
  }
  std::string ErrorOf(const std::string& model) const { return std::string(ReadModel(model).status().message()); }

  const TemporaryDirectory directory_;
};

TEST_F(ThreeMfReaderTest, TransformsOfItemsAndNestedComponentsAreChained) {
  // Row vectors: the first three numbers are the image of the x axis, the last three that of the origin.
  const std::string move = "1 0 0 0 1 0 0 0 1 5 6 7", turn = "0 1 0 -1 0 0 0 0 1 0 0 0",
                    mirror = "-2 0 0 0 1 0 0 0 1 0 0 0";
  const auto component = [](int id, absl::string_view transform) {
    return absl::StrCat("<components><component objectid=\"", id, "\" transform=\"", transform, "\"/></components>");
  };
  const std::string objects =
      absl::StrCat(Object(1, kMesh), Object(2, component(1, move)), Object(3, component(2, turn)));
  const absl::StatusOr<Scene> scene =
      ReadModel(Model(objects, absl::StrCat("<item objectid=\"3\" transform=\"", mirror, "\"/>")));
  ASSERT_TRUE(scene.ok()) << scene.status();
  // (1, 0, 0) -> (6, 6, 7) -> (-6, 6, 7) -> (12, 6, 7)
  EXPECT_THAT(scene->mesh.points, ElementsAre(Eigen::Vector3d(12, 5, 7), Eigen::Vector3d(12, 6, 7),
                                              Eigen::Vector3d(14, 5, 7), Eigen::Vector3d(12, 5, 8)));
  EXPECT_NEAR(EnclosedVolume(scene->mesh), 2.0 / 6.0, 1e-12) << "mirrored triangles are turned over";
  EXPECT_THAT(scene->notices, IsEmpty());
}

TEST_F(ThreeMfReaderTest, ComponentsMayBeInOtherParts) {
  // As slicers write it: the part with the mesh comes first, and its own build is empty.
  const std::string start =
      Model(Object(2, "<components><component p:path=\"/3D/Objects/object_1.model\" objectid=\"1\"/></components>"),
            "<item objectid=\"2\"/><item p:path=\"/3D/objects/Object_1.model\" objectid=\"7\"/>",
            "unit=\"inch\" requiredextensions=\"p\"");
  const std::string other =
      Model(absl::StrCat(Object(1, kMesh), Object(7, "<components><component objectid=\"1\"/></components>")), "",
            "unit=\"inch\"");
  const absl::StatusOr<Scene> scene =
      Read({{"3D/Objects/object_1.model", other}, {"_rels/.rels", kRelationships}, {"3D/3dmodel.model", start}});
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->mesh.triangles.size(), 8u);
  EXPECT_NEAR(EnclosedVolume(scene->mesh), 2.0 / 6.0 * 0.0254 * 0.0254 * 0.0254, 1e-12);
  EXPECT_EQ(Read({{"_rels/.rels", kRelationships}, {"3D/3dmodel.model", start}}).status().message(),
            "its archive has no 3D/Objects/object_1.model");
  const std::string metres = absl::StrReplaceAll(other, {{"\"inch\"", "\"meter\""}});
  EXPECT_EQ(Read({{"_rels/.rels", kRelationships}, {"3D/3dmodel.model", start}, {"3D/Objects/object_1.model", metres}})
                .status()
                .message(),
            "/3D/Objects/object_1.model: its unit \"meter\" differs from \"inch\" of the start part; export the model "
            "with one unit");
}

TEST_F(ThreeMfReaderTest, TheStartPartIsTheOneOfTheRelationshipsOrTheOnlyOne) {
  const std::string model = Model(Object(1, kMesh), "<item objectid=\"1\"/>"), empty = Model("", "");
  EXPECT_TRUE(Read({{"a.model", model}}).ok());
  EXPECT_TRUE(Read({{"a.model", model}, {"_rels/.rels", "<Relationships/>"}}).ok());
  EXPECT_TRUE(Read({{"a.model", empty}, {"3D/3dmodel.model", model}, {"_rels/.rels", kRelationships}}).ok());
  EXPECT_THAT(std::string(Read({{"a.model", empty}, {"b.model", model}}).status().message()),
              HasSubstr("its archive has several .model files"));
  EXPECT_EQ(Read({{"a.txt", model}}).status().message(), "is not a 3MF file: its archive has no .model file");
  EXPECT_EQ(Read({{"_rels/.rels", kRelationships}}).status().message(), "its archive has no 3D/3dmodel.model");
}

TEST_F(ThreeMfReaderTest, SupportsAndAuxiliaryObjectsAreNotThePart) {
  const std::string objects = absl::StrCat(
      Object(1, kMesh), Object(2, kMesh, "type=\"support\""), Object(3, kMesh, "type=\"solidsupport\""),
      Object(4, kMesh, "type=\"other\""), Object(5, kMesh, "type=\"surface\""),
      // The type of an object with components is ignored.
      Object(6, "<components><component objectid=\"1\"/><component objectid=\"4\"/></components>", "type=\"other\""));
  const std::string all = "<item objectid=\"2\"/><item objectid=\"3\"/><item objectid=\"5\"/><item objectid=\"6\"/>";
  const absl::StatusOr<Scene> scene = ReadModel(Model(objects, all));
  ASSERT_TRUE(scene.ok()) << scene.status();
  EXPECT_EQ(scene->mesh.triangles.size(), 8u);
  EXPECT_THAT(scene->notices, ElementsAre("3 objects of the types support, solidsupport or other not used"));
  EXPECT_EQ(ErrorOf(Model(objects, "<item objectid=\"2\"/>")),
            "builds no triangle apart from supports and auxiliary objects");
}

TEST_F(ThreeMfReaderTest, ExtensionsThatAreNotReadAreNamed) {
  const std::string beams =
      absl::StrReplaceAll(kMesh, {{"</mesh>", "<b:beamlattice><b:beams/></b:beamlattice></mesh>"}});
  const std::string name = "http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02";
  const std::string attributes = absl::StrCat("unit=\"meter\" xmlns:b=\"", name, "\" ");
  const absl::StatusOr<Scene> optional = ReadModel(Model(Object(1, beams), "<item objectid=\"1\"/>", attributes));
  ASSERT_TRUE(optional.ok()) << optional.status();
  EXPECT_THAT(optional->notices, ElementsAre("1 beam lattice not used"));
  EXPECT_EQ(ErrorOf(Model(Object(1, beams), "<item objectid=\"1\"/>", attributes + "requiredextensions=\"p b\"")),
            absl::StrCat("/3D/3dmodel.model: requires the 3MF extension ", name,
                         ", which is not read; export the object as triangles without it, or as STL or STEP"));
  EXPECT_THAT(ErrorOf(Model(Object(1, kMesh), "<item objectid=\"1\"/>", "requiredextensions=\"x\"")),
              HasSubstr("requires the 3MF extension x, which is not read"));
}

TEST_F(ThreeMfReaderTest, ErrorsNameThePlace) {
  const auto with = [](const char* from, const char* to) {
    return Model(Object(1, absl::StrReplaceAll(kMesh, {{from, to}})), "<item objectid=\"1\"/>");
  };
  const auto transformed = [](const char* transform) {
    return Model(Object(1, kMesh), absl::StrCat("<item objectid=\"1\" transform=\"", transform, "\"/>"));
  };
  const std::pair<std::string, const char*> cases[] = {
      {with("v1=\"2\" v2=\"0\"", "v1=\"4\" v2=\"0\""),
       "object 1: triangle 3 has v1='4', but its object has 4 vertices"},
      {with("v3=\"1\"", "v3=\"-1\""), "object 1: triangle 0 has v3='-1', but its object has 4 vertices"},
      {with("v2=\"1\" ", ""), "object 1: triangle 1 has v2='', but its object has 4 vertices"},
      {with("y=\"1\"", "y=\"one\""), "object 1: vertex 2 has no number y"},
      {with("z=\"1\"", "z=\"inf\""), "a coordinate is not finite"},
      {with("</mesh>", ""), "/3D/3dmodel.model: byte "},
      {transformed("1 0 0 0 1 0 0 0 1 0 0"), "a transform has 11 numbers instead of 12"},
      {transformed("1 0 0 0 1 0 0 0 1 0 0 x"), "a transform has 'x', which is not a number"},
      {Model(Object(1, kMesh), "<item objectid=\"2\"/>"), "has no object 2, which a build item or a component names"},
      {Model(Object(1, kMesh), ""), "builds no triangle"},
      {Model(Object(1, "<components><component objectid=\"1\"/></components>"), "<item objectid=\"1\"/>"),
       "components that contain themselves"},
      {Model(Object(1, kMesh), "<item objectid=\"1\"/>", "unit=\"cubit\""), "its unit \"cubit\" is unknown"}};
  for (const auto& [model, says] : cases) EXPECT_THAT(ErrorOf(model), HasSubstr(says)) << model;
  std::string items;
  for (int i = 0; i < 26; ++i) items += "<item objectid=\"1\"/>";
  EXPECT_THAT(ErrorOf(Model(Object(1, kMesh), items)), HasSubstr("more than 100 triangles"));
}

TEST_F(ThreeMfReaderTest, NestedComponentsDoNotMultiplyWithoutEnd) {
  // Twelve levels of eight components: 8^12 tetrahedra, or none.
  std::string objects = Object(1, "<mesh/>");
  for (int level = 2; level <= 13; ++level) {
    std::string components;
    for (int i = 0; i < 8; ++i) absl::StrAppend(&components, "<component objectid=\"", level - 1, "\"/>");
    objects += Object(level, absl::StrCat("<components>", components, "</components>"));
  }
  EXPECT_THAT(ErrorOf(Model(objects, "<item objectid=\"13\"/>")), HasSubstr("has too many components"));
}

}  // namespace
}  // namespace evpose::client
