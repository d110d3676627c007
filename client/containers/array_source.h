// SPDX-License-Identifier: Apache-2.0

// Events in NumPy arrays: .npy with records of t, x, y, p or with rows of four numbers; .npz with such an array or with
// an array each of t, x, y and p.
#pragma once

#include "client/containers/container_format.h"

namespace evpose::client {

extern const ContainerFormat kNpyFormat;
extern const ContainerFormat kNpzFormat;

}  // namespace evpose::client
