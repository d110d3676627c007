// SPDX-License-Identifier: Apache-2.0
#include "core/initialization/pose_search.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "core/models/symmetry.h"
#include "core/models/visibility.h"
#include "core/numerics/random.h"
#include "tests/data/test_data.h"

namespace evpose {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

CameraModel Camera() { return {1280, 720, 1030.0, 1030.0, 640.0, 360.0, {}}; }

// A box with its corner at -size / 2.
ObjectModel Box(const Vector3d& size) {
  ObjectModel model;
  for (int corner = 0; corner < 8; ++corner) {
    model.vertices.push_back(
        Vector3d((corner & 1) - 0.5, (corner >> 1 & 1) - 0.5, (corner >> 2 & 1) - 0.5).cwiseProduct(size));
  }
  const auto quad = [&](uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
    model.triangles.push_back({a, b, c});
    model.triangles.push_back({a, c, d});
  };
  quad(0, 4, 6, 2), quad(1, 3, 7, 5), quad(0, 1, 5, 4), quad(2, 6, 7, 3), quad(0, 2, 3, 1), quad(4, 5, 7, 6);
  for (int corner = 0; corner < 8; ++corner) {
    for (int axis = 0; axis < 3; ++axis) {
      if ((corner >> axis & 1) != 0) continue;
      ModelLine line{model.vertices[corner], model.vertices[corner | 1 << axis], {}};
      for (const int other : {(axis + 1) % 3, (axis + 2) % 3}) {
        line.face_normals.push_back(Vector3d::Unit(other) * ((corner >> other & 1) != 0 ? 1.0 : -1.0));
      }
      model.lines.push_back(line);
    }
  }
  model.diameter_m = size.norm();
  model.symmetries = FindSymmetries(model);
  return model;
}

// Lines in all directions, without faces that could hide them.
ObjectModel Wires(int count, uint64_t seed) {
  Random random(seed);
  ObjectModel model;
  const auto point = [&] {
    return Vector3d{random.Uniform(-0.1, 0.1), random.Uniform(-0.1, 0.1), random.Uniform(-0.1, 0.1)};
  };
  for (int i = 0; i < count; ++i) {
    const Vector3d p1 = point(), p2 = point();
    model.lines.push_back({p1, p2, {}});
  }
  model.diameter_m = 0.2 * std::sqrt(3.0);
  return model;
}

std::vector<ImageSegment> SeenLines(const ObjectModel& model, const RigidTransform& pose, double noise_px,
                                    uint64_t seed) {
  Random random(seed);
  std::vector<ImageSegment> segments;
  const VisibilityTester visibility(model, {});
  for (const VisibleSegment& part : visibility.VisibleSegments(Camera(), pose)) {
    const ModelLine& line = model.lines[part.line];
    const auto project = [&](double s) -> Vector2d {
      const double x = random.Normal(), y = random.Normal();
      return Camera().Project(pose * (line.p1 + s * (line.p2 - line.p1))) + noise_px * Vector2d(x, y);
    };
    const Vector2d begin = project(part.begin);
    segments.push_back({begin, project(part.end)});
  }
  return segments;
}

RigidTransform Pose(const Vector3d& rotation_rad, double depth_m) {
  return {ExpSo3(rotation_rad), Vector3d(0.02, -0.01, depth_m)};
}

std::unique_ptr<PoseSearch> Make(const ObjectModel& model, const PoseSearchOptions& options = {}) {
  return MakePoseSearch(std::make_shared<ObjectModel>(model), Camera(), options).value();
}

void ExpectPose(const std::vector<PoseHypothesis>& hypotheses, const ObjectModel& model, const RigidTransform& truth,
                double tolerance_rad, double tolerance_m) {
  ASSERT_FALSE(hypotheses.empty());
  const RigidTransform pose = NearestEquivalent(hypotheses[0].camera_from_object, model.symmetries, truth);
  EXPECT_LT(RotationAngle(pose.rotation, truth.rotation), tolerance_rad);
  EXPECT_LT((pose.translation_m - truth.translation_m).norm(), tolerance_m);
}

TEST(PoseSearchTest, ExactLinesGiveTheExactPose) {
  const ObjectModel box = Box({0.2, 0.14, 0.09});
  const auto search = Make(box);
  for (const double yaw : {0.3, 1.2, 2.5, 4.0}) {
    const RigidTransform truth = Pose({0.5, yaw, 0.4}, 0.8);
    const auto segments = SeenLines(box, truth, 0.0, 1);
    const auto hypotheses = search->Search(segments);
    ExpectPose(hypotheses, box, truth, 1e-4, 1e-4);
    EXPECT_EQ(hypotheses[0].num_matched, static_cast<int>(segments.size()));
    EXPECT_LT(hypotheses[0].cost, 0.1);
  }
}

TEST(PoseSearchTest, OrderAndDirectionDoNotMatter) {
  const ObjectModel box = Box({0.2, 0.14, 0.09});
  const auto search = Make(box);
  const RigidTransform truth = Pose({0.5, 0.7, 0.4}, 0.8);
  auto segments = SeenLines(box, truth, 0.8, 1);
  const auto first = search->Search(segments);
  std::reverse(segments.begin(), segments.end());
  for (ImageSegment& segment : segments) std::swap(segment.p1_px, segment.p2_px);
  const auto second = search->Search(segments);
  ExpectPose(first, box, truth, 0.035, 0.016);
  ExpectPose(second, box, first[0].camera_from_object, 1e-3, 1e-3);
}

TEST(PoseSearchTest, TheSameSegmentsGiveTheSameBits) {
  const ObjectModel box = Box({0.2, 0.14, 0.09});
  const auto segments = SeenLines(box, Pose({0.5, 0.7, 0.4}, 0.8), 0.8, 1);
  const auto first = Make(box)->Search(segments), second = Make(box)->Search(segments);
  ASSERT_EQ(first.size(), second.size());
  for (size_t i = 0; i < first.size(); ++i) {
    EXPECT_EQ(first[i].camera_from_object.rotation, second[i].camera_from_object.rotation);
    EXPECT_EQ(first[i].cost, second[i].cost);
  }
}

TEST(PoseSearchTest, HypothesesAreDistinctModuloSymmetries) {
  const ObjectModel cube = Box({0.2, 0.2, 0.2});
  ASSERT_EQ(cube.symmetries.size(), 24);
  const auto hypotheses = Make(cube)->Search(SeenLines(cube, Pose({0.5, 0.7, 0.4}, 0.9), 0.8, 1));
  for (size_t i = 0; i < hypotheses.size(); ++i) {
    for (size_t j = 0; j < i; ++j) {
      const RigidTransform near =
          NearestEquivalent(hypotheses[i].camera_from_object, cube.symmetries, hypotheses[j].camera_from_object);
      EXPECT_TRUE(RotationAngle(near.rotation, hypotheses[j].camera_from_object.rotation) > 0.015 ||
                  (near.translation_m - hypotheses[j].camera_from_object.translation_m).norm() > 0.005);
    }
  }
}

// At a great distance the images of a flat object and of its depth reflection are nearly equal.
TEST(PoseSearchTest, TheDepthReflectionOfAFlatObjectIsAHypothesis) {
  ObjectModel plate;
  const auto add = [&](double x1, double y1, double x2, double y2) {
    plate.lines.push_back({Vector3d(x1, y1, 0.0), Vector3d(x2, y2, 0.0), {}});
  };
  add(-0.13, -0.1, 0.13, -0.1), add(0.13, -0.1, 0.13, 0.1), add(0.13, 0.1, -0.13, 0.1), add(-0.13, 0.1, -0.13, -0.1);
  add(-0.04, -0.1, -0.04, 0.1), add(-0.04, 0.02, 0.13, 0.02);
  plate.diameter_m = 0.33;
  const auto search = Make(plate);
  int num_both = 0;
  for (int trial = 0; trial < 20; ++trial) {
    const RigidTransform truth = Pose({0.6 - 0.02 * trial, 0.4, 0.3 * trial}, 2.5);
    const Vector3d sight = truth.translation_m.normalized(), normal = truth.rotation.col(2);
    const Vector3d other = 2.0 * normal.dot(sight) * sight - normal;
    bool has_truth = false, has_other = false;
    for (const PoseHypothesis& hypothesis : search->Search(SeenLines(plate, truth, 0.8, trial))) {
      has_truth |= hypothesis.camera_from_object.rotation.col(2).dot(normal) > 0.98;
      has_other |= hypothesis.camera_from_object.rotation.col(2).dot(other) > 0.98;
    }
    num_both += has_truth && has_other;
  }
  EXPECT_GE(num_both, 17);  // noise rotates a few poses by more than 11 degrees
}

TEST(PoseSearchTest, TooFewSegmentsGiveNoPose) {
  const ObjectModel box = Box({0.2, 0.14, 0.09});
  const auto search = Make(box);
  EXPECT_TRUE(search->Search({}).empty());
  auto segments = SeenLines(box, Pose({0.5, 0.7, 0.4}, 0.8), 0.8, 1);
  segments.resize(2);
  EXPECT_TRUE(search->Search(segments).empty());
  const double nan = std::nan("");
  segments.assign(10, {{nan, 1.0}, {2.0, 3.0}});
  EXPECT_TRUE(search->Search(segments).empty());
  segments.assign(10, {{5.0, 5.0}, {5.0, 5.0}});
  EXPECT_TRUE(search->Search(segments).empty());
}

TEST(PoseSearchTest, ClutterGivesNoPose) {
  const ObjectModel box = Box({0.2, 0.14, 0.09});
  const auto search = Make(box);
  Random random(5);
  int num_well_matched = 0;
  for (int trial = 0; trial < 30; ++trial) {
    std::vector<ImageSegment> segments;
    for (int i = 0; i < 10; ++i) {
      const Vector2d middle{random.Uniform(400.0, 800.0), random.Uniform(200.0, 500.0)};
      const double angle_rad = random.Uniform(0.0, M_PI);
      const Vector2d half = random.Uniform(30.0, 100.0) * Vector2d(std::cos(angle_rad), std::sin(angle_rad));
      segments.push_back({middle - half, middle + half});
    }
    for (const PoseHypothesis& hypothesis : search->Search(segments)) num_well_matched += hypothesis.num_matched >= 7;
  }
  EXPECT_EQ(num_well_matched, 0);
}

TEST(PoseSearchTest, ManyDirections) {
  for (const int count : {8, 15, 40}) {
    const ObjectModel wires = Wires(count, 3);
    const auto search = Make(wires);
    int num_right = 0;
    for (int trial = 0; trial < 20; ++trial) {
      const RigidTransform truth = Pose({0.3 * trial, 1.0 - 0.2 * trial, 0.5}, 0.7);
      const auto hypotheses = search->Search(SeenLines(wires, truth, 0.5, trial));
      num_right += !hypotheses.empty() &&
                   RotationAngle(hypotheses[0].camera_from_object.rotation, truth.rotation) < 0.035 &&
                   (hypotheses[0].camera_from_object.translation_m - truth.translation_m).norm() < 0.014;
    }
    EXPECT_GE(num_right, 15) << count << " directions";
  }
}

TEST(PoseSearchTest, ThousandsOfLinesAreBounded) {
  const ObjectModel wires = Wires(4000, 3);
  const auto search = Make(wires);
  Random random(5);
  std::vector<ImageSegment> segments;
  for (int i = 0; i < 500; ++i) {
    segments.push_back({{random.Uniform(0.0, 1280.0), random.Uniform(0.0, 720.0)},
                        {random.Uniform(0.0, 1280.0), random.Uniform(0.0, 720.0)}});
  }
  EXPECT_LE(search->Search(segments).size(), 6);
}

TEST(PoseSearchTest, InvalidArgumentsAreRejected) {
  const auto box = std::make_shared<ObjectModel>(Box({0.2, 0.14, 0.09}));
  const auto refusal = [&](const PoseSearchOptions& options) {
    const auto search = MakePoseSearch(box, Camera(), options);
    EXPECT_EQ(search.status().code(), absl::StatusCode::kInvalidArgument);
    return std::string(search.status().message());
  };
  PoseSearchOptions options;
  options.end_point_sigma_px = 0.0;
  EXPECT_THAT(refusal(options), testing::HasSubstr("end_point_sigma_px"));
  options = {};
  options.max_segments = 65;
  EXPECT_THAT(refusal(options), testing::HasSubstr("max_segments"));
  options = {};
  options.unexplained_cost = 2.0;
  EXPECT_THAT(refusal(options), testing::HasSubstr("unexplained_cost"));
  auto two_lines = std::make_shared<ObjectModel>(*box);
  two_lines->lines.resize(2);
  EXPECT_EQ(MakePoseSearch(two_lines, Camera()).status().code(), absl::StatusCode::kInvalidArgument);
}

// The nine lines of a cube in the published implementation of LOPET (line_parameter), exact to 0.08 px.
TEST(PoseSearchTest, ThePublishedCubesNineLinesFitWithinAPixel) {
  const std::string path = FindTestData("lopet_cube_line_model/line_parameter.json");
  if (path.empty()) GTEST_SKIP() << "the published lines are not in the test data";
  std::ifstream file(path);
  const auto json = nlohmann::json::parse(file);
  const auto& k = json["K"];
  const CameraModel camera{1280, 720, k[0][0], k[1][1], k[0][2], k[1][2], {}};
  std::vector<ImageSegment> segments;
  std::vector<std::array<Vector3d, 2>> lines;
  const size_t count = json["x_c_normalised_xy"].size() / 2;  // the list has all first ends, then all second ends
  for (size_t i = 0; i < count; ++i) {
    const auto pixel = [&](size_t j) -> Vector2d {
      const auto& x = json["x_c_normalised_xy"][j];
      return camera.Project(Vector3d(x[0].get<double>(), x[1].get<double>(), 1.0));
    };
    const auto point = [&](size_t j) -> Vector3d {
      const auto& x = json["X_W_xyz_m"][j];
      return Vector3d(x[0].get<double>(), x[1].get<double>(), x[2].get<double>());
    };
    segments.push_back({pixel(i), pixel(i + count)});
    lines.push_back({point(i), point(i + count)});
  }
  ASSERT_EQ(segments.size(), 9);
  const ObjectModel cube = Box({0.25, 0.25, 0.25});
  const auto search = MakePoseSearch(std::make_shared<ObjectModel>(cube), camera).value();
  Random random(1);
  for (int shuffle = 0; shuffle < 300; ++shuffle) {
    std::vector<ImageSegment> shuffled = segments;
    for (size_t i = shuffled.size(); i > 1; --i) std::swap(shuffled[i - 1], shuffled[random.UniformInt(i)]);
    for (ImageSegment& segment : shuffled) {
      if (random.UniformInt(2) == 0) std::swap(segment.p1_px, segment.p2_px);
    }
    const auto hypotheses = search->Search(shuffled);
    ASSERT_FALSE(hypotheses.empty());
    EXPECT_EQ(hypotheses[0].num_matched, 9);
    // One of the 24 equivalent poses of the cube projects every listed point onto its image.
    double best_px = 1e9;
    for (const RigidTransform& symmetry : cube.symmetries) {
      const RigidTransform pose = hypotheses[0].camera_from_object * symmetry;
      double worst_px = 0.0;
      for (size_t i = 0; i < segments.size(); ++i) {
        worst_px = std::max(worst_px, (camera.Project(pose * lines[i][0]) - segments[i].p1_px).norm());
        worst_px = std::max(worst_px, (camera.Project(pose * lines[i][1]) - segments[i].p2_px).norm());
      }
      best_px = std::min(best_px, worst_px);
    }
    EXPECT_LT(best_px, 1.0);
  }
}

}  // namespace
}  // namespace evpose
