// SPDX-License-Identifier: Apache-2.0
#include "core/experiments/speed/speed_windows.h"

#include <gtest/gtest.h>

#include <vector>

namespace evpose {
namespace {

// The associator reuses its memory for every window, whereas the estimation is measured with the inputs of all windows.
TEST(SpeedWindowsTest, InputsOfAWindowAreThoseOfItsAssociation) {
  const SpeedRecording recording = MakeSpeedRecording("1", 20'000).value();
  const SpeedWindows made = MakeSpeedWindows(recording).value();
  ASSERT_GT(made.windows.size(), 5u);
  const std::vector<EstimationInput> inputs = MakeEstimationInputs(*made.context, made.windows);
  ASSERT_EQ(inputs.size(), made.windows.size());
  WindowAssociation association(*made.context);
  for (size_t i = 0; i < inputs.size(); ++i) {
    SCOPED_TRACE(i);
    const WindowInput& given = inputs[i].input;
    const WindowInput expected = association.Associate(made.windows[i]);
    ASSERT_EQ(given.events.size(), expected.events.size());
    EXPECT_EQ(given.sorted->groups().size(), expected.sorted->groups().size());
    ASSERT_EQ(given.image_lines.size(), expected.image_lines.size());
    ASSERT_EQ(given.cells.size(), expected.cells.size());
    for (size_t k = 0; k < expected.cells.size(); ++k) {
      EXPECT_EQ(given.image_lines[k].a, expected.image_lines[k].a);
      EXPECT_EQ(given.cells[k].border_px, expected.cells[k].border_px);
    }
  }
}

}  // namespace
}  // namespace evpose
