// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/tracking/model_bench.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>
#include <string>
#include <vector>

#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/experiments/frustum_testing.h"
#include "core/experiments/tracking/model_run.h"
#include "core/simulation/describe.h"

namespace evpose {
namespace {

using Eigen::Vector3d;
using ::testing::HasSubstr;

class ModelBenchTest : public testing::Test {
 protected:
  BenchModel AddFile(const std::string& name, const std::string& content) const {
    const std::string path = directory_.File(name);
    EXPECT_TRUE(WriteFile(path, content).ok());
    return {name, path, 1e-3, ""};
  }
  static ModelBenchOptions ShortOptions() {
    ModelBenchOptions options;
    options.num_seeds = 1;
    options.duration_us = 250'000;
    options.camera = "vga";
    return options;
  }

  // Cases run in parallel processes, so that each has its own directory.
  const TemporaryDirectory directory_;
};

TEST_F(ModelBenchTest, KeepsPrismaticModels) {
  ModelBenchOptions options = ShortOptions();
  options.models = {AddFile("box.obj", FrustumObj(4, 70.0, 70.0, 60.0)),
                    AddFile("prism.obj", FrustumObj(6, 60.0, 60.0, 50.0))};
  std::vector<ModelBenchRow> rows;
  const absl::Status status = RunModelBench(options, [&](const ModelBenchRow& row) { rows.push_back(row); });
  ASSERT_TRUE(status.ok()) << status;
  ASSERT_EQ(rows.size(), 2u);
  for (const ModelBenchRow& row : rows) {
    SCOPED_TRACE(row.model.name);
    ASSERT_EQ(row.error, "");
    ASSERT_EQ(row.runs.size(), 1u);
    EXPECT_EQ(row.num_kept, 1);
    EXPECT_LT(row.summary.position_rmse_of_depth, 0.003);
    EXPECT_LT(row.summary.rotation_median_rad, 0.01);
    EXPECT_EQ(row.summary.longest_wrong_s, 0.0);
    EXPECT_GT(row.summary.events_per_s, 1e5);
    EXPECT_GT(row.summary.compute_ratio, 0.0);
    EXPECT_GE(row.mean_elements, 7.0) << "the edges of two or three faces are visible";
    EXPECT_EQ(row.curves, 0u);
  }
  EXPECT_EQ(rows[0].lines, 12u);
  EXPECT_EQ(rows[1].lines, 18u);
  EXPECT_EQ(rows[0].symmetry, "8");
  EXPECT_NEAR(rows[1].diameter_m, std::hypot(0.12, 0.05), 1e-6);
}

TEST_F(ModelBenchTest, ScenesDiffer) {
  ModelBenchOptions options = ShortOptions();
  const BenchModel file = AddFile("box.obj", FrustumObj(4, 70.0, 70.0, 60.0));
  options.recordings = directory_.path();
  const auto box = LoadBenchModel(options, file.path, file.metres_per_unit);
  ASSERT_TRUE(box.ok()) << box.status();
  std::set<std::string> scenes, directories;
  for (const std::string& name : ModelBenchSceneNames()) {
    const auto scene = ParseModelBenchScene(name);
    ASSERT_TRUE(scene.ok()) << scene.status();
    EXPECT_EQ(ModelBenchSceneName(*scene), name);
    options.scene = *scene;
    const auto run = MakeModelRun(options, file, *box, *box, 1);
    ASSERT_TRUE(run.ok()) << run.status();
    scenes.insert(DescribeSimulation(run->simulation));
    directories.insert(run->directory);
    if (*scene != ModelBenchScene::kOccluder) continue;
    const OccluderOptions& occluder = run->simulation.scene.occluder;
    const double diameter_px =
        run->simulation.camera.MaxFocalPx() * (*box)->diameter_m / run->simulation.scene.motion.depth_m;
    EXPECT_NEAR(occluder.width_px, 0.35 * diameter_px, 1e-9);
    EXPECT_TRUE(occluder.is_present && occluder.follows_object);
  }
  EXPECT_EQ(scenes.size(), 3u);
  EXPECT_EQ(directories.size(), 3u);
  EXPECT_THAT(std::string(ParseModelBenchScene("night").status().message()), HasSubstr("moving-background"));
}

TEST_F(ModelBenchTest, ModelThatCannotBePreparedHasTheReason) {
  ModelBenchOptions options = ShortOptions();
  options.models = {AddFile("broken.obj", "v 1 2 3\nf 1 2 3\n")};
  std::vector<ModelBenchRow> rows;
  ASSERT_TRUE(RunModelBench(options, [&](const ModelBenchRow& row) { rows.push_back(row); }).ok());
  ASSERT_EQ(rows.size(), 1u);
  EXPECT_THAT(rows[0].error, HasSubstr("broken.obj"));
  EXPECT_TRUE(rows[0].runs.empty());
}

TEST_F(ModelBenchTest, EndsWhenItIsInterrupted) {
  ModelBenchOptions options = ShortOptions();
  options.models = {AddFile("box.obj", FrustumObj(4, 70.0, 70.0, 60.0))};
  const absl::Status status = RunModelBench(
      options, [](const ModelBenchRow&) { FAIL(); }, [](double, const std::string&) { return false; });
  EXPECT_EQ(status.code(), absl::StatusCode::kCancelled);
}

TEST_F(ModelBenchTest, ValidatesItsOptions) {
  ModelBenchOptions options = ShortOptions();
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("models"));
  options.models = {AddFile("box.obj", "")};
  EXPECT_TRUE(options.Validate().ok());
  options.models[0].metres_per_unit = 0.0;
  EXPECT_THAT(std::string(options.Validate().message()), HasSubstr("metres_per_unit"));
  options.models[0].metres_per_unit = 1.0;
  options.camera = "none";
  EXPECT_FALSE(options.Validate().ok());
}

// A box 0.2 m wide about (0.3, 0, 0), one metre in front of the camera, turned by 0.4 rad about y.
class OutlineUncertaintyTest : public testing::Test {
 protected:
  OutlineUncertaintyTest() {
    for (int i = 0; i < 8; ++i) {
      model_.vertices.emplace_back(i & 1 ? 0.4 : 0.2, i & 2 ? 0.1 : -0.1, i & 4 ? 0.1 : -0.1);
    }
    model_.diameter_m = 0.2;
    pose_.camera_from_object.rotation = ExpSo3({0.0, 0.4, 0.0});
    pose_.camera_from_object.translation_m =
        Vector3d(0.0, 0.0, 1.0) - pose_.camera_from_object.rotation * Vector3d(0.3, 0.0, 0.0);
  }

  // The covariance of one motion with the standard deviation 1: the rotation by `rotation` (rad, axes of the camera)
  // about a point of the object, then the translation.
  Matrix6d CovarianceOf(const Vector3d& rotation, const Vector3d& about_object, const Vector3d& translation) const {
    Vector6d motion;
    motion << translation - rotation.cross(pose_.camera_from_object.rotation * about_object), rotation;
    return motion * motion.transpose();
  }
  double SigmaOf(const Matrix6d& covariance) {
    pose_.covariance = covariance;
    return OutlineUncertainty(model_, 1000.0).LargestSigmaPx(pose_);
  }

  static constexpr double kTolerancePx = 1e-6;
  const Vector3d centre_ = {0.3, 0.0, 0.0};
  ObjectModel model_;
  PoseEstimate pose_;
};

TEST_F(OutlineUncertaintyTest, IsInPixelsAtTheOutline) {
  const Vector3d zero = Vector3d::Zero();
  EXPECT_NEAR(SigmaOf(CovarianceOf(zero, zero, {1e-3, 0, 0})), 1.0, kTolerancePx);
  EXPECT_NEAR(SigmaOf(CovarianceOf(zero, zero, {0, 0, 1e-2})), 1.0, kTolerancePx) << "the size changes by 1 %";
  EXPECT_NEAR(SigmaOf(CovarianceOf({0, 0, 0.01}, centre_, zero)), 1.0, kTolerancePx);
  EXPECT_GT(SigmaOf(CovarianceOf({0, 0, 0.01}, zero, zero)), 2.5) << "a rotation about the origin moves the centre";
}

TEST_F(OutlineUncertaintyTest, MotionsAlongTheSymmetryDoNotCount) {
  const Vector3d axis_object = Vector3d(1.0, 2.0, -1.0).normalized();
  const Vector3d axis_camera = pose_.camera_from_object.rotation * axis_object;
  const Vector3d beside = {0.25, 0.03, 0.02};
  const Matrix6d spin = CovarianceOf(axis_camera, beside, Vector3d::Zero());
  const Matrix6d shift = CovarianceOf(Vector3d::Zero(), Vector3d::Zero(), {0, 1e-3, 0});
  EXPECT_GT(SigmaOf(spin + shift), 90.0);
  model_.continuous_symmetry = {ContinuousSymmetry::Kind::kAxis, beside, axis_object};
  EXPECT_LE(SigmaOf(spin + shift), 1.0 + kTolerancePx);
  EXPECT_GT(SigmaOf(spin + shift), 0.1);
  EXPECT_GT(SigmaOf(spin + CovarianceOf(axis_camera.unitOrthogonal(), beside, Vector3d::Zero())), 50.0);
  model_.continuous_symmetry = {ContinuousSymmetry::Kind::kSphere, beside, Vector3d::Zero()};
  EXPECT_LE(SigmaOf(spin + CovarianceOf(axis_camera.unitOrthogonal(), beside, Vector3d::Zero())), kTolerancePx);
}

}  // namespace
}  // namespace evpose
