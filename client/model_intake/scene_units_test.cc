// SPDX-License-Identifier: Apache-2.0
#include "client/model_intake/scene_units.h"

#include <string>

#include "gtest/gtest.h"

namespace evpose::client {
namespace {

TEST(SceneUnitsTest, TheUnitOfColladaIsFoundAmongOtherAttributesAndElements) {
  const auto check = [](const std::string& asset) {
    return CheckContents("<?xml?><COLLADA><asset>" + asset + "</asset>", SceneFormat::kDae);
  };
  EXPECT_TRUE(check("").ok()) << "the default is a metre";
  EXPECT_TRUE(check("<unit name=\"meter\" meter=\"1\"/>").ok());
  EXPECT_TRUE(check("<units meter=\"0\"/><unit\n meter = '0.0254' name='inch'/>").ok());
  EXPECT_FALSE(check("<unit name=\"meter\" meter=\"0\"/>").ok());
  EXPECT_FALSE(check("<unit name=\" meter='1'\" meter=\"-1\"/>").ok());
}

TEST(SceneUnitsTest, SignaturesTellFormatsApart) {
  EXPECT_TRUE(CheckContents("\xEF\xBB\xBF {\"asset\":1}", SceneFormat::kGltf).ok());
  EXPECT_TRUE(CheckContents("STOFF 1 1 0\n0 0 0\n1 0\n", SceneFormat::kOff).ok());
  EXPECT_FALSE(CheckContents("glTF", SceneFormat::kGltf).ok());
  EXPECT_FALSE(CheckContents("{", SceneFormat::kGlb).ok());
  EXPECT_FALSE(CheckContents("", SceneFormat::kObj).ok());
}

TEST(SceneUnitsTest, AnOffFileHasAsManyLinesAsItStates) {
  const std::string points = "# comment\n0 0 0\n1 0 0\n\n0 1 0\n";
  EXPECT_TRUE(CheckContents("OFF\n3 1 0\n" + points + "3 0 1 2\n", SceneFormat::kOff).ok());
  EXPECT_TRUE(CheckContents("OFF 3 1 0\n" + points + "3 0 1 2\n", SceneFormat::kOff).ok());
  EXPECT_EQ(CheckContents("OFF\n3 1 0\n" + points, SceneFormat::kOff).message(),
            "is cut off: it states 3 points and 1 faces, but has 3 lines for them");
  EXPECT_FALSE(CheckContents("OFF\n9223372036854775807 9223372036854775807 0\n", SceneFormat::kOff).ok());
  EXPECT_FALSE(CheckContents("OFF\n", SceneFormat::kOff).ok());
  EXPECT_EQ(CheckContents("OFF BINARY\n" + std::string(100, '\0'), SceneFormat::kOff).message(),
            "is a binary OFF file, which is not read: export it as text, or as STL or PLY");
}

}  // namespace
}  // namespace evpose::client
