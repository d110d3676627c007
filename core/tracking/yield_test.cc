// SPDX-License-Identifier: Apache-2.0

// A tracker that is paused at its yield points gives the same poses, bit for bit.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "core/base/state_io.h"
#include "core/base/yield_point.h"
#include "core/base/yields_testing.h"
#include "core/estimation/ideal_events_testing.h"
#include "core/tracking/tracker.h"
#include "core/tracking/tracking_testing.h"

namespace evpose {
namespace {

std::vector<Event> EventsOfCube(double vx_m_per_s, uint64_t seed) {
  testing::IdealEventOptions options;
  options.duration_us = 100'000;
  options.seed = seed;
  const testing::Motion motion = testing::ConstantTwist(kStart, Twist(vx_m_per_s, 0.15, 0.05, 0.5, 0.3, 0.6));
  return testing::MakeIdealEvents(*testing::MakeCube(0.15), kCamera, motion, options);
}

// Searches for a cube and tracks it, batch by batch.
class CubeRun {
 public:
  CubeRun(double vx_m_per_s, uint64_t seed)
      : events_(EventsOfCube(vx_m_per_s, seed)),
        tracker_(Tracker::Create(Cube(), kCamera, IdealSensor(), std::nullopt).value()) {}

  bool AddBatch() {
    const auto batch = absl::MakeConstSpan(events_).subspan(begin_, 500);
    begin_ += batch.size();
    tracker_->AddEvents(batch, estimates_);
    return begin_ < events_.size();
  }
  std::string Finish() {
    while (AddBatch()) continue;
    tracker_->Finish(estimates_);
    StateWriter writer;
    for (const PoseEstimate& estimate : estimates_) writer(estimate);
    return writer.Take();
  }
  size_t num_poses() const { return estimates_.size(); }

 private:
  const std::vector<Event> events_;
  const std::unique_ptr<Tracker> tracker_;
  size_t begin_ = 0;
  std::vector<PoseEstimate> estimates_;
};

// Runs a batch of another tracker at some of the yield points.
class RunsAnother : public Yielder {
 public:
  explicit RunsAnother(CubeRun& other) : other_(other) {}

  void Yield() override {
    if (is_running_ || ++num_yields_ % 50 != 0) return;
    is_running_ = true;
    if (has_more_) {
      has_more_ = other_.AddBatch();
      ++num_batches_;
    }
    is_running_ = false;
  }
  size_t num_batches() const { return num_batches_; }

 private:
  CubeRun& other_;
  bool has_more_ = true;
  bool is_running_ = false;
  size_t num_yields_ = 0;
  size_t num_batches_ = 0;
};

TEST(YieldTest, PausesDoNotChangeThePoses) {
  CubeRun first(0.3, 1), second(-0.2, 2);
  const std::string first_poses = first.Finish();
  const std::string second_poses = second.Finish();
  ASSERT_GT(first.num_poses(), 20u);
  ASSERT_GT(second.num_poses(), 20u);
  CubeRun paused(0.3, 1), between(-0.2, 2);
  RunsAnother yielder(between);
  std::string paused_poses;
  {
    const ScopedYielder scope(yielder);
    paused_poses = paused.Finish();
  }
  EXPECT_GT(yielder.num_batches(), 10u);
  EXPECT_TRUE(paused_poses == first_poses);
  EXPECT_TRUE(between.Finish() == second_poses);
}

TEST(YieldTest, ATrackerIsDestroyedInPieces) {
  constexpr size_t kNumObjects = 4;
  std::vector<ObjectToTrack> objects(kNumObjects);
  for (ObjectToTrack& object : objects) object.model = Cube();
  std::unique_ptr<Tracker> tracker = Tracker::Create(objects, kCamera, IdealSensor()).value();
  EXPECT_GE(CountYields([&] { tracker.reset(); }), kNumObjects);
}

}  // namespace
}  // namespace evpose
