// SPDX-License-Identifier: Apache-2.0
#include "client/containers/aedat/aedat_decoder.h"

namespace evpose::client {

void AedatDecoder::Append(const Event& event, SensorGeometry geometry, DecodedEvents& out) {
  if (geometry != SensorGeometry{} && (event.x >= geometry.width_px || event.y >= geometry.height_px)) {
    ++counts_.outside_sensor;
    return;
  }
  out.events.push_back(event);
  ++counts_.cd_events;
}

}  // namespace evpose::client
