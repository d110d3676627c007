// SPDX-License-Identifier: Apache-2.0
#include "core/simulation/objects.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>

#include "core/models/object_model.h"

namespace evpose {
namespace {

// Symmetries of the lines. The shades of a cube's faces, which would break them, are not part of the model.
TEST(SceneObjectTest, Symmetries) {
  for (const auto& [object, count] : {std::pair<SimulatedObject, size_t>{SimulatedObject::kCube, 24},
                                      {SimulatedObject::kCuboid, 4},
                                      {SimulatedObject::kPlanar, 1},
                                      {SimulatedObject::kBook, 1},
                                      {SimulatedObject::kSpacecraft, 1}}) {
    for (const double size_m : {0.05, 0.3, 2.0}) {
      const ObjectModel model = MakeSceneObject(object, size_m).model;
      EXPECT_EQ(model.symmetries.size(), count) << static_cast<int>(object) << " of " << size_m << " m";
      EXPECT_TRUE(model.symmetries[0].rotation.isIdentity(0.0));
    }
  }
}

TEST(SceneObjectTest, ItsFileHasTheSameSymmetries) {
  for (const SimulatedObject object : {SimulatedObject::kCube, SimulatedObject::kCuboid, SimulatedObject::kPlanar,
                                       SimulatedObject::kBook, SimulatedObject::kSpacecraft}) {
    const ObjectModel model = MakeSceneObject(object, 0.3).model;
    const std::string obj = ObjectModelToObj(model);
    const auto loaded =
        ParseObjectModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, ModelFormat::kObj, ModelOptions());
    ASSERT_TRUE(loaded.ok()) << loaded.status();
    EXPECT_EQ(loaded->symmetries.size(), model.symmetries.size()) << static_cast<int>(object);
  }
}

}  // namespace
}  // namespace evpose
