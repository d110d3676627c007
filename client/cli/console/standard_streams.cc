// SPDX-License-Identifier: Apache-2.0
#include "client/cli/console/standard_streams.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <initializer_list>

namespace evpose::client {

void OpenStandardStreams() {
  // open() returns the lowest free descriptor, which is this one, because those below are open.
  for (const int descriptor : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(descriptor, F_GETFD) >= 0) continue;
    // For a descriptor that is open for writing alone poll() waits forever; for one of O_PATH it returns at once.
    const int mode = descriptor == STDIN_FILENO ? O_PATH : O_RDONLY;
    if (open("/dev/null", mode) != descriptor) return;
  }
}

bool IsStandardOutputClosed() {
  const int flags = fcntl(STDOUT_FILENO, F_GETFL);
  if (flags < 0 || (flags & O_ACCMODE) == O_RDONLY) return true;
  // A library may have got the descriptor before main(), for an object that is no file, such as an eventfd.
  struct stat output;
  return fstat(STDOUT_FILENO, &output) != 0 || (output.st_mode & S_IFMT) == 0;
}

}  // namespace evpose::client
