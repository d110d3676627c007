// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/model_intake.h"

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "core/base/byte_order.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/mesh/meshes_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/models/mesh_message.h"
#include "tests/data/test_data.h"

namespace evpose::client {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::SizeIs;
using testing::StartsWith;

std::string Data(const std::string& name) { return FindTestData("models/" + name); }

RawMesh MeshOf(const std::string& path) {
  const absl::StatusOr<ModelFile> file = ReadModelFile(path);
  EXPECT_TRUE(file.ok()) << file.status();
  if (!file.ok()) return {};
  EXPECT_EQ(file->format, evpose::ModelFormat::kMesh);
  absl::StatusOr<RawMesh> mesh = server::ParseMesh(AsBytes(file->bytes), 100);
  EXPECT_TRUE(mesh.ok()) << mesh.status();
  return mesh.ok() ? *std::move(mesh) : RawMesh();
}

TEST(ModelIntakeTest, AnImplausibleSizeOfAFileWithoutUnitIsNoticed) {
  EXPECT_THAT(ReadModelFile(Data("box.off"))->notices, SizeIs(0)) << "3.7 m";
  EXPECT_THAT(ReadModelFile(Data("box.off"), 0.001)->notices,
              ElementsAre(HasSubstr("if these are metres pass --scale 1")));
  EXPECT_THAT(ReadModelFile(Data("box.3mf"), 1e-6)->notices,
              ElementsAre(HasSubstr("the file states its unit, in which it was read: --scale 1e-06")));
}

class BoxOfEachFormatTest : public testing::TestWithParam<const char*> {};

TEST_P(BoxOfEachFormatTest, HasTheSizeInMetresTheAxesOfTheFileAndItsWinding) {
  const double unit = std::string(GetParam()) == "box.off" ? 0.01 : 1.0;
  const RawMesh mesh = MeshOf(Data(GetParam()));
  EXPECT_THAT(mesh.triangles, SizeIs(12));
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& point : mesh.points) box.extend(Eigen::Vector3d(unit * point));
  EXPECT_LT((box.min() - Eigen::Vector3d::Zero()).norm(), 1e-8);
  EXPECT_LT((box.max() - Eigen::Vector3d(0.01, 0.02, 0.03)).norm(), 1e-8);
  EXPECT_NEAR(EnclosedVolume(mesh) * unit * unit * unit, 6e-6, 1e-11);
}

TEST_P(BoxOfEachFormatTest, IsAModelOfTwelveEdges) {
  const double scale = std::string(GetParam()) == "box.off" ? 0.01 : 1.0;
  const absl::StatusOr<ObjectModel> model = LoadModelFile(Data(GetParam()), {.metres_per_unit = scale});
  ASSERT_TRUE(model.ok()) << model.status();
  EXPECT_NEAR(model->diameter_m, 0.01 * std::sqrt(14.0), 1e-8);
  EXPECT_THAT(model->vertices, SizeIs(8));
  EXPECT_GE(model->lines.size(), 12u) << "a label adds some";
}

TEST_P(BoxOfEachFormatTest, FilesThatAreCutOffOrEmptyAreErrorsWithThePath) {
  const TemporaryDirectory directory;
  const std::string bytes = ReadFile(Data(GetParam()), 1u << 20).value();
  const std::string path = directory.File(GetParam());
  for (const size_t size : {size_t{0}, bytes.size() / 3, 2 * bytes.size() / 3}) {
    ASSERT_TRUE(WriteFile(path, bytes.substr(0, size)).ok());
    const absl::Status status = LoadModelFile(path).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << size << ": " << status;
    EXPECT_THAT(std::string(status.message()), StartsWith(path));
  }
}

TEST_P(BoxOfEachFormatTest, AnotherContentIsNamed) {
  const TemporaryDirectory directory;
  const std::string path = directory.File(GetParam());
  ASSERT_TRUE(WriteFile(path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").ok());
  EXPECT_EQ(LoadModelFile(path).status().message(),
            path + ": its content is not of the format that the extension of its name states");
}

INSTANTIATE_TEST_SUITE_P(Formats, BoxOfEachFormatTest,
                         testing::Values("box.off", "box.dae", "box.3mf", "box_inch.3mf", "label_box.gltf",
                                         "label_box.glb", "label_box_draco.gltf"),
                         [](const auto& param) {
                           std::string name = param.param;
                           for (char& c : name) c = c == '.' ? '_' : c;
                           return name;
                         });

TEST(ModelIntakeTest, NormalsOfCornersFollowTheirNode) {
  const RawMesh mesh = MeshOf(Data("label_box.gltf"));
  ASSERT_EQ(mesh.corner_normals.size(), mesh.triangles.size());
  for (size_t i = 0; i < mesh.triangles.size(); ++i) {
    const auto& [a, b, c] = mesh.triangles[i];
    const Eigen::Vector3d normal =
        (mesh.points[b] - mesh.points[a]).cross(mesh.points[c] - mesh.points[a]).normalized();
    for (const Eigen::Vector3f& corner : mesh.corner_normals[i]) {
      EXPECT_GT(corner.cast<double>().dot(normal), 0.999);
    }
  }
}

TEST(ModelIntakeTest, AnUnknownUnitIsNamed) {
  EXPECT_THAT(std::string(LoadModelFile(Data("box_parsec.3mf")).status().message()),
              AllOf(StartsWith(Data("box_parsec.3mf")), HasSubstr("its unit \"parsec\" is unknown")));
}

TEST(ModelIntakeTest, AUnitOfColladaThatIsNotAboveZeroIsAnError) {
  const TemporaryDirectory directory;
  std::string text = ReadFile(Data("box.dae"), 1u << 20).value();
  for (const char* unit : {"0", "-1", "nan", "one"}) {
    std::string changed = text;
    changed.replace(changed.find("0.01"), 4, unit);
    ASSERT_TRUE(WriteFile(directory.File("box.dae"), changed).ok());
    EXPECT_THAT(std::string(LoadModelFile(directory.File("box.dae")).status().message()),
                HasSubstr("it must be a number above 0"))
        << unit;
  }
}

TEST(ModelIntakeTest, FilesThatServersReadPassUnchanged) {
  const TemporaryDirectory directory;
  const std::string obj = "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
  ASSERT_TRUE(WriteFile(directory.File("a.obj"), obj).ok());
  const absl::StatusOr<ModelFile> file = ReadModelFile(directory.File("a.obj"));
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->format, evpose::ModelFormat::kObj);
  EXPECT_EQ(file->bytes, obj);
  ASSERT_TRUE(WriteFile(directory.File("a.stl"), "anything").ok());
  EXPECT_EQ(ReadModelFile(directory.File("a.stl"))->format, evpose::ModelFormat::kStl);
}

TEST(ModelIntakeTest, UnknownExtensionsAndMissingFilesAreErrors) {
  const TemporaryDirectory directory;
  const std::string blend = directory.File("a.blend");
  ASSERT_TRUE(WriteFile(blend, "anything").ok());
  EXPECT_THAT(std::string(ReadModelFile(blend).status().message()),
              AllOf(StartsWith(blend + ": unknown model format"), HasSubstr(".3mf")));
  EXPECT_EQ(ReadModelFile("/nowhere/a.glb").status().code(), absl::StatusCode::kNotFound);
}

TEST(ModelIntakeTest, PublicFilesOfEachFormatAreRead) {
  struct Public {
    const char* name;
    size_t triangles;
    double size_m;  // the longest side
  };
  for (const auto& [name, triangles, size_m] :
       {Public{"cad/blue_cube.dae", 12, 2.0}, Public{"cad/ballA.off", 3796, 13.854},
        Public{"cad/counterX.3MF", 8080, 0.3048}}) {
    const absl::StatusOr<ModelFile> file = ReadModelFile(FindTestData(name));
    ASSERT_TRUE(file.ok()) << name << ": " << file.status();
    const absl::StatusOr<RawMesh> mesh = server::ParseMesh(AsBytes(file->bytes), ModelOptions().max_triangles);
    ASSERT_TRUE(mesh.ok()) << mesh.status();
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3d& point : mesh->points) box.extend(point);
    EXPECT_EQ(mesh->triangles.size(), triangles) << name;
    EXPECT_NEAR(box.sizes().maxCoeff(), size_m, 0.02 * size_m) << name;
  }
}

}  // namespace
}  // namespace evpose::client
