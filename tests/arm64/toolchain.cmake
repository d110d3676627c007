# SPDX-License-Identifier: Apache-2.0
# Cross-compiles for arm64 with Debian's compiler and the packages in EVPOSE_ARM64_ROOT (tests/arm64/run.sh).
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
set(CMAKE_SYSROOT $ENV{EVPOSE_ARM64_ROOT})
set(CMAKE_FIND_ROOT_PATH $ENV{EVPOSE_ARM64_ROOT})
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)
# Programs are those of this machine: protoc generates the same code for every processor.
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
