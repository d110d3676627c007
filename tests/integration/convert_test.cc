// SPDX-License-Identifier: Apache-2.0

// Tests evpose convert, and the other commands on recordings in the formats of other programs.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "client/cli/cli.h"
#include "client/containers/containers_testing.h"
#include "client/containers/hdf5_source.h"
#include "core/base/environment_testing.h"
#include "tests/data/test_data.h"
#include "tests/integration/cli_fixture.h"

namespace evpose {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class ConvertTest : public CliTest {
 protected:
  nlohmann::json Info(const std::string& path) const {
    const CliResult result = Run({"info", path, "--json"});
    EXPECT_EQ(result.status, 0) << result.err;
    return result.status == 0 ? result.Json() : nlohmann::json();
  }
};

// The times of the poses in a TUM file, seconds.
std::vector<double> TimesOf(const std::string& tum) {
  std::vector<double> times;
  std::istringstream lines(tum);
  for (std::string line; std::getline(lines, line);) {
    if (!line.empty() && line[0] != '#') times.push_back(std::stod(line));
  }
  return times;
}

TEST_F(ConvertTest, TheDigestIsTheSameThereAndBack) {
  SimulateCube(0.05);
  const nlohmann::json original = Info(Path("cube/recording.raw"));
  std::string from = Path("cube/recording.raw");
  for (const char* name : {"a.csv", "b.dat", "c.raw", "d.dat", "e.csv"}) {
    const CliResult result = Run({"convert", from, Path(name), "--json"});
    ASSERT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(result.Json()["sha256"], original["sha256"]);
    from = Path(name);
    const nlohmann::json info = Info(from);
    EXPECT_EQ(info["sha256"], original["sha256"]) << name;
    EXPECT_EQ(info["width"], 640);
    EXPECT_EQ(info["height"], 480);
    EXPECT_EQ(info["cd_events"], original["cd_events"]);
  }
}

#ifdef EVPOSE_HDF5_PROGRAM
// The first event of this file, which h5py has written, is at 0.005 s, and its attribute time_shift is the same time.
TEST_F(ConvertTest, InfoAndReplayKnowTheZeroThatMetavisionTakesFromAnHdf5File) {
  const ScopedEnvironmentVariable programs(
      "PATH", std::filesystem::path(EVPOSE_HDF5_PROGRAM).parent_path().string() + ":" + std::getenv("PATH"));
  const std::string shifted = FindTestData("containers/metavision_time_shift.hdf5");
  EXPECT_EQ(Info(shifted)["t_first_us"], 5000);
  EXPECT_EQ(Info(shifted)["metavision_zero_us"], 5000);
  EXPECT_EQ(Info(shifted)["t_first_metavision_us"], 0);
  EXPECT_THAT(
      Run({"info", shifted}).out,
      HasSubstr("zero       times count from the zero of the file; Metavision's zero is at 0.005000 s, its first "
                "event at 0.000000 s\n"));
  EXPECT_THAT(Run({"info", FindTestData("containers/metavision_ecf.hdf5")}).out, Not(HasSubstr("\nzero ")));

  // Converting from HDF5 to HDF5 keeps both zeros.
  ASSERT_EQ(Run({"convert", shifted, Path("shifted.hdf5")}).status, 0);
  EXPECT_EQ(Info(Path("shifted.hdf5"))["metavision_zero_us"], 5000);
  SimulateCube(0.1);
  constexpr int64_t kZeroUs = 15'990'000;
  const client::ReadRecording raw = client::ReadAll(Path("cube/recording.raw")).value();
  const auto file = client::Hdf5Output::Create(Path("a.hdf5"), {raw.header.geometry, 0, kZeroUs}).value();
  ASSERT_TRUE(file->Write(absl::MakeConstSpan(raw.events)).ok());
  ASSERT_TRUE(file->Close().ok());
  std::vector<std::string> arguments = ReplayArguments("sensor.tum");
  std::replace(arguments.begin(), arguments.end(), Path("cube/recording.raw"), Path("a.hdf5"));
  ASSERT_EQ(Run(arguments).status, 0);
  std::replace(arguments.begin(), arguments.end(), Path("sensor.tum"), Path("metavision.tum"));
  arguments.insert(arguments.end(), {"--time-zero", "metavision"});
  ASSERT_EQ(Run(arguments).status, 0);
  const std::vector<double> sensor = TimesOf(ReadText("sensor.tum"));
  const std::vector<double> metavision = TimesOf(ReadText("metavision.tum"));
  ASSERT_THAT(sensor, Not(IsEmpty()));
  ASSERT_EQ(sensor.size(), metavision.size());
  EXPECT_EQ(std::llround((sensor[0] - metavision[0]) * 1e6), kZeroUs);
}

// The interrupt of a terminal reaches this process and evpose-hdf5, which still has to send most of the recording.
TEST_F(ConvertTest, AnInterruptWhileHdf5IsReadIsReportedAsSuch) {
  SimulateCube(0.5);
  const ScopedEnvironmentVariable programs(
      "PATH", std::filesystem::path(EVPOSE_HDF5_PROGRAM).parent_path().string() + ":" + std::getenv("PATH"));
  ASSERT_EQ(Run({"convert", Path("cube/recording.raw"), Path("a.hdf5")}).status, 0);
  const pid_t group = getpgrp();
  setpgid(0, 0);
  const auto before = std::signal(SIGINT, [](int) {});
  int num_questions = 0;
  std::ostringstream out, err;
  client::CliContext context{out, err};
  context.is_interrupted = [&num_questions] {
    if (num_questions++ == 0) kill(0, SIGINT);
    return num_questions > 2;  // until then more events are read, which the program must still send
  };
  const int status = client::RunCli({"convert", Path("a.hdf5"), Path("b.csv")}, context);
  std::signal(SIGINT, before);
  setpgid(0, group);
  EXPECT_EQ(status, 1);
  EXPECT_THAT(err.str(), HasSubstr("interrupted: nothing was written"));
  EXPECT_THAT(err.str(), Not(HasSubstr("damaged")));
  EXPECT_TRUE(FilesBeginning("b.csv").empty());
}
#endif

TEST_F(ConvertTest, APipeWithANameIsReadOnce) {
  SimulateCube(0.05);
  for (const char* const format : {"raw", "csv"}) {
    const std::string from = std::string("from.") + format;
    ASSERT_EQ(Run({"convert", Path("cube/recording.raw"), Path(from)}).status, 0);
    const CliResult result = RunShell("rm -f pipe\nmkfifo pipe\ncat " + from +
                                      " >pipe &\nevpose convert pipe out.raw --size 640x480 --json\nwait\n");
    ASSERT_EQ(result.status, 0) << result.err;
    EXPECT_EQ(result.Json()["sha256"], Info(Path("cube/recording.raw"))["sha256"]);
    EXPECT_EQ(Info(Path("out.raw"))["sha256"], result.Json()["sha256"]);
  }
  // A text states no size, which a second reading would find.
  WriteText("a.csv", "1,1,0,5000000\n");
  const CliResult unknown = RunShell("cat a.csv >pipe &\nevpose convert pipe out2.raw\n");
  EXPECT_EQ(unknown.status, 1);
  EXPECT_EQ(unknown.err, "evpose convert: pipe: states no size of the sensor: give it with --size\n");
  EXPECT_THAT(FilesBeginning("out2"), IsEmpty());
}

TEST_F(ConvertTest, APartBeginsAfterTheFirstEvent) {
  WriteText("a.csv", "%geometry:640,480\n1,1,0,5000000\n1,1,0,5100000\n1,1,0,5199999\n1,1,0,5200000\n");
  ASSERT_EQ(Run({"convert", Path("a.csv"), Path("b"), "--to", "csv", "--start", "0.1", "--duration", "0.1"}).status, 0);
  EXPECT_EQ(ReadText("b"), "%geometry:640,480\n1,1,0,5100000\n1,1,0,5199999\n");
  const CliResult none = Run({"convert", Path("a.csv"), Path("c.csv"), "--start", "9"});
  EXPECT_EQ(none.status, 1);
  EXPECT_THAT(none.err, HasSubstr("has no event between --start and --start + --duration"));
  EXPECT_THAT(FilesBeginning("c"), IsEmpty());
}

TEST_F(ConvertTest, WhatTheFormatCannotHoldIsAnErrorAndWritesNothing) {
  WriteText("back.csv", "%geometry:640,480\n1,1,0,5000000\n1,1,0,4999999\n");
  WriteText("outside.csv", "%geometry:640,480\n1,1,0,5000000\n640,1,0,5000001\n");
  for (const char* name : {"back.csv", "outside.csv"}) {
    const CliResult result = Run({"convert", Path(name), Path("out.raw")});
    EXPECT_EQ(result.status, 1);
    EXPECT_THAT(result.err, HasSubstr("RAW EVT3 cannot store these events: "));
    EXPECT_THAT(FilesBeginning("out."), IsEmpty());
  }
  const CliResult dropped = Run({"convert", Path("outside.csv"), Path("out.raw"), "--drop-outside"});
  EXPECT_EQ(dropped.status, 0) << dropped.err;
  EXPECT_THAT(dropped.err, HasSubstr("left out: 1 events without time or outside the sensor"));
  EXPECT_EQ(Info(Path("out.raw"))["cd_events"], 1);
  EXPECT_EQ(Run({"convert", Path("back.csv"), Path("back.dat")}).status, 0);
}

TEST_F(ConvertTest, WrongUseIsReported) {
  WriteText("a.csv", "%geometry:640,480\n1,1,0,5000000\n");
  const auto error = [this](const std::vector<std::string>& more, int status) {
    std::vector<std::string> arguments = {"convert", Path("a.csv")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const CliResult result = Run(arguments);
    EXPECT_EQ(result.status, status) << result.err;
    return result.err;
  };
  EXPECT_THAT(error({Path("a.png")}, 2), HasSubstr("its name ends with none of .raw, .dat, .csv"));
  EXPECT_THAT(error({"-", "--to", "csv"}, 2), HasSubstr("is not written to standard output"));
  EXPECT_THAT(error({Path("b.raw"), "--size", "640"}, 2), HasSubstr("is not WIDTHxHEIGHT"));
  for (const char* option : {"--start", "--duration"}) {
    EXPECT_THAT(error({Path("b.raw"), option, "1e300"}, 2), HasSubstr(option));
  }
  EXPECT_THAT(error({Path("b.raw"), "--size", "320x240"}, 1), HasSubstr("is of 640x480 pixels, but --size is 320x240"));
  const CliResult pipe = RunShell("printf '1,1,0,5000000\\n1,1,0,5000001\\n' | evpose convert - b.raw");
  EXPECT_EQ(pipe.status, 1);
  EXPECT_THAT(pipe.err, HasSubstr("states no size of the sensor: give it with --size"));
  EXPECT_EQ(RunShell("tail -n 1 a.csv | evpose convert - c.raw --size 640x480").status, 0);
}

TEST_F(ConvertTest, InfoDescribesAFileOfAnotherProgram) {
  const std::string bag = FindTestData("containers/packets.mcap");
  EXPECT_EQ(Info(bag)["format"], "rosbag2 MCAP");
  EXPECT_EQ(Info(bag)["encoding"], "EVT3");
  WriteText("a.txt", "0.5 10 20 1\n0.6 300 21 0\nno event\n0.7 11 21 0\n");
  EXPECT_EQ(Info(Path("a.txt"))["width"], 304);
  EXPECT_EQ(Info(Path("a.txt"))["geometry_is_stated"], false);
  EXPECT_EQ(Info(Path("a.txt"))["skipped"][0]["count"], 1);
  const CliResult text = Run({"info", Path("a.txt")});
  EXPECT_THAT(text.out, HasSubstr("304x240 (not stated: the smallest known sensor that contains all events)"));
  EXPECT_THAT(text.out, HasSubstr("left out   1 lines that are not events"));
  const std::string arrays = FindTestData("containers/event_arrays.db3");
  EXPECT_EQ(Info(arrays)["time_offset_us"], 1700000000005000);
  EXPECT_EQ(Info(arrays)["t_first_us"], 0);
  ASSERT_EQ(Run({"convert", arrays, Path("b.raw")}).status, 0);
  EXPECT_EQ(Info(Path("b.raw"))["time_offset_us"], 1700000000005000);
  EXPECT_EQ(Info(Path("b.raw"))["sha256"], Info(arrays)["sha256"]);
}

TEST_F(ConvertTest, AFormatWithoutTriggersIsAnErrorUnlessTheyAreDropped) {
  SimulateCube(0.05);
  const std::string recording = Path("cube/recording.raw");
  // A rising and a falling edge on input 1, after the last event: EXT_TRIGGER of EVT3.
  std::ofstream(recording, std::ios::binary | std::ios::app) << "\x01\xa1" << '\0' << "\xa1";
  for (const char* name : {"a.csv", "a.dat"}) {
    const CliResult refused = Run({"convert", recording, Path(name)});
    EXPECT_EQ(refused.status, 1);
    EXPECT_THAT(refused.err, HasSubstr("cannot store external triggers, such as the one at 16."));
    EXPECT_FALSE(std::filesystem::exists(Path(name)));
  }
  const CliResult dropped = Run({"convert", recording, Path("a.csv"), "--drop-triggers", "--json"});
  ASSERT_EQ(dropped.status, 0) << dropped.err;
  EXPECT_EQ(dropped.Json()["triggers_left_out"], 2);
  EXPECT_EQ(Info(Path("a.csv"))["sha256"], Info(recording)["sha256"]);
  EXPECT_EQ(Run({"convert", recording, Path("a.raw")}).status, 0);
}

TEST_F(ConvertTest, ASizeThatIsAGuessIsReported) {
  WriteText("a.txt", "0.5 10 20 1\n0.6 300 21 0\n");
  const CliResult guessed = Run({"convert", Path("a.txt"), Path("a.raw"), "--json"});
  ASSERT_EQ(guessed.status, 0) << guessed.err;
  EXPECT_EQ(guessed.Json()["geometry_is_stated"], false);
  EXPECT_THAT(guessed.err, HasSubstr("does not state the size of its sensor; 304x240 is a guess"));
  const CliResult given = Run({"convert", Path("a.txt"), Path("b.raw"), "--size", "320x240", "--json"});
  ASSERT_EQ(given.status, 0) << given.err;
  EXPECT_EQ(given.Json()["geometry_is_stated"], true);
  EXPECT_THAT(given.err, IsEmpty());
}

TEST_F(ConvertTest, ReplayReadsContainersAndCountsFromEitherZero) {
  SimulateCube(0.1);
  const nlohmann::json info = Info(Path("cube/recording.raw"));
  ASSERT_GT(info["metavision_zero_us"], 0);
  EXPECT_EQ(info["t_first_metavision_us"].get<int64_t>(),
            info["t_first_us"].get<int64_t>() - info["metavision_zero_us"].get<int64_t>());
  ASSERT_EQ(Run(ReplayArguments("sensor.tum")).status, 0);
  ASSERT_EQ(Run(ReplayArguments("metavision.tum", {"--time-zero", "metavision"})).status, 0);
  const std::vector<double> sensor = TimesOf(ReadText("sensor.tum"));
  const std::vector<double> metavision = TimesOf(ReadText("metavision.tum"));
  ASSERT_THAT(sensor, Not(IsEmpty()));
  ASSERT_EQ(sensor.size(), metavision.size());
  for (size_t i = 0; i < sensor.size(); ++i) {
    EXPECT_EQ(std::llround((sensor[i] - metavision[i]) * 1e6), info["metavision_zero_us"].get<int64_t>());
  }
  // The times of losses, too: the events contradict this pose.
  const auto lost_at_us = [this](const std::string& zero) {
    const std::string out = zero + ".jsonl";
    EXPECT_EQ(Run(ReplayArguments(out, {"--time-zero", zero, "--reset-pose", "16050000 0.05 0.05 0.6 0 0 0 1"})).status,
              0);
    const std::string lines = ReadText(out);
    const size_t last = lines.rfind('\n', lines.size() - 2);
    return nlohmann::json::parse(lines.substr(last + 1))["lost_at_us"].get<int64_t>();
  };
  EXPECT_EQ(lost_at_us("sensor") - lost_at_us("metavision"), info["metavision_zero_us"].get<int64_t>());

  ASSERT_EQ(Run({"convert", Path("cube/recording.raw"), Path("a.csv")}).status, 0);
  std::string text = ReadText("a.csv");
  WriteText("b.csv", text.substr(text.find('\n') + 1) + "damaged\n");  // without the line of the size
  std::vector<std::string> arguments = ReplayArguments("text.tum");
  std::replace(arguments.begin(), arguments.end(), Path("cube/recording.raw"), Path("b.csv"));
  const CliResult replay = Run(arguments);
  ASSERT_EQ(replay.status, 0) << replay.err;
  EXPECT_EQ(replay.Json()["events"], info["cd_events"]);
  EXPECT_EQ(replay.Json()["skipped"][0]["count"], 1);
  EXPECT_NEAR(static_cast<double>(TimesOf(ReadText("text.tum")).size()), static_cast<double>(sensor.size()), 2.0);
}

}  // namespace
}  // namespace evpose
