// SPDX-License-Identifier: Apache-2.0

// Writes the events of a Prophesee camera to standard output as a RAW stream, through the HAL of OpenEB 5, for example:
//   capture_camera --biases camera.bias |
//     evpose stream - --model object.obj --camera camera.yaml --server tracker:50051
// Every buffer of the HAL is written at once. deploy/sensors/README.md has the effect of the options.
#include <metavision/hal/device/device.h>
#include <metavision/hal/device/device_discovery.h>
#include <metavision/hal/facilities/i_antiflicker_module.h>
#include <metavision/hal/facilities/i_erc_module.h>
#include <metavision/hal/facilities/i_events_stream.h>
#include <metavision/hal/facilities/i_geometry.h>
#include <metavision/hal/facilities/i_hw_identification.h>
#include <metavision/hal/facilities/i_hw_register.h>
#include <metavision/hal/facilities/i_ll_biases.h>
#include <metavision/hal/facilities/i_trigger_in.h>

#include <charconv>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <system_error>

namespace {

constexpr char kUsage[] =
    "capture_camera [--serial S] [--file RAW] [--biases FILE] [--erc EVENTS_PER_S] [--antiflicker 1] [--trigger 1]\n"
    "               [--period-us US]   time after which the sensor sends an incomplete packet (IMX636, Gen3.1)\n";
// Addresses of the register of the packet period: metavision_driver, src/metavision_wrapper.cpp.
const std::map<std::string, uint32_t> kPeriodRegisters = {{"IMX636", 0xB028}, {"Gen3.1", 0x1508}};

volatile std::sig_atomic_t is_interrupted = 0;

template <typename Facility>
Facility& Get(Metavision::Device& device, const char* name) {
  if (auto* const facility = device.get_facility<Facility>()) return *facility;
  throw std::runtime_error(std::string("this camera has no ") + name);
}

std::unique_ptr<Metavision::Device> Open(std::map<std::string, std::string>& options) {
  std::unique_ptr<Metavision::Device> device;
  if (options.contains("--file")) {
    Metavision::RawFileConfig config;
    config.do_time_shifting_ = false;  // the times of the file
    device = Metavision::DeviceDiscovery::open_raw_file(options["--file"], config);
  } else {
    Metavision::DeviceConfig config;
    config.set_format("EVT3");
    device = Metavision::DeviceDiscovery::open(options["--serial"], config);
  }
  if (device == nullptr) throw std::runtime_error("no camera was found; does metavision_viewer show it?");
  return device;
}

uint32_t Number(std::map<std::string, std::string>& options, const std::string& name) {
  const std::string& text = options[name];
  const char* const end = text.data() + text.size();
  uint32_t number = 0;
  const auto [rest, error] = std::from_chars(text.data(), end, number);
  if (error != std::errc() || rest != end) {
    throw std::runtime_error(name + " " + text + ": an integer between 0 and 4294967295 is needed");
  }
  return number;
}

// Whether an option that can only switch something on is given.
bool IsOn(std::map<std::string, std::string>& options, const std::string& name) {
  if (!options.contains(name)) return false;
  if (options[name] != "1") {
    throw std::runtime_error(name + " " + options[name] + ": only 1 is possible; omit the option to leave it off");
  }
  return true;
}

void Configure(Metavision::Device& device, std::map<std::string, std::string>& options) {
  using namespace Metavision;
  if (options.contains("--biases")) Get<I_LL_Biases>(device, "biases").load_from_file(options["--biases"]);
  if (options.contains("--erc")) {
    auto& erc = Get<I_ErcModule>(device, "event rate control");
    if (!erc.set_cd_event_rate(Number(options, "--erc")) || !erc.enable(true)) {
      throw std::runtime_error("--erc: the camera refuses this event rate");
    }
  }
  if (IsOn(options, "--antiflicker") && !Get<I_AntiFlickerModule>(device, "anti-flicker filter").enable(true)) {
    throw std::runtime_error("--antiflicker: the camera refuses it");
  }
  if (IsOn(options, "--trigger") && !Get<I_TriggerIn>(device, "trigger input").enable(I_TriggerIn::Channel::Main)) {
    throw std::runtime_error("--trigger: the camera refuses it");
  }
  if (!options.contains("--period-us")) return;
  const std::string sensor = Get<I_HW_Identification>(device, "identification").get_sensor_info().name_;
  if (!kPeriodRegisters.contains(sensor)) throw std::runtime_error("--period-us: not for the sensor " + sensor);
  Get<I_HW_Register>(device, "registers").write_register(kPeriodRegisters.at(sensor), Number(options, "--period-us"));
}

void Write(const void* data, size_t size) {
  if (std::fwrite(data, 1, size, stdout) != size || std::fflush(stdout) != 0) {
    throw std::runtime_error("standard output cannot be written");
  }
}

void Capture(Metavision::Device& device) {
  using namespace Metavision;
  const auto& geometry = Get<I_Geometry>(device, "geometry");
  std::string format = Get<I_HW_Identification>(device, "identification").get_current_data_encoding_format();
  format = format.substr(0, format.find(';'));
  const std::string header = "% format " + format + ";height=" + std::to_string(geometry.get_height()) +
                             ";width=" + std::to_string(geometry.get_width()) + "\n% end\n";
  Write(header.data(), header.size());
  auto& stream = Get<I_EventsStream>(device, "stream of events");
  stream.start();
  while (is_interrupted == 0 && stream.wait_next_buffer() > 0) {
    const auto buffer = stream.get_latest_raw_data();
    if (buffer) Write(buffer.data(), buffer.size());
  }
  stream.stop();
}

}  // namespace

int main(int argc, char** argv) {
  std::map<std::string, std::string> options;
  bool is_valid = argc % 2 == 1;
  for (int i = 1; i + 1 < argc; i += 2) {
    options[argv[i]] = argv[i + 1];
    is_valid = is_valid && std::string(kUsage).find(std::string("[") + argv[i] + " ") != std::string::npos;
  }
  if (!is_valid) return std::fputs(kUsage, stderr), 2;
  for (const int signal : {SIGINT, SIGTERM}) std::signal(signal, [](int) { is_interrupted = 1; });
  try {
    const std::unique_ptr<Metavision::Device> device = Open(options);
    Configure(*device, options);
    Capture(*device);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "capture_camera: %s\n", error.what());
    return 1;
  }
  return 0;
}
