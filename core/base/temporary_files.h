// SPDX-License-Identifier: Apache-2.0

// The temporary files of this process that a signal which ends it must remove.
#pragma once

#include <string>

namespace evpose {

// The file is removed by RemoveTemporaryFiles() until it is unregistered. Of more than 16 files at once, the others are
// not registered.
void RegisterTemporaryFile(const std::string& path);
void UnregisterTemporaryFile(const std::string& path);

// May be called by a signal handler.
void RemoveTemporaryFiles();

}  // namespace evpose
