#include "client/cli/command.h"

#include "absl/strings/cord.h"
#include "absl/strings/str_cat.h"

namespace evpose::client {
namespace {

constexpr char kUsagePayload[] = "evpose/usage";

}  // namespace

absl::Status UsageError(const std::string& message) {
  absl::Status status = absl::InvalidArgumentError(message);
  status.SetPayload(kUsagePayload, absl::Cord());
  return status;
}

bool IsUsageError(const absl::Status& status) { return status.GetPayload(kUsagePayload).has_value(); }

void ServerArguments::AddTo(CLI::App& app, bool is_required) {
  app.add_option("--server", address, "Address of evpose-server")->type_name("HOST:PORT")->required(is_required);
  app.add_option("--connect-timeout", connect_timeout_s, "Seconds to wait for a server that does not answer yet")
      ->check(CLI::Range(0.001, 86400.0))
      ->capture_default_str();
}

absl::StatusOr<std::unique_ptr<Client>> ServerArguments::Connect() const {
  ClientOptions options;
  options.connect_timeout = absl::Seconds(connect_timeout_s);
  return Client::Connect(address, options);
}

std::string DescribeState(const ObjectHealth& object) {
  std::string text(TrackStateName(object.state));
  if (object.state != TrackState::kInitializing && object.state != TrackState::kLost) return text;
  const std::string_view status = InitializationStatusName(object.initialization);
  return absl::StrCat(text, " (", absl::string_view(status.data(), status.size()), ")");
}

absl::Status CheckCameraMatches(const CameraModel& camera, const std::string& camera_path,
                                const RecordingHeader& header, const std::string& recording_path) {
  const SensorGeometry& sensor = header.geometry;
  if (!header.geometry_is_known) return absl::OkStatus();
  if (sensor.width_px == camera.width_px && sensor.height_px == camera.height_px) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(camera_path, " is of ", camera.width_px, "x", camera.height_px,
                                                 " pixels, but ", recording_path, " of ", sensor.width_px, "x",
                                                 sensor.height_px, ": the camera file of that sensor is needed"));
}

}  // namespace evpose::client
