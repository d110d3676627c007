// SPDX-License-Identifier: Apache-2.0

// STEP and IGES files of shapes, for tests.
#pragma once

#include <IGESControl_Writer.hxx>
#include <Interface_Static.hxx>
#include <STEPControl_Controller.hxx>
#include <STEPControl_Writer.hxx>
#include <TopoDS_Shape.hxx>
#include <cstdint>
#include <string>
#include <utility>

#include "absl/status/statusor.h"
#include "client/convert_step/step_reader.h"
#include "core/base/byte_order.h"
#include "core/base/temporary_directory_testing.h"
#include "core/mesh/types/raw_mesh.h"
#include "core/models/object_model.h"
#include "gtest/gtest.h"
#include "server/models/mesh_message.h"

namespace evpose::client {

class StepFilesTest : public testing::Test {
 protected:
  // Writes a shape in millimetres as a STEP file of this unit.
  std::string Write(const TopoDS_Shape& shape, const char* unit = "MM") {
    STEPControl_Controller::Init();  // defines the parameters
    Interface_Static::SetCVal("write.step.unit", unit);
    STEPControl_Writer writer;
    EXPECT_EQ(writer.Transfer(shape, STEPControl_AsIs), IFSelect_RetDone);
    const std::string path = directory_.File("part.step");
    EXPECT_EQ(writer.Write(path.c_str()), IFSelect_RetDone);
    return path;
  }

  // How an IGES file has the faces of a shape: as trimmed surfaces, each with edges of its own, which is what most CAD
  // programs write, or as faces of solids.
  enum class IgesFaces { kLoose = 0, kOfSolids = 1 };
  std::string WriteIges(const TopoDS_Shape& shape, IgesFaces faces) {
    IGESControl_Writer writer("MM", static_cast<int>(faces));
    EXPECT_TRUE(writer.AddShape(shape));
    writer.ComputeModel();
    const std::string path = directory_.File("part.igs");
    EXPECT_TRUE(writer.Write(path.c_str()));
    return path;
  }

  // The mesh of a file, without the notices.
  static absl::StatusOr<RawMesh> ReadMesh(const std::string& path) {
    absl::StatusOr<StepModel> model = ReadStep(path);
    if (!model.ok()) return model.status();
    return std::move(model->mesh);
  }

  // The model that a server makes of a mesh.
  static absl::StatusOr<ObjectModel> Prepare(const RawMesh& mesh) {
    const std::string bytes = server::EncodeMesh(mesh);
    return server::ParseModelFile(AsBytes(bytes), ModelFormat::kMesh, {});
  }

  const TemporaryDirectory directory_;
};

}  // namespace evpose::client
