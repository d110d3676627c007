// SPDX-License-Identifier: Apache-2.0
#include "core/geometry/transform_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "absl/strings/str_replace.h"
#include "core/base/output_file.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

// A quarter turn about z and a translation.
RigidTransform QuarterTurn() {
  RigidTransform transform;
  transform.rotation << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  transform.translation_m = {0.5, -1.0, 2.0};
  return transform;
}

double DistanceFrom(const RigidTransform& expected, const RigidTransform& actual) {
  return Difference(actual, expected).norm();
}

std::string TransformErrorOf(const std::string& text) {
  const auto transform = ParseTransform(text, "mount");
  EXPECT_EQ(transform.status().code(), absl::StatusCode::kInvalidArgument) << text;
  return std::string(transform.status().message());
}

TEST(TransformFileTest, AllFormsAreTheSameTransform) {
  // S stands for the sine of 45 degrees.
  for (const char* form : {
           "# world_from_camera\n0.5 -1 2 0 0 S S\n",
           "0.5, -1, 2, 0, 0, S, S",
           "0 -1 0 0.5\n1 0 0 -1\n0 0 1 2\n0 0 0 1\n",
           "[[0, -1, 0, 0.5], [1, 0, 0, -1],\n [0, 0, 1, 2], [0, 0, 0, 1]]",
           "[0 -1 0 0.5; 1 0 0 -1; 0 0 1 2; 0 0 0 1]",
           "translation: [0.5, -1, 2]\nrotation: [0, 0, S, S]\n",
           "translation: [0.5, -1, 2]\nrotation: [[0, -1, 0], [1, 0, 0], [0, 0, 1]]\n",
           ("# ros2 topic echo --once /tf_static\nheader:\n  frame_id: world\nchild_frame_id: camera\ntransform:\n"
            "  translation:\n    x: 0.5\n    y: -1.0\n    z: 2.0\n  rotation: {x: 0, y: 0, z: S, w: S}\n---\n"),
           "parameters:\n  eye_on_hand: false\ntransformation: {x: 0.5, y: -1, z: 2, qx: 0, qy: 0, qz: S, qw: S}\n",
           "{\"translation\": [0.5, -1, 2], \"rotation\": [0, 0, S, S]}",
       }) {
    const std::string text = absl::StrReplaceAll(form, {{"S", "0.70710678118654757"}});
    const auto transform = ParseTransform(text, "mount");
    ASSERT_TRUE(transform.ok()) << transform.status() << "\n" << text;
    EXPECT_LT(DistanceFrom(QuarterTurn(), transform->target_from_source), 1e-12) << text;
  }
}

TEST(TransformFileTest, NamesTheTargetFrame) {
  EXPECT_EQ(ParseTransform("header: {frame_id: map}\ntranslation: [0, 0, 0]\nrotation: [0, 0, 0, 1]", "")->target,
            "map");
  EXPECT_EQ(ParseTransform("0 0 0 0 0 0 1", "")->target, "");
  EXPECT_THAT(TransformErrorOf("frame_id: \"a,b\"\ntranslation: [0, 0, 0]\nrotation: [0, 0, 0, 1]"),
              StartsWith("mount: frame_id: "));
}

TEST(TransformFileTest, WhatItWritesItReads) {
  const RigidTransform transform = ExpSe3((Vector6d() << 0.1, 0.2, 0.3, 1.0, -0.4, 0.2).finished());
  const auto again = ParseTransform(TransformToYaml(transform, "base", "camera", "two\nlines"), "");
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_LT(DistanceFrom(transform, again->target_from_source), 1e-15);
  EXPECT_EQ(again->target, "base");
}

TEST(TransformFileTest, ErrorsNameTheFileAndTheKey) {
  EXPECT_THAT(TransformErrorOf(""), StartsWith("mount: has 0 numbers; give "));
  EXPECT_THAT(TransformErrorOf("1 2 3"), StartsWith("mount: has 3 numbers; give "));
  EXPECT_THAT(TransformErrorOf("16.0 0 0 1 0 0 0 1"), HasSubstr("has 8 numbers, as a trajectory with 8 in a line"));
  EXPECT_THAT(TransformErrorOf("1 0 0 1 0 0 0 1\n2 0 0 1 0 0 0 1\n3 0 0 1 0 0 0 1\n"),
              HasSubstr("has 24 numbers, as a trajectory with 8 in a line"));
  EXPECT_THAT(TransformErrorOf("0 0 0 0 0 0 one"), HasSubstr("\"one\" is not a finite number"));
  EXPECT_THAT(TransformErrorOf("0 0 nan 0 0 0 1"), HasSubstr("\"nan\" is not a finite number"));
  EXPECT_THAT(TransformErrorOf("0 0 0 0 0 0 2"), HasSubstr("its norm is 2"));
  EXPECT_THAT(TransformErrorOf("1 0 0 0 0 1 0 0 0 0 1 0 5 6 7 1"), HasSubstr("last row"));
  EXPECT_THAT(TransformErrorOf("2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1"), HasSubstr("not a rotation"));
  EXPECT_THAT(TransformErrorOf("1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1"), HasSubstr("reflection"));
  EXPECT_THAT(TransformErrorOf("rotation: [0, 0, 0, 1]"), StartsWith("mount: translation: is missing"));
  EXPECT_THAT(TransformErrorOf("translation: [0, 0, 0]"), StartsWith("mount: rotation: is missing"));
  EXPECT_THAT(TransformErrorOf("translation: [0, 0]\nrotation: [0, 0, 0, 1]"), HasSubstr("translation: has 2 numbers"));
  EXPECT_THAT(TransformErrorOf("translation: {x: 0, y: 0}\nrotation: [0, 0, 0, 1]"),
              HasSubstr("translation.z: is missing"));
  EXPECT_THAT(TransformErrorOf("translation: [0, 0, a]\nrotation: [0, 0, 0, 1]"),
              HasSubstr("translation[2]: is not a number"));
  EXPECT_THAT(TransformErrorOf("translation: [0, 0, .inf]\nrotation: [0, 0, 0, 1]"),
              HasSubstr("translation[2]: is not finite"));
  EXPECT_THAT(TransformErrorOf("translation: 1\nrotation: [0, 0, 0, 1]"), HasSubstr("neither a list nor a map"));
  EXPECT_THAT(TransformErrorOf("translation: [0, 0, 0]\nrotation: [1, 0]"), HasSubstr("rotation: has 2 numbers"));
  EXPECT_THAT(TransformErrorOf("translation: [0, 0, 0]\nrotation: [[1, 0, 0], [0, 1, 0], [0, 1, 0]]"),
              HasSubstr("rotation: the 3x3 part is not a rotation"));
  EXPECT_THAT(TransformErrorOf("x: 0\ny: 0\nz: 0\nqx: 0\nqy: 0\nqw: 1"), HasSubstr("qz: is missing"));
  EXPECT_THAT(TransformErrorOf("a: [1\nb: 2"), HasSubstr("not YAML"));
  EXPECT_THAT(TransformErrorOf(std::string(5000, '[') + ":"), StartsWith("mount: "));
  EXPECT_EQ(ReadTransformFile("/no/such/mount.yaml").status().code(), absl::StatusCode::kNotFound);
  const std::string path = ::testing::TempDir() + "/transform_file_test.raw";
  ASSERT_TRUE(WriteFile(path, std::string(100'000, 'x')).ok());
  EXPECT_THAT(ReadTransformFile(path).status().message(),
              HasSubstr("is larger than 65536 bytes, and is no transform; give \"tx ty tz"));
}

}  // namespace
}  // namespace evpose
