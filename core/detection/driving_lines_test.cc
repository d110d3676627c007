// SPDX-License-Identifier: Apache-2.0

// Detection in a recording of a street from a moving car: buildings, lamp posts, lane markings.
#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/baselines/first_pose/lsd_detector.h"
#include "core/detection/plane_detector.h"
#include "core/events/decoder.h"
#include "core/recordings/recording_reader.h"
#include "tests/data/test_data.h"

namespace evpose {
namespace {

std::vector<PixelEvent> ReadAll(const std::string& path, SensorGeometry& geometry) {
  auto reader = RecordingReader::Open(path).value();
  geometry = reader->header().geometry;
  auto decoder = MakeEventDecoder(reader->header().encoding, geometry).value();
  DecodedEvents decoded;
  std::vector<uint8_t> buffer(1 << 16);
  while (const size_t size = reader->Read(absl::MakeSpan(buffer)).value()) {
    decoder->Decode(absl::MakeConstSpan(buffer).subspan(0, size), decoded);
  }
  std::vector<PixelEvent> events;
  for (const Event& event : decoded.events) {
    events.push_back({event.t_us, static_cast<float>(event.x), static_cast<float>(event.y), event.polarity});
  }
  return events;
}

bool IsInside(const ImageSegment& segment, SensorGeometry geometry) {
  const double margin_px = 25.0;  // an end may move out of the image with its line
  for (const Eigen::Vector2d& p : {segment.p1_px, segment.p2_px}) {
    if (!(p.x() > -margin_px && p.x() < geometry.width_px + margin_px)) return false;
    if (!(p.y() > -margin_px && p.y() < geometry.height_px + margin_px)) return false;
  }
  return true;
}

TEST(DrivingLines, AreFoundInsideTheImageAndAlwaysTheSame) {
  const std::string path = FindTestData("evt3_driving_gen41/evt3_sample.raw");
  if (path.empty()) GTEST_SKIP() << "the recording is not in the test data";
  SensorGeometry geometry;
  const std::vector<PixelEvent> events = ReadAll(path, geometry);
  ASSERT_GT(events.size(), 100'000u);
  std::vector<std::unique_ptr<LineDetector>> detectors;
  detectors.push_back(MakePlaneLineDetector({}, geometry).value());
  detectors.push_back(MakeLsdLineDetector({}, geometry).value());
  for (const auto& detector : detectors) {
    size_t total = 0;
    for (int k = 1; k <= 8; ++k) {
      const size_t end = events.size() * k / 8, begin = end - std::min<size_t>(end, 200'000);
      const absl::Span<const PixelEvent> some = absl::MakeConstSpan(events).subspan(begin, end - begin);
      const LineDetection detection = detector->Detect(some), again = detector->Detect(some);
      total += detection.lines.size();
      ASSERT_EQ(detection.lines.size(), again.lines.size());
      for (size_t i = 0; i < detection.lines.size(); ++i) {
        const DetectedLine& line = detection.lines[i];
        EXPECT_TRUE(IsInside(line.at_begin, geometry) && IsInside(line.at_end, geometry));
        EXPECT_EQ(line.at_end.p1_px, again.lines[i].at_end.p1_px);
        EXPECT_EQ(line.at_begin.p2_px, again.lines[i].at_begin.p2_px);
        EXPECT_EQ(line.normal_velocity_px_per_s, again.lines[i].normal_velocity_px_per_s);
      }
    }
    EXPECT_GT(total, 8u * 7u);
  }
}

}  // namespace
}  // namespace evpose
