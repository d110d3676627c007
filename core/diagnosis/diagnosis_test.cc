// SPDX-License-Identifier: Apache-2.0

// Each check with events that have the defect and with events that have not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "core/diagnosis/object_checks.h"
#include "core/diagnosis/recording_diagnosis.h"
#include "core/numerics/random.h"
#include "core/simulation/simulator.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;

// A cube before a camera of 320x240 pixels, for 0.6 s.
SimulationOptions Scene() {
  SimulationOptions options = *SimulationPreset("cube", "vga");
  CameraModel camera = options.camera;
  camera.width_px = 320, camera.height_px = 240;
  camera.fx_px /= 2.0, camera.fy_px /= 2.0, camera.cx_px = 159.5, camera.cy_px = 119.5;
  UseCamera(camera, options);
  options.duration_us = 600'000;
  return options;
}

std::vector<Event> EventsOf(const SimulationOptions& options) {
  std::vector<Event> events;
  const auto report = Simulate(options, [&events](absl::Span<const Event> batch) {
    events.insert(events.end(), batch.begin(), batch.end());
    return absl::OkStatus();
  });
  EXPECT_TRUE(report.ok()) << report.status();
  return events;
}

const std::vector<Event>& CleanEvents() {
  static const std::vector<Event> events = EventsOf(Scene());
  return events;
}

std::vector<Finding> Diagnose(const std::vector<Event>& events, SensorGeometry geometry = {320, 240}) {
  absl::StatusOr<RecordingDiagnosis> diagnosis = RecordingDiagnosis::Make(geometry);
  EXPECT_TRUE(diagnosis.ok()) << diagnosis.status();
  // The events are added in pieces, because the result must not depend on the cuts.
  for (size_t begin = 0; begin < events.size(); begin += 777) {
    diagnosis->Add({events.data() + begin, std::min<size_t>(777, events.size() - begin)});
  }
  StreamFacts facts;
  facts.counts.cd_events = events.size();
  facts.data_bytes = 8 * events.size();
  return diagnosis->Findings(facts);
}

Finding Find(const std::vector<Finding>& findings, const std::string& check) {
  for (const Finding& finding : findings) {
    if (finding.check == check) return finding;
  }
  ADD_FAILURE() << "there is no check " << check;
  return {};
}

TEST(DiagnosisTest, CleanRecordingHasNoFinding) {
  for (const Finding& finding : Diagnose(CleanEvents())) {
    const bool is_undecided = finding.check == "dead-pixels";  // most of the image is at rest
    EXPECT_EQ(finding.verdict, is_undecided ? Verdict::kNotChecked : Verdict::kOk)
        << finding.check << ": " << finding.text;
    EXPECT_EQ(finding.remedy, "") << finding.check;
  }
}

TEST(DiagnosisTest, ResultDoesNotDependOnTheCuts) {
  absl::StatusOr<RecordingDiagnosis> whole = RecordingDiagnosis::Make({320, 240});
  ASSERT_TRUE(whole.ok());
  whole->Add(CleanEvents());
  const std::vector<Finding> expected = whole->Findings({});
  const std::vector<Finding> findings = Diagnose(CleanEvents());
  for (size_t i = 1; i < findings.size(); ++i) {
    EXPECT_EQ(findings[i].value, expected[i].value) << findings[i].check;
  }
}

TEST(DiagnosisTest, HotPixelsAreListedWithTheWorstFirst) {
  std::vector<Event> events = CleanEvents();
  const int64_t begin_us = events.front().t_us;
  for (int i = 0; i < 9000; ++i) events.push_back({begin_us + int64_t{60} * i, 5, 7, 1});
  for (int i = 0; i < 3000; ++i) events.push_back({begin_us + int64_t{180} * i, 300, 200, 1});
  std::stable_sort(events.begin(), events.end(), [](const Event& a, const Event& b) { return a.t_us < b.t_us; });
  const Finding finding = Find(Diagnose(events), "hot-pixels");
  EXPECT_GE(finding.verdict, Verdict::kAdvice);
  ASSERT_GE(finding.places.size(), 2u);
  EXPECT_THAT(finding.places[0], HasSubstr("pixel (5, 7)"));
  EXPECT_THAT(finding.places[1], HasSubstr("pixel (300, 200)"));
  EXPECT_THAT(finding.remedy, HasSubstr("mask"));
}

TEST(DiagnosisTest, NoiseShareIsThatOfTheSimulation) {
  SimulationOptions options = Scene();
  options.sensor.shot_noise_hz = 30.0;
  uint64_t noise = 0, all = 0;
  std::vector<Event> events;
  const auto report = Simulate(options, [&events](absl::Span<const Event> batch) {
    events.insert(events.end(), batch.begin(), batch.end());
    return absl::OkStatus();
  });
  ASSERT_TRUE(report.ok());
  noise = report->noise_events, all = report->events;
  const Finding finding = Find(Diagnose(events), "noise");
  EXPECT_EQ(finding.verdict, Verdict::kProblem) << finding.text;
  EXPECT_NEAR(*finding.value, static_cast<double>(noise) / static_cast<double>(all), 0.05);
}

TEST(DiagnosisTest, FlickerIsFoundWithItsFrequency) {
  SimulationOptions options = Scene();
  options.scene.light.flicker_depth = 0.3;
  const Finding finding = Find(Diagnose(EventsOf(options)), "flicker");
  EXPECT_EQ(finding.verdict, Verdict::kProblem) << finding.text;
  EXPECT_THAT(finding.text, ::testing::AnyOf(HasSubstr("99.9 Hz"), HasSubstr("100.0 Hz"), HasSubstr("100.1 Hz")));
  EXPECT_THAT(finding.remedy, HasSubstr("anti-flicker"));
}

// A machine that vibrates in one part of the image is no flicker of the light.
TEST(DiagnosisTest, VibrationInOnePlaceIsNoFlicker) {
  std::vector<Event> events = CleanEvents();
  const int64_t begin_us = events.front().t_us;
  Random random(1);
  for (int64_t t_us = 0; t_us < 600'000; t_us += 20) {
    const bool is_on = t_us % 10'000 < 5000;
    events.push_back({begin_us + t_us, static_cast<uint16_t>(20 + random.Uniform() * 8),
                      static_cast<uint16_t>(20 + random.Uniform() * 8), static_cast<uint8_t>(is_on)});
  }
  std::stable_sort(events.begin(), events.end(), [](const Event& a, const Event& b) { return a.t_us < b.t_us; });
  EXPECT_EQ(Find(Diagnose(events), "flicker").verdict, Verdict::kOk);
}

TEST(DiagnosisTest, BlurIsMeasured) {
  for (const auto& [blur_px, verdict] :
       {std::pair(0.5, Verdict::kOk), {1.0, Verdict::kAdvice}, {2.0, Verdict::kProblem}}) {
    SimulationOptions options = Scene();
    options.scene.lens_blur_px = blur_px;
    const Finding finding = Find(Diagnose(EventsOf(options)), "focus");
    EXPECT_EQ(finding.verdict, verdict) << finding.text;
    EXPECT_NEAR(finding.value.value_or(0.0), blur_px, 0.2 * blur_px + 0.1);
  }
}

TEST(DiagnosisTest, UnequalThresholdsAreFound) {
  SimulationOptions options = Scene();
  options.sensor.threshold_on = 0.15;
  options.sensor.threshold_off = 0.75;
  const Finding finding = Find(Diagnose(EventsOf(options)), "polarity");
  EXPECT_GE(finding.verdict, Verdict::kAdvice) << finding.text;
  EXPECT_THAT(finding.remedy, HasSubstr("raise bias_diff_on"));
}

TEST(DiagnosisTest, RestIsTooLittleMotion) {
  absl::StatusOr<SimulationOptions> rest = SimulationPreset("cube", "vga", 0.0);
  ASSERT_TRUE(rest.ok());
  rest->duration_us = 300'000;
  const std::vector<Finding> findings = Diagnose(EventsOf(*rest), {640, 480});
  EXPECT_EQ(Find(findings, "event-rate").verdict, Verdict::kProblem);
  EXPECT_EQ(Find(findings, "noise").verdict, Verdict::kNotChecked);
}

TEST(DiagnosisTest, GapsAreFound) {
  std::vector<Event> events = CleanEvents();
  const int64_t begin_us = events.front().t_us + 300'000;
  std::erase_if(events, [begin_us](const Event& e) { return e.t_us >= begin_us && e.t_us < begin_us + 50'000; });
  const Finding finding = Find(Diagnose(events), "clock");
  EXPECT_EQ(finding.verdict, Verdict::kProblem);
  ASSERT_EQ(finding.places.size(), 1u);
  EXPECT_THAT(finding.places[0], HasSubstr("no events for 50."));
}

TEST(DiagnosisTest, OverflowOfTheClockIsNamed) {
  std::vector<Event> events = CleanEvents();
  const int64_t middle_us = events.front().t_us + 300'000;
  for (Event& event : events) event.t_us += event.t_us >= middle_us ? int64_t{1} << 24 : 0;
  const Finding finding = Find(Diagnose(events), "clock");
  EXPECT_EQ(finding.verdict, Verdict::kProblem);
  EXPECT_THAT(finding.places.at(0), HasSubstr("overflow of a clock of 24 bits"));
}

TEST(DiagnosisTest, StepsBackAreFound) {
  std::vector<Event> events = CleanEvents();
  const int64_t middle_us = events.front().t_us + 300'000;
  for (Event& event : events) event.t_us -= event.t_us >= middle_us ? 100'000 : 0;
  const Finding finding = Find(Diagnose(events), "clock");
  EXPECT_EQ(finding.verdict, Verdict::kProblem);
  EXPECT_NEAR(*finding.value, 100'000, 1000);
}

TEST(DiagnosisTest, RoundedTimesAreFound) {
  for (const auto& [step_us, verdict] :
       {std::pair(50, Verdict::kOk), {500, Verdict::kAdvice}, {2000, Verdict::kProblem}}) {
    std::vector<Event> events = CleanEvents();
    for (Event& event : events) event.t_us -= event.t_us % step_us;
    const Finding finding = Find(Diagnose(events), "time-step");
    EXPECT_EQ(finding.verdict, verdict) << step_us;
    EXPECT_EQ(finding.value, step_us);
  }
}

TEST(DiagnosisTest, AreaWithoutEventsIsFound) {
  constexpr SensorGeometry kSensor = {160, 120};
  std::vector<Event> events;
  Random random(1);
  for (int i = 0; i < 30 * 160 * 120; ++i) {
    events.push_back({i, static_cast<uint16_t>(160.0 * random.Uniform()),
                      static_cast<uint16_t>(120.0 * random.Uniform()), static_cast<uint8_t>(i % 2)});
  }
  EXPECT_EQ(Find(Diagnose(events, kSensor), "dead-pixels").verdict, Verdict::kOk);
  std::erase_if(events, [](const Event& e) { return e.x >= 40 && e.x < 60 && e.y >= 30 && e.y < 50; });
  const Finding finding = Find(Diagnose(events, kSensor), "dead-pixels");
  EXPECT_EQ(finding.verdict, Verdict::kAdvice) << finding.text;
  ASSERT_EQ(finding.places.size(), 1u);
  EXPECT_THAT(finding.places[0], HasSubstr("columns 40 to 59, rows 30 to 49: 400 pixels"));
}

TEST(DiagnosisTest, AreasWithoutEventsAreUsualIfFewPixelsHaveAny) {
  const Finding finding = Find(Diagnose(CleanEvents()), "dead-pixels");
  EXPECT_EQ(finding.verdict, Verdict::kNotChecked);
  EXPECT_THAT(finding.text, HasSubstr("a moving pattern that fills the image"));
}

TEST(DiagnosisTest, FewEventsAreNotJudged) {
  const std::vector<Finding> findings = Diagnose({});
  EXPECT_EQ(Find(findings, "decoding").verdict, Verdict::kProblem);
  for (size_t i = 1; i < findings.size(); ++i) EXPECT_EQ(findings[i].verdict, Verdict::kNotChecked);
}

TEST(DiagnosisTest, InvalidWordsAreReported) {
  absl::StatusOr<RecordingDiagnosis> diagnosis = RecordingDiagnosis::Make({320, 240});
  ASSERT_TRUE(diagnosis.ok());
  StreamFacts facts;
  facts.counts.cd_events = 10'000;
  facts.data_bytes = 80'000;
  EXPECT_EQ(diagnosis->Findings(facts)[0].verdict, Verdict::kOk);
  facts.counts.unknown_words = 100;
  EXPECT_EQ(diagnosis->Findings(facts)[0].verdict, Verdict::kProblem);
  facts.counts.unknown_words = 0;
  // What a reader left out counts by what was lost with it.
  const auto verdict_of = [&](uint64_t count, SkippedParts::Loss loss) {
    facts.skipped = {{"parts", count, loss}};
    return diagnosis->Findings(facts)[0].verdict;
  };
  EXPECT_EQ(verdict_of(1000, SkippedParts::Loss::kNone), Verdict::kOk);
  EXPECT_EQ(verdict_of(1, SkippedParts::Loss::kEvents), Verdict::kAdvice);
  EXPECT_EQ(verdict_of(100, SkippedParts::Loss::kEvents), Verdict::kProblem);
  EXPECT_EQ(verdict_of(1, SkippedParts::Loss::kPieces), Verdict::kAdvice);
  EXPECT_EQ(diagnosis->Findings(facts)[0].places, std::vector<std::string>{"left out: 1 parts"});
  EXPECT_THAT(diagnosis->Findings(facts)[0].remedy, ::testing::HasSubstr("copy the file again"));
}

TEST(DiagnosisTest, EventsOutsideTheSensorAreLeftOut) {
  absl::StatusOr<RecordingDiagnosis> diagnosis = RecordingDiagnosis::Make({10, 10});
  ASSERT_TRUE(diagnosis.ok());
  diagnosis->Add(std::vector<Event>{{1, 10, 0, 1}, {2, 0, 10, 1}, {3, 9, 9, 1}});
  EXPECT_EQ(diagnosis->num_events(), 1u);
}

TEST(DiagnosisTest, OptionsAndSizesAreChecked) {
  EXPECT_THAT(RecordingDiagnosis::Make({100'000, 100'000}).status().message(), HasSubstr("at most 8000000 pixels"));
  EXPECT_FALSE(RecordingDiagnosis::Make({0, 10}).ok());
  DiagnosisOptions options;
  options.noise_share = {0.9, 0.5};
  EXPECT_THAT(options.Validate().message(), HasSubstr("noise_share"));
}

TEST(ObjectChecksTest, ModelInMillimetresIsRecognised) {
  const CameraModel camera = SimulationOptions::SimulatedVgaCamera();
  EXPECT_EQ(CheckScale(0.3, 1.0, camera, 150.0, {}).verdict, Verdict::kOk);
  const Finding finding = CheckScale(300.0, 1.0, camera, 150.0, {});
  EXPECT_EQ(finding.verdict, Verdict::kProblem);
  EXPECT_THAT(finding.remedy, HasSubstr("millimetres: --scale 0.001"));
  // A scale that was given already is a factor of the proposal.
  EXPECT_THAT(CheckScale(0.0003, 0.001, camera, 150.0, {}).remedy, HasSubstr("--scale 1"));
  EXPECT_EQ(CheckScale(8.0, 1.0, camera, 0.0, {}).verdict, Verdict::kAdvice);
}

TEST(ObjectChecksTest, CameraOfAnotherSizeIsFound) {
  const CameraModel camera = SimulationOptions::SimulatedVgaCamera();
  RecordingHeader header;
  header.geometry = {640, 480};
  header.geometry_is_known = true;
  EXPECT_EQ(CheckCamera(camera, header, {}, {}).verdict, Verdict::kOk);
  header.geometry = {1280, 720};
  const Finding finding = CheckCamera(camera, header, {}, {});
  EXPECT_EQ(finding.verdict, Verdict::kProblem);
  EXPECT_THAT(finding.text, HasSubstr("the camera has 640x480 pixels, the recording 1280x720"));
  header.geometry_is_known = false;
  EXPECT_EQ(CheckCamera(camera, header, {0, 0, 239, 179}, {}).verdict, Verdict::kAdvice);
  EXPECT_EQ(CheckCamera(camera, header, {0, 0, 639, 479}, {}).verdict, Verdict::kOk);
}

TEST(ObjectChecksTest, SmallObjectIsFound) {
  EXPECT_EQ(CheckObjectSize(200.0).verdict, Verdict::kOk);
  EXPECT_EQ(CheckObjectSize(30.0).verdict, Verdict::kAdvice);
  EXPECT_EQ(CheckObjectSize(0.0).verdict, Verdict::kNotChecked);
}

}  // namespace
}  // namespace evpose
