// SPDX-License-Identifier: Apache-2.0

// Standard input, output and error of a program that was started without some of them.
#pragma once

namespace evpose::client {

// Opens those of the three that are closed, so that no file that is opened later gets their descriptors. Reading such a
// standard input fails, and so does writing such a standard output or error: both report EBADF. To be called at the
// beginning of main(). A library may have opened something before it, which then has the descriptor.
void OpenStandardStreams();
// Whether standard output was closed when the program started.
bool IsStandardOutputClosed();

}  // namespace evpose::client
