// SPDX-License-Identifier: Apache-2.0

// Images of events as PNG.
#pragma once

#include <string>

#include "evpose/types.h"

namespace evpose::client {

// A PNG of the size of the sensor, in which a cell of the image covers cell_px x cell_px pixels. Four colours: no
// event, brighter, darker, both.
std::string EventImagePng(const EventImage& image, int width_px, int height_px);

}  // namespace evpose::client
