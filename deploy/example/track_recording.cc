// SPDX-License-Identifier: Apache-2.0

// Sends a recording through a server and prints a line for each pose: sensor time in microseconds, position in metres,
// state. An AMBIGUOUS pose is one of several that are compatible with the events.
//   track_recording RECORDING.raw MODEL.obj CAMERA.yaml HOST:PORT
#include <cstdlib>
#include <iostream>

#include "evpose/client.h"
#include "evpose/recording.h"

template <typename Result>
auto Require(Result result) {
  if (result.ok()) return *std::move(result);
  std::cerr << "track_recording: " << result.status().message() << std::endl;
  std::exit(1);
}

int main(int argc, char** argv) {
  if (argc != 5) return std::cerr << "usage: track_recording RECORDING.raw MODEL.obj CAMERA.yaml HOST:PORT\n", 2;
  namespace client = evpose::client;
  const auto recording = Require(client::Recording::Open(argv[1]));
  const auto connection = Require(client::Client::Connect(argv[4]));
  const auto model = Require(connection->UploadModelFile(argv[2]));

  client::SessionConfig config;
  config.encoding = recording->encoding();
  config.camera = Require(client::LoadCamera(argv[3]));
  config.objects = {{.object_id = "object", .model = model.name}};
  const auto session = Require(connection->CreateSession(config));

  client::TrackCallbacks callbacks;
  callbacks.on_pose = [](const client::Pose& pose) {
    std::cout << pose.t_us << " " << pose.camera_from_object.translation_m.transpose() << " "
              << client::TrackStateName(pose.state) << "\n";
  };
  const auto summary = Require(connection->Track(
      session, [&recording] { return recording->Next(); }, callbacks));
  if (const auto deleted = connection->DeleteSession(session.name); !deleted.ok()) {
    std::cerr << deleted.message() << "\n";
  }
  std::cerr << summary.poses << " poses\n";
}
