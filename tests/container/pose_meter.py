#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Reads the poses of several clients through named pipes, and prints the longest wait for a pose.

usage: pose_meter.py DIRECTORY NAME...

Creates the FIFO DIRECTORY/NAME.tum, reads it until its client has closed it, and copies the bytes to DIRECTORY/NAME.copy.
DIRECTORY/counts has the number of poses of each so far, in the order of the names, and is replaced ten times a second. At the
end prints, for each name, the number of poses and the longest time between two reads in milliseconds.
"""
import os
import pathlib
import sys
import threading
import time


class Stream:
    def __init__(self, directory, name):
        self.name = name
        self.path = directory / f"{name}.tum"
        self.copy = directory / f"{name}.copy"
        self.poses = 0
        self.longest_s = 0.0
        self.last = None
        os.mkfifo(self.path)
        self.path.chmod(0o666)

    def read(self):
        with open(self.path, "rb", buffering=0) as pipe, open(self.copy, "wb") as copy:
            while data := pipe.read(1 << 16):
                now = time.monotonic()
                if self.last is not None:
                    self.longest_s = max(self.longest_s, now - self.last)
                self.last = now
                self.poses += data.count(b"\n")
                copy.write(data)


def main():
    directory = pathlib.Path(sys.argv[1])
    streams = [Stream(directory, name) for name in sys.argv[2:]]
    threads = [threading.Thread(target=stream.read) for stream in streams]
    for thread in threads:
        thread.start()
    print("ready", flush=True)

    while any(thread.is_alive() for thread in threads):
        partial = directory / "counts.partial"
        partial.write_text(" ".join(str(stream.poses) for stream in streams) + "\n")
        partial.rename(directory / "counts")
        time.sleep(0.1)
    for stream in streams:
        print(stream.name, stream.poses, round(1000 * stream.longest_s), flush=True)


if __name__ == "__main__":
    main()
