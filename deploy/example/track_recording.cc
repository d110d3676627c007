// SPDX-License-Identifier: Apache-2.0

// Sends a recording through a server and prints a line for each pose: sensor time, position.
//   track_recording RECORDING.raw MODEL.obj CAMERA.yaml HOST:PORT
#include <cstdlib>
#include <iostream>

#include "client/lib/client.h"
#include "core/base/output_file.h"
#include "core/events/recording_reader.h"
#include "core/geometry/camera.h"

template <typename Result>
auto Require(Result result) {
  if (result.ok()) return *std::move(result);
  std::cerr << "track_recording: " << result.status().message() << std::endl;
  std::exit(1);
}

int main(int argc, char** argv) {
  if (argc != 5) return std::cerr << "usage: track_recording RECORDING.raw MODEL.obj CAMERA.yaml HOST:PORT\n", 2;
  const auto reader = Require(evpose::RecordingReader::Open(argv[1]));
  const std::string obj = Require(evpose::ReadFile(argv[2], 64 << 20));
  const auto client = Require(evpose::client::Client::Connect(argv[4]));
  const auto model = Require(client->UploadModel({reinterpret_cast<const uint8_t*>(obj.data()), obj.size()}, {}));

  evpose::client::SessionConfig config;
  config.encoding = reader->header().encoding;
  config.camera = Require(evpose::LoadCameraModel(argv[3]));
  config.objects = {{.object_id = "object", .model = model.name}};
  const auto session = Require(client->CreateSession(config));

  evpose::Chunker chunker(*reader, {});
  evpose::client::TrackCallbacks callbacks;
  callbacks.on_pose = [](const evpose::client::Pose& pose) {
    std::cout << pose.estimate.t_us << " " << pose.estimate.camera_from_object.translation_m.transpose() << "\n";
  };
  const auto summary = Require(client->Track(
      session, [&chunker] { return chunker.Next(); }, callbacks));
  if (const auto deleted = client->DeleteSession(session.name); !deleted.ok()) std::cerr << deleted.message() << "\n";
  std::cerr << summary.poses << " poses\n";
}
