// SPDX-License-Identifier: Apache-2.0
#include "server/models/model_preparer.h"

#include <sys/stat.h>

#include <fstream>
#include <thread>

#include "core/base/sanitized.h"
#include "core/base/temporary_directory_testing.h"
#include "core/initialization/search_views.h"
#include "core/models/cube_files_testing.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "server/models/mesh_message.h"
#include "server/models/prepared_model.h"
#include "server/runtime/errors.h"

namespace evpose::server {
namespace {

using testing::HasSubstr;

std::vector<uint8_t> BytesOf(const std::string& text) { return {text.begin(), text.end()}; }

// The serialized model with the views that a session would compute.
std::string WithViews(const std::string& prepared) {
  const auto model = std::make_shared<const ObjectModel>(DecodePreparedModel(prepared).value());
  return prepared + EncodePreparedViews(MakeSearchViews(model));
}

class ChildPreparerTest : public testing::Test {
 protected:
  absl::StatusOr<std::string> Prepare(const std::string& program, const std::string& file,
                                      const PreparationBudget& budget = {}) {
    return MakeChildModelPreparer(program, budget)->Prepare(BytesOf(file), ModelFormat::kObj, {}, cancellation_);
  }
  // A program that behaves as evpose-prepare-model at its worst.
  std::string Script(const std::string& commands) {
    const std::string path = directory_.path() + "/script";
    std::ofstream(path) << "#!/bin/sh\n" << commands << "\n";
    chmod(path.c_str(), 0700);
    return path;
  }

  TemporaryDirectory directory_;
  Cancellation cancellation_;
};

TEST_F(ChildPreparerTest, MakesTheSameModelAsTheServerItself) {
  const auto in_process = MakeModelPreparer()->Prepare(BytesOf(Cube()), ModelFormat::kObj, {}, cancellation_);
  ASSERT_TRUE(in_process.ok());
  const auto by_child = Prepare(EVPOSE_PREPARE_MODEL, Cube());
  ASSERT_TRUE(by_child.ok()) << by_child.status();
  EXPECT_TRUE(*by_child == WithViews(*in_process));
}

TEST_F(ChildPreparerTest, PassesAllOptionsAndFormatsOn) {
  const ModelOptions options = {.metres_per_unit = 0.5, .crease_angle_deg = 12.5, .is_smooth = false};
  RawMesh mesh;
  mesh.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  mesh.triangles = {{0, 1, 2}};
  const std::vector<uint8_t> file = BytesOf(EncodeMesh(mesh));
  const auto in_process = MakeModelPreparer()->Prepare(file, ModelFormat::kMesh, options, cancellation_);
  ASSERT_TRUE(in_process.ok()) << in_process.status();
  const auto by_child =
      MakeChildModelPreparer(EVPOSE_PREPARE_MODEL, {})->Prepare(file, ModelFormat::kMesh, options, cancellation_);
  ASSERT_TRUE(by_child.ok()) << by_child.status();
  EXPECT_TRUE(*by_child == WithViews(*in_process));
}

TEST_F(ChildPreparerTest, RefusesAModelWhoseViewsExceedTheBudget) {
  const std::string model = "echo step finding symmetries; echo model 5; printf hello; ";
  for (const auto& [end, words] : {std::pair("kill -XCPU $$", "s of processor time while computing views"),
                                   {"printf views; kill -XCPU $$", "s of processor time while computing views"},
                                   {"printf view; exit 3", "bytes of memory while computing views"}}) {
    const absl::Status status = Prepare(Script(model + end), Cube()).status();
    EXPECT_EQ(GetErrorDetails(status).reason, "MODEL_TOO_EXPENSIVE") << end << ": " << status;
    EXPECT_THAT(std::string(status.message()), HasSubstr(words));
  }
  EXPECT_EQ(GetErrorDetails(Prepare(Script(model + "kill -KILL $$"), Cube()).status()).reason, "OUT_OF_MEMORY");
  EXPECT_EQ(Prepare(Script(model + "printf views"), Cube()).value(), "helloviews");
}

TEST_F(ChildPreparerTest, AnIncompleteModelIsNone) {
  for (const std::string model : {"echo model 6; printf hello", "echo model; printf hello", "printf 'model 5'"}) {
    EXPECT_EQ(GetErrorDetails(Prepare(Script(model + "; kill -XCPU $$"), Cube()).status()).reason,
              "MODEL_TOO_EXPENSIVE");
    EXPECT_TRUE(absl::IsInternal(Prepare(Script(model), Cube()).status())) << model;
  }
}

TEST_F(ChildPreparerTest, ReportsTheErrorOfAMalformedFile) {
  const absl::Status status = Prepare(EVPOSE_PREPARE_MODEL, "v 0 0 nan\n").status();
  const absl::Status expected =
      MakeModelPreparer()->Prepare(BytesOf("v 0 0 nan\n"), ModelFormat::kObj, {}, cancellation_).status();
  EXPECT_EQ(status, expected);
  EXPECT_TRUE(absl::IsInvalidArgument(status));
}

TEST_F(ChildPreparerTest, LargeFilesPassWhole) {
  const std::string comment = "#" + std::string(5u << 20, 'x') + "\n";
  const auto with_comment = Prepare(EVPOSE_PREPARE_MODEL, comment + Cube());
  ASSERT_TRUE(with_comment.ok()) << with_comment.status();
  EXPECT_TRUE(*with_comment == *Prepare(EVPOSE_PREPARE_MODEL, Cube()));
}

TEST_F(ChildPreparerTest, NamesTheStepThatExceedsTheBudget) {
  const std::string steps = "echo step reading the file; echo step finding symmetries; ";
  for (const auto& [end, words] :
       {std::pair("kill -XCPU $$", "more than 7 s of processor time while finding symmetries"),
        {"exit 3", "more than 1000 bytes of memory while finding symmetries"}}) {
    const absl::Status status = Prepare(Script(steps + end), Cube(), {.cpu_seconds = 7, .memory_bytes = 1000}).status();
    EXPECT_TRUE(absl::IsInvalidArgument(status)) << status;
    EXPECT_EQ(GetErrorDetails(status).reason, "MODEL_TOO_EXPENSIVE");
    EXPECT_THAT(std::string(status.message()), HasSubstr(words));
  }
}

// The kernel kills it when the machine has no memory left, whatever the model takes.
TEST_F(ChildPreparerTest, AKilledProcessIsNoErrorOfTheModel) {
  const absl::Status status = Prepare(Script("echo step welding points; kill -KILL $$"), Cube()).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(GetErrorDetails(status).reason, "OUT_OF_MEMORY");
}

TEST_F(ChildPreparerTest, ACrashIsNoErrorOfTheServer) {
  const absl::Status status = Prepare(Script("echo step welding points; kill -SEGV $$"), Cube()).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(status.message()), HasSubstr("welding points (signal 11)"));
  EXPECT_EQ(Prepare(directory_.path() + "/none", Cube()).status().code(), absl::StatusCode::kInternal);
}

#ifndef EVPOSE_SANITIZED
TEST_F(ChildPreparerTest, TheMemoryIsBounded) {
  std::string file;
  for (int i = 0; i < 3'000'000; ++i) file += "v 0 0 0\n";
  const absl::Status status = Prepare(EVPOSE_PREPARE_MODEL, file, {.memory_bytes = 96u << 20}).status();
  EXPECT_EQ(GetErrorDetails(status).reason, "MODEL_TOO_EXPENSIVE") << status;
}
#endif

// Without the cancellation, the process would end after an hour.
TEST_F(ChildPreparerTest, IsKilledWhenTheCallIsCancelled) {
  absl::Status status;
  std::thread call([&] { status = Prepare(Script("exec /bin/sleep 3600"), Cube()).status(); });
  cancellation_.Cancel();
  call.join();
  EXPECT_TRUE(absl::IsCancelled(status));
}

}  // namespace
}  // namespace evpose::server
