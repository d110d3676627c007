// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/gltf_contents.h"

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "client/model_intake/model_intake.h"
#include "core/base/output_file.h"
#include "core/base/quoted.h"
#include "core/base/temporary_directory_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

json Box() { return json::parse(ReadFile(FindTestData("models/label_box.gltf"), 1u << 20).value()); }

std::string ErrorOf(const json& document) { return std::string(CheckGltf(document.dump()).status().message()); }

std::string Glb(const std::string& text, uint32_t version = 2) {
  const auto word = [](uint32_t value) {
    std::string bytes;
    for (int i = 0; i < 4; ++i) bytes += static_cast<char>(value >> (8 * i));
    return bytes;
  };
  return absl::StrCat("glTF", word(version), word(static_cast<uint32_t>(20 + text.size())),
                      word(static_cast<uint32_t>(text.size())), "JSON", text);
}

TEST(GltfContentsTest, ARequiredExtensionThatIsNotReadIsNamedWithTheRemedy) {
  json document = Box();
  document["extensionsRequired"] = {"KHR_draco_mesh_compression", "KHR_materials_unlit", "KHR_texture_transform"};
  EXPECT_TRUE(CheckGltf(document.dump()).ok()) << ErrorOf(document);
  const auto requires_one = [&document](const char* name) {
    document["extensionsRequired"] = {"KHR_texture_transform", name};
    return ErrorOf(document);
  };
  EXPECT_EQ(requires_one("KHR_mesh_quantization"),
            "requires the glTF extension KHR_mesh_quantization, which is not read: export without quantization "
            "(gltfpack -noq, or gltf-transform dequantize)");
  for (const std::string name : {"EXT_meshopt_compression", "KHR_meshopt_compression"}) {
    EXPECT_EQ(requires_one(name.c_str()), "requires the glTF extension " + name +
                                              ", which is not read: export without compression (gltfpack without -c "
                                              "and -cc)");
  }
  EXPECT_EQ(requires_one("EXT_mesh_gpu_instancing"),
            "requires the glTF extension EXT_mesh_gpu_instancing, which is not read: export the model without it, or "
            "as STL, 3MF or STEP");
}

TEST(GltfContentsTest, CoordinatesAndNormalsAreFloats) {
  for (const int accessor : {0, 1}) {
    json document = Box();
    document["accessors"][accessor]["componentType"] = 5123;
    EXPECT_EQ(ErrorOf(document), absl::StrCat("the numbers of ", accessor == 0 ? "POSITION" : "NORMAL",
                                              " are whole numbers, which the glTF extension KHR_mesh_quantization "
                                              "permits, but only floating-point numbers are read: export without "
                                              "quantization (gltfpack -noq, or gltf-transform dequantize)"));
  }
}

TEST(GltfContentsTest, TextureCoordinatesThatAreWholeNumbersMeanNoImages) {
  json document = Box();
  document["accessors"][2]["componentType"] = 5123;
  document["accessors"][2]["normalized"] = true;
  const TemporaryDirectory directory;
  const std::string path = directory.File("box.gltf");
  ASSERT_TRUE(WriteFile(path, document.dump()).ok());
  const absl::StatusOr<ObjectModel> model = LoadModelFile(path);
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_EQ(model->lines.size(), 12u);
  EXPECT_THAT(model->notices, ElementsAre(HasSubstr("texture coordinates that are not floating-point numbers")));
  document.erase("images");
  EXPECT_THAT(CheckGltf(document.dump())->notices, IsEmpty());
}

TEST(GltfContentsTest, InstancesThatMayBeIgnoredAreNoticed) {
  json document = Box();
  EXPECT_THAT(CheckGltf(document.dump())->notices, IsEmpty());
  document["extensionsUsed"] = {"EXT_mesh_gpu_instancing"};
  EXPECT_THAT(CheckGltf(document.dump())->notices, Contains(HasSubstr("each such mesh is taken once")));
}

TEST(GltfContentsTest, DataThatOnlyMeshoptCanReadNameIt) {
  for (const std::string name : {"EXT_meshopt_compression", "KHR_meshopt_compression"}) {
    json document = Box();
    document["extensionsUsed"] = {name};
    document["bufferViews"][1]["extensions"][name] = {{"buffer", 0}, {"count", 24}, {"mode", "ATTRIBUTES"}};
    EXPECT_TRUE(CheckGltf(document.dump()).ok()) << "the buffer has the uncompressed numbers, too";
    document["buffers"].push_back({{"byteLength", 288}, {"extensions", {{name, {{"fallback", true}}}}}});
    document["bufferViews"][1]["buffer"] = 1;
    const std::string error = "has only data that are compressed by the glTF extension " + name +
                              ", which is not read: export without compression (gltfpack without -c and -cc)";
    EXPECT_EQ(ErrorOf(document), error);
    EXPECT_EQ(CheckGltf(Glb(document.dump())).status().message(), error);
    document["bufferViews"][1]["buffer"] = 0;
    document["buffers"][0].erase("uri");
    EXPECT_EQ(ErrorOf(document), error);
    EXPECT_TRUE(CheckGltf(Glb(document.dump())).ok()) << "the buffer 0 of a GLB is in the file";
  }
}

json DracoBox() { return json::parse(ReadFile(FindTestData("models/label_box_draco.gltf"), 1u << 20).value()); }

std::string LoadingErrorOf(const json& document) {
  const TemporaryDirectory directory;
  const std::string path = directory.File("box.gltf");
  EXPECT_TRUE(WriteFile(path, document.dump()).ok());
  return std::string(LoadModelFile(path).status().message());
}

TEST(GltfContentsTest, DamagedDracoDataNameTheExtension) {
  json document = DracoBox();
  EXPECT_TRUE(CheckGltf(document.dump())->has_draco);
  EXPECT_FALSE(CheckGltf(Box().dump())->has_draco);
  // Of 380 bytes, base64, those from 129 to 377 become zeros.
  std::string uri = document["buffers"][0]["uri"];
  const size_t begin = uri.find(',') + 1;
  ASSERT_GT(uri.size() - begin, 340u);
  uri.replace(begin + 172, 332, 332, 'A');
  document["buffers"][0]["uri"] = uri;
  EXPECT_THAT(
      LoadingErrorOf(document),
      AllOf(HasSubstr("Draco"), HasSubstr("compressed by KHR_draco_mesh_compression: export it without compression")));
}

TEST(GltfContentsTest, DracoDataThatTheFileDoesNotListNameTheExtension) {
  json document = DracoBox();
  document.erase("extensionsRequired");
  EXPECT_EQ(LoadingErrorOf(document), "");
  document.erase("extensionsUsed");
  EXPECT_THAT(LoadingErrorOf(document),
              HasSubstr("compressed by the glTF extension KHR_draco_mesh_compression, but does not list it in "
                        "extensionsUsed: export it again, without compression"));
}

TEST(GltfContentsTest, ShapesThatAnimationsGiveAreNoticed) {
  json document = Box();
  document["meshes"][0]["weights"] = {0.0, 0.0};
  document["nodes"][0]["skin"] = 0;
  document["nodes"][0].erase("mesh");
  EXPECT_THAT(CheckGltf(document.dump())->notices, IsEmpty());
  document["meshes"][0]["weights"] = {0.0, 0.5};
  EXPECT_THAT(CheckGltf(document.dump())->notices, ElementsAre(HasSubstr("the weights of morph targets are not")));
  document["meshes"][0].erase("weights");
  document["nodes"][0]["mesh"] = 0;
  EXPECT_THAT(CheckGltf(document.dump())->notices, ElementsAre(HasSubstr("skins are not applied")));
}

TEST(GltfContentsTest, APrimitiveOfAnUnknownModeIsAnError) {
  json document = Box();
  for (const json& mode : {json(7), json(-1), json("points")}) {
    document["meshes"][0]["primitives"][1]["mode"] = mode;
    EXPECT_EQ(ErrorOf(document), absl::StrCat("a primitive of a mesh has the mode ", Escaped(mode.dump()),
                                              ", but glTF defines 0 (points) to 6 (triangle fan): export the model "
                                              "again"));
  }
  document["meshes"][0]["primitives"][1]["mode"] = 6;
  EXPECT_TRUE(CheckGltf(document.dump()).ok());
}

TEST(GltfContentsTest, MalformedFilesAreErrors) {
  EXPECT_TRUE(CheckGltf(Glb("{\"asset\":{\"version\":\"2.0\"}}")).ok());
  EXPECT_EQ(ErrorOf({{"asset", {{"version", "1.0"}}}}), "is glTF 1.0; only glTF 2.0 is read: export it again");
  EXPECT_EQ(CheckGltf(Glb("{}", 1)).status().message(), "is glTF 1; only glTF 2.0 is read: export it again");
  EXPECT_EQ(CheckGltf("{\"asset\":").status().message(), "its JSON is malformed or cut off");
  EXPECT_EQ(CheckGltf(Glb("{")).status().message(), "its JSON is malformed or cut off");
  EXPECT_EQ(CheckGltf("glTF\2").status().message(), "is cut off");
  const std::string glb = Glb("{\"asset\":{}}");
  EXPECT_EQ(CheckGltf(glb.substr(0, glb.size() - 1)).status().message(), "is cut off: it states 32 bytes, but has 31");
  std::string other = glb;
  other.replace(16, 4, "BIN ");
  EXPECT_EQ(CheckGltf(other).status().message(), "its first chunk is not JSON, as GLB demands");
  // Members of the wrong type are left to Assimp.
  for (const char* text : {"{\"extensionsRequired\":3}", "{\"meshes\":{}}", "{\"meshes\":[1,{\"primitives\":[2]}]}",
                           "{\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":9}}]}]}"}) {
    EXPECT_TRUE(CheckGltf(text).ok()) << text;
  }
}

}  // namespace
}  // namespace evpose::client
