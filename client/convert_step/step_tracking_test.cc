// SPDX-License-Identifier: Apache-2.0

// Tracking of objects that were read from STEP and IGES files, through evpose-convert-step and the preparation of
// models.
#include <BRepAlgoAPI_Cut.hxx>
#include <BRepAlgoAPI_Fuse.hxx>
#include <BRepFilletAPI_MakeFillet.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <TopExp_Explorer.hxx>
#include <TopoDS.hxx>
#include <TopoDS_Edge.hxx>
#include <gp_Ax2.hxx>
#include <vector>

#include "client/convert_step/step_files_testing.h"
#include "client/model_intake/model_intake.h"
#include "core/experiments/tracking/model_bench.h"

namespace evpose::client {
namespace {

class StepTrackingTest : public StepFilesTest {};

// A rounded block with a hole and a pin: planes, fillets, a wall that is concave and one that is convex.
TopoDS_Shape Part() {
  const TopoDS_Shape block = BRepPrimAPI_MakeBox(120.0, 80.0, 40.0).Shape();
  BRepFilletAPI_MakeFillet fillet(block);
  for (TopExp_Explorer edges(block, TopAbs_EDGE); edges.More(); edges.Next()) {
    fillet.Add(8.0, TopoDS::Edge(edges.Current()));
  }
  const gp_Ax2 hole(gp_Pnt(35.0, 40.0, -1.0), gp_Dir(0.0, 0.0, 1.0)),
      pin(gp_Pnt(90.0, 30.0, 39.0), gp_Dir(0.0, 0.0, 1.0));
  return BRepAlgoAPI_Fuse(BRepAlgoAPI_Cut(fillet.Shape(), BRepPrimAPI_MakeCylinder(hole, 15.0, 42.0).Shape()),
                          BRepPrimAPI_MakeCylinder(pin, 12.0, 41.0).Shape());
}

TEST_F(StepTrackingTest, PartsAreKeptFromTheTruePose) {
  ModelBenchOptions options;
  const std::string step = Write(Part());
  // The simulator renders the surface of the STEP file in both runs.
  options.models = {{"STEP", step, 1.0, ""}, {"IGES", WriteIges(Part(), IgesFaces::kLoose), 1.0, step}};
  options.num_seeds = 1;
  options.duration_us = 250'000;
  options.camera = "vga";
  options.load_model = LoadModelFile;
  std::vector<ModelBenchRow> rows;
  const absl::Status status = RunModelBench(options, [&rows](const ModelBenchRow& row) { rows.push_back(row); });
  ASSERT_TRUE(status.ok()) << status;
  ASSERT_EQ(rows.size(), 2u);
  for (const ModelBenchRow& row : rows) {
    ASSERT_EQ(row.error, "") << row.model.name;
    EXPECT_EQ(row.num_kept, 1) << row.model.name;
    EXPECT_LT(row.summary.position_rmse_of_depth, 0.003) << row.model.name;
    EXPECT_EQ(row.summary.longest_wrong_s, 0.0) << row.model.name;
  }
  EXPECT_EQ(rows[0].lines, rows[1].lines);
  EXPECT_EQ(rows[0].curves, rows[1].curves);
}

}  // namespace
}  // namespace evpose::client
