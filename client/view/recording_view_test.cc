// SPDX-License-Identifier: Apache-2.0
#include "client/view/recording_view.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <atomic>
#include <condition_variable>
#include <future>
#include <numeric>
#include <string>
#include <vector>

#include "client/cli/common/pose_format.h"
#include "client/containers/open_recording.h"
#include "client/lib/messages/core_types.h"
#include "client/view/outbox_reader_testing.h"
#include "client/view/page_client_testing.h"
#include "client/view/recordings_testing.h"
#include "core/base/output_file.h"
#include "core/base/temporary_directory_testing.h"
#include "core/estimation/ideal_events_testing.h"

namespace evpose::client {
namespace {

using ::testing::HasSubstr;

constexpr int64_t kBeginUs = 16'000'000;
constexpr int64_t kEndUs = 16'200'000;
constexpr int64_t kPosePeriodUs = 1'000;

std::vector<uint8_t> CellsOf(const ReceivedMessage& image) {
  const size_t size = (image.header["width"].get<size_t>() * image.header["height"].get<size_t>() + 3) / 4;
  const std::string& section = image.sections.at(0);
  if (image.header["encoding"] == "packed") return {section.begin(), section.end()};
  std::vector<uint8_t> cells(size);
  uLongf unpacked = size;
  EXPECT_EQ(uncompress(cells.data(), &unpacked, reinterpret_cast<const Bytef*>(section.data()), section.size()), Z_OK);
  EXPECT_EQ(unpacked, size);
  return cells;
}

class RecordingViewTest : public ::testing::Test {
 protected:
  static RigidTransform PoseAt(int64_t t_us) {
    const double t_s = static_cast<double>(t_us - kBeginUs) * 1e-6;
    return testing::MakePose({0.02 * t_s, 0.0, 0.5}, {0.5 + t_s, 0.4, 0.1});
  }
  // Poses from 50 ms after the beginning to 50 ms before the end, with a gap of 60 ms and a degraded pose at its end.
  static std::vector<Pose> Poses() {
    std::vector<Pose> poses;
    for (int64_t t_us = kBeginUs + 50'000; t_us <= kEndUs - 50'000; t_us += kPosePeriodUs) {
      if (t_us > kBeginUs + 70'000 && t_us < kBeginUs + 130'000) continue;
      Pose pose;
      pose.object_id = "object";
      pose.seq = poses.size() + 1;
      pose.t_us = t_us;
      pose.camera_from_object = FromCore(PoseAt(t_us));
      pose.state = t_us == kBeginUs + 130'000 ? TrackState::kDegraded : TrackState::kTracking;
      pose.covariance.diagonal().setConstant(1e-6);
      poses.push_back(pose);
    }
    return poses;
  }

  // The poses are in a file in this frame, and the page shows them in it.
  RecordingInputs Inputs(bool has_truth, const PoseFrame& frame = {}) {
    RecordingInputs inputs;
    inputs.frame = frame;
    inputs.path = directory_.File("events.raw");
    inputs.camera = testing::MakeCamera(kTestSensor.width_px, kTestSensor.height_px, 600.0);
    inputs.objects.push_back({"object", "cube.obj", *testing::MakeCube(0.1)});
    std::string text = PoseHeader(PoseFormat::kCsv, frame), truth;
    for (const Pose& pose : Poses()) text += PoseLine(PoseFormat::kCsv, pose, frame);
    for (int64_t t_us = kBeginUs; t_us < kEndUs; t_us += 20'000) truth += TumLine({t_us, PoseAt(t_us)}) + "\n";
    EXPECT_TRUE(WriteFile(directory_.File("poses.csv"), text).ok());
    EXPECT_TRUE(WriteFile(directory_.File("truth.tum"), truth).ok());
    inputs.poses = *ReadRecordedPoses(directory_.File("poses.csv"), {"object"}, frame);
    if (has_truth) inputs.truth = *ReadRecordedPoses(directory_.File("truth.tum"), {"object"});
    return inputs;
  }
  void Open(bool has_truth = false) { Open(Inputs(has_truth)); }
  void Open(RecordingInputs inputs) {
    WriteRecording(inputs.path, events_);
    auto reader = OpenRecording(inputs.path);
    ASSERT_TRUE(reader.ok()) << reader.status();
    inputs.reader = std::move(*reader);
    auto source = RecordingSource::Open(std::move(inputs));
    ASSERT_TRUE(source.ok()) << source.status();
    source_ = std::move(*source);
    view_ = source_->Open(reader_.outbox());
  }
  ReceivedMessage Seek(int64_t t_us) {
    EXPECT_TRUE(view_->Handle(SeekRequest{t_us}).ok());
    return reader_.ReadImage(t_us);
  }

  const TemporaryDirectory directory_;
  const std::vector<Event> events_ = RandomEvents(200'000, kBeginUs, kEndUs, 7);
  OutboxReader reader_;
  std::unique_ptr<RecordingSource> source_;
  std::unique_ptr<PageView> view_;
};

TEST_F(RecordingViewTest, BeginsWithTheSceneAndTheFirstPose) {
  Open(/*has_truth=*/true);
  const ReceivedMessage hello = reader_.Read();
  EXPECT_EQ(hello.type(), "hello");
  EXPECT_EQ(hello.header["mode"], "recording");
  const ReceivedMessage scene = reader_.Read();
  ASSERT_EQ(scene.type(), "scene");
  EXPECT_EQ(scene.header["camera"]["fx_px"], 600.0);
  EXPECT_EQ(scene.header["objects"][0]["model"], "cube.obj");
  EXPECT_EQ(scene.header["has_truth"], true);
  std::map<std::string, std::vector<ReceivedMessage>> messages;
  while (messages["image"].empty() || messages["geometry"].empty() || messages["poses"].size() < 2 ||
         messages["range"].empty() || messages["range"].back().header["complete"] != true) {
    const ReceivedMessage message = reader_.Read();
    messages[message.type()].push_back(message);
  }
  EXPECT_EQ(messages["image"][0].header["t_us"], kBeginUs + 50'000);
  EXPECT_EQ(messages["geometry"].at(0).header["object"], "object");
  EXPECT_EQ(messages["poses"][0].header["poses"].size(), Poses().size());
  EXPECT_EQ(messages["poses"][1].header["truth"], true);
  EXPECT_EQ(messages["range"].back().header["from_us"], events_.front().t_us);
  EXPECT_EQ(messages["range"].back().header["to_us"], events_.back().t_us);
  const nlohmann::json& counted = messages["range"].back().header["events"];
  EXPECT_EQ(counted["from_us"], events_.front().t_us);
  EXPECT_EQ(counted["step_us"], 1024);
  const std::vector<size_t> counts = counted["counts"];
  EXPECT_EQ(counts.size(), static_cast<size_t>((events_.back().t_us - events_.front().t_us) / 1024 + 1));
  EXPECT_EQ(std::accumulate(counts.begin(), counts.end(), size_t{0}), events_.size());
  // The states: tracking, degraded after the gap, for which the file states no loss, tracking again.
  std::vector<std::string> states;
  for (const ReceivedMessage& state : messages["state"]) states.push_back(state.header["state"]);
  EXPECT_THAT(states, ::testing::ElementsAre("tracking", "degraded", "tracking"));
  EXPECT_EQ(messages["state"].at(1).header["t_us"], kBeginUs + 130'000);
}

TEST_F(RecordingViewTest, PosesAreSentInTheChosenFrameAndOutlinesStayInTheImage) {
  const RigidTransform mount{ExpSo3({-0.4, 0.2, 1.0}), {3.0, 2.0, 1.0}};
  std::vector<ReceivedMessage> images;
  for (const PoseFrame& frame :
       {PoseFrame(), PoseFrame::WorldFromObject(mount, "base"), PoseFrame::ObjectFromCamera()}) {
    view_.reset();
    Open(Inputs(/*has_truth=*/true, frame));
    const ReceivedMessage scene = reader_.ReadUntil("scene");
    EXPECT_EQ(scene.header["frame"]["transform"], frame.transform());
    for (const bool is_truth : {false, true}) {
      const ReceivedMessage sent = reader_.ReadUntil("poses");
      ASSERT_EQ(sent.header.contains("truth"), is_truth);
      const nlohmann::json& first = sent.header["poses"][0];
      Pose pose = Poses()[0];
      pose.camera_from_object = FromCore(PoseAt(first["t_us"]));
      const Pose expected = frame.Apply(pose);
      for (int i = 0; i < 3; ++i) {
        EXPECT_NEAR(first["p"][i], expected.camera_from_object.translation_m[i], 1e-9) << frame.transform();
        if (!is_truth) {
          EXPECT_NEAR(first["sigma"][i], std::sqrt(expected.covariance(i, i)), 1e-9);
        }
      }
      EXPECT_NEAR(first["q"][0], expected.camera_from_object.Quaternion().w(), 1e-9);
    }
    images.push_back(Seek(kBeginUs + 150'000));
  }
  ASSERT_EQ(images[0].header["outlines"].size(), 2u);
  for (const ReceivedMessage& image : images) {
    EXPECT_EQ(image.header["outlines"], images[0].header["outlines"]);
    const std::vector<float> ends = Floats(image.sections.at(1)), expected = Floats(images[0].sections.at(1));
    ASSERT_EQ(ends.size(), expected.size());
    for (size_t i = 0; i < ends.size(); ++i) EXPECT_NEAR(ends[i], expected[i], 1e-3);
  }
}

TEST_F(RecordingViewTest, AnObjectWithoutAPoseAtTheEndIsLost) {
  RecordingInputs inputs = Inputs(/*has_truth=*/true);
  inputs.poses["object"] = RecordedPoses();
  ASSERT_TRUE(inputs.poses["object"].Add(Poses()[0]).ok());
  Open(std::move(inputs));
  ReceivedMessage state = reader_.ReadUntil("state");
  if (state.header["state"] != "lost") state = reader_.ReadUntil("state");
  EXPECT_EQ(state.header["state"], "lost");
  EXPECT_EQ(state.header["t_us"], kBeginUs + 50'001);
  EXPECT_EQ(state.header["reason"], "no pose until the end of the recording");
}

TEST_F(RecordingViewTest, AnImageHasExactlyTheEventsOfItsWindow) {
  Open();
  for (const int cell_px : {1, 2, 4}) {
    for (const double window_ms : {0.1, 10.0, 33.0}) {
      ASSERT_TRUE(view_->Handle(ImageSettings{window_ms, cell_px, 30.0}).ok());
      for (const int64_t t_us : {kBeginUs, kBeginUs + 100'123, kEndUs, kEndUs + 500'000}) {
        const ReceivedMessage image = Seek(t_us);
        ASSERT_EQ(image.header["cell_px"], cell_px);
        const int64_t half_us = std::llround(window_ms * 500.0);
        ASSERT_EQ(image.header["from_us"], t_us - half_us);
        ASSERT_EQ(image.header["to_us"], t_us + half_us);
        const int width = (kTestSensor.width_px + cell_px - 1) / cell_px;
        std::vector<uint8_t> cells((static_cast<size_t>(width * kTestSensor.height_px / cell_px) + 3) / 4);
        uint64_t count = 0;
        for (const Event& event : events_) {
          if (event.t_us < t_us - half_us || event.t_us >= t_us + half_us) continue;
          const int place = event.y / cell_px * width + event.x / cell_px;
          const auto cell = static_cast<size_t>(place);
          cells[cell / 4] |= static_cast<uint8_t>((event.polarity != 0 ? 1 : 2) << (2 * (cell % 4)));
          ++count;
        }
        EXPECT_EQ(image.header["events"], count);
        EXPECT_EQ(CellsOf(image), cells) << cell_px << " " << window_ms << " " << t_us;
      }
    }
  }
}

TEST_F(RecordingViewTest, OutlinesAreAtThePoseOfTheInstant) {
  Open(/*has_truth=*/true);
  const CameraModel& camera = source_->inputs().camera;
  const ObjectModel& cube = source_->inputs().objects[0].model;
  for (const int64_t t_us : {kBeginUs + 55'000, kBeginUs + 60'500, kBeginUs + 130'000}) {
    const ReceivedMessage image = Seek(t_us);
    ASSERT_EQ(image.header["outlines"].size(), 2u);
    const nlohmann::json& outline = image.header["outlines"][0];
    EXPECT_EQ(outline["truth"], false);
    EXPECT_EQ(image.header["outlines"][1]["truth"], true);
    EXPECT_EQ(outline["state"], t_us == kBeginUs + 130'000 ? "degraded" : "tracking");
    const RigidTransform pose = PoseAt(t_us);
    // Each segment lies on an edge of the cube.
    std::vector<std::array<float, 4>> ends(outline["segments"].get<size_t>());
    ASSERT_EQ(image.sections.at(1).size(), ends.size() * sizeof(ends[0]));
    std::memcpy(ends.data(), image.sections[1].data(), image.sections[1].size());
    EXPECT_GE(ends.size(), 7u);
    for (const auto& end : ends) {
      double nearest_px = 1e9;
      for (const ModelLine& line : cube.lines) {
        const Eigen::Vector2d a = camera.Project(pose * line.p1), b = camera.Project(pose * line.p2);
        const Eigen::Vector2d direction = (b - a).normalized();
        const auto distance = [&](double x, double y) {
          const Eigen::Vector2d d = Eigen::Vector2d(x, y) - a;
          return std::abs(direction.x() * d.y() - direction.y() * d.x());
        };
        nearest_px = std::min(nearest_px, std::max(distance(end[0], end[1]), distance(end[2], end[3])));
      }
      EXPECT_LT(nearest_px, 0.01);
    }
  }
  EXPECT_EQ(Seek(kBeginUs + 100'000).header["outlines"].size(), 1u) << "in the gap there is the truth alone";
  EXPECT_EQ(Seek(kEndUs + 1'000'000).header["outlines"].size(), 0u);
}

TEST_F(RecordingViewTest, StepsGoToTheNextAndThePreviousPose) {
  Open();
  const std::vector<Pose> poses = Poses();
  const auto step = [&](int count) {
    EXPECT_TRUE(view_->Handle(StepRequest{count}).ok());
    return reader_.ReadUntil("image").header["t_us"].get<int64_t>();
  };
  reader_.ReadImage(poses[0].t_us);
  EXPECT_EQ(step(1), poses[1].t_us);
  EXPECT_EQ(step(1), poses[2].t_us);
  EXPECT_EQ(step(-2), poses[0].t_us);
  EXPECT_EQ(step(-1), poses[0].t_us);
  EXPECT_EQ(step(10'000), poses.back().t_us);
  Seek(poses[5].t_us + 1);
  EXPECT_EQ(step(1), poses[6].t_us);
  Seek(poses[5].t_us + 1);
  EXPECT_EQ(step(-1), poses[5].t_us);
  EXPECT_EQ(reader_.outbox()->WantsImage(), true);
}

TEST_F(RecordingViewTest, PlayEndsWithTheRecording) {
  Open();
  Seek(kBeginUs);
  ASSERT_TRUE(view_->Handle(PlayRequest{10.0}).ok());
  int64_t last_us = kBeginUs;
  bool is_playing = true;
  while (is_playing) {
    const ReceivedMessage position = reader_.ReadUntil("position");
    EXPECT_GE(position.header["t_us"], last_us);
    EXPECT_EQ(position.header["speed"], 10.0);
    last_us = position.header["t_us"];
    is_playing = position.header["playing"];
  }
  EXPECT_EQ(last_us, events_.back().t_us);
  reader_.ReadImage(last_us);
}

TEST_F(RecordingViewTest, APlayGoesOnWhileThePageDrawsNothing) {
  Open();
  reader_.set_acknowledges(false);
  ASSERT_TRUE(view_->Handle(SeekRequest{kBeginUs}).ok());
  ASSERT_TRUE(view_->Handle(PlayRequest{1.0}).ok());
  int num_images = 0;
  for (ReceivedMessage message; message.type() != "position" || message.header["t_us"] != events_.back().t_us;) {
    message = reader_.Read();
    num_images += message.type() == "image" ? 1 : 0;
  }
  EXPECT_LE(num_images, 2);
  reader_.outbox()->Acknowledge(2);
  reader_.ReadImage(events_.back().t_us);
}

TEST_F(RecordingViewTest, APauseStaysAtTheInstant) {
  Open();
  Seek(kBeginUs);
  ASSERT_TRUE(view_->Handle(PlayRequest{0.001}).ok());
  ASSERT_TRUE(view_->Handle(PauseRequest{}).ok());
  ReceivedMessage position = reader_.ReadUntil("position");
  while (position.header["playing"] == true) position = reader_.ReadUntil("position");
  const int64_t t_us = position.header["t_us"];
  EXPECT_GE(t_us, kBeginUs);
  EXPECT_LT(t_us, kEndUs);
  reader_.ReadImage(t_us);
  ASSERT_TRUE(view_->Handle(ImageSettings{20.0, 4, 30.0}).ok());
  EXPECT_EQ(reader_.ReadUntil("image").header["t_us"], t_us) << "other settings show the same instant again";
}

TEST_F(RecordingViewTest, OtherSettingsDoNotMoveAPlayBack) {
  Open();
  Seek(kBeginUs);
  ASSERT_TRUE(view_->Handle(PlayRequest{0.001}).ok());
  int64_t played_us = kBeginUs;
  while (played_us == kBeginUs) played_us = reader_.ReadUntil("image").header["t_us"];
  ASSERT_TRUE(view_->Handle(ImageSettings{10.0, 4, 30.0}).ok());
  ReceivedMessage image = reader_.ReadUntil("image");
  while (image.header["cell_px"] != 4) image = reader_.ReadUntil("image");
  EXPECT_GE(image.header["t_us"], played_us);
}

TEST_F(RecordingViewTest, RequestsForASessionAreRefused) {
  Open();
  EXPECT_EQ(view_->Handle(OpenRequest{"sessions/1"}).code(), absl::StatusCode::kInvalidArgument);
}

// A recording that continues only after the promise `gate` is fulfilled.
class GatedReader : public RecordingReader {
 public:
  GatedReader(std::vector<uint8_t> bytes, std::shared_ptr<std::promise<void>> gate)
      : bytes_(std::move(bytes)), gate_(std::move(gate)) {
    header_.encoding = Encoding::kEvt3;
    header_.geometry = kTestSensor;
    header_.container = "gated";
  }
  const RecordingHeader& header() const override { return header_; }
  int64_t data_size_bytes() const override { return -1; }
  absl::StatusOr<size_t> Read(absl::Span<uint8_t> buffer) override {
    if (position_ > 0 && position_ < 2 * buffer.size()) gate_->get_future().wait();
    const size_t size = std::min(buffer.size(), bytes_.size() - position_);
    std::copy_n(bytes_.begin() + static_cast<long>(position_), size, buffer.begin());
    position_ += size;
    return size;
  }

 private:
  RecordingHeader header_;
  const std::vector<uint8_t> bytes_;
  const std::shared_ptr<std::promise<void>> gate_;
  size_t position_ = 0;
};

TEST_F(RecordingViewTest, ASeekWaitsUntilTheRecordingHasBeenReadSoFar) {
  RecordingInputs inputs = Inputs(false);
  const auto gate = std::make_shared<std::promise<void>>();
  inputs.reader = std::make_unique<GatedReader>(Encoded(events_), gate);
  auto source = RecordingSource::Open(std::move(inputs));
  ASSERT_TRUE(source.ok()) << source.status();
  source_ = std::move(*source);
  view_ = source_->Open(reader_.outbox());
  ASSERT_TRUE(view_->Handle(SeekRequest{kBeginUs + 180'000}).ok());
  const ReceivedMessage range = reader_.ReadUntil("range");
  gate->set_value();
  const ReceivedMessage image = reader_.ReadImage(kBeginUs + 180'000);
  const auto is_inside = [&](const Event& event) {
    return event.t_us >= kBeginUs + 175'000 && event.t_us < kBeginUs + 185'000;
  };
  EXPECT_EQ(image.header["events"], std::count_if(events_.begin(), events_.end(), is_inside));
}

}  // namespace
}  // namespace evpose::client
