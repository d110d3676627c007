#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Compares the poses of an arm64 build with those of this machine, which must be the same bits. It is no part of
# tests/run.sh: it takes 30 minutes and 3 GB.
#   tests/arm64/run.sh [DIR]     DIR keeps the packages, the build and the recordings; default: build/arm64
# Needs build/release, and deploy/install-dependencies.sh --arm64. Packages of arm64 are unpacked to DIR/root without being
# installed, evpose is cross-compiled against them, and qemu-user runs it.
set -euo pipefail
source=$(cd "$(dirname "$0")/../.." && pwd)
dir=$(realpath -m "${1:-$source/build/arm64}")
root=$dir/root
evpose=$source/build/release/client/cli/evpose
# A flat object, one with symmetries behind an occluder, and a part with holes and a fillet.
scenes=(planar occlusion-40 bracket)

fail() {
  echo "arm64: $1" >&2
  exit 1
}

[[ -x $evpose ]] || fail "$evpose does not exist: build the preset release first"
for program in mmdebstrap qemu-aarch64-static aarch64-linux-gnu-g++; do
  command -v "$program" >/dev/null || fail "$program is missing: run deploy/install-dependencies.sh --arm64"
done

# The maintainer scripts, which would run programs of arm64, are not run; what they would do for the build is done here.
make_root() {
  rm -rf "$root.partial"
  mkdir -p "$dir"
  mmdebstrap --quiet --variant=extract --architectures=arm64 \
    --include="$("$source/deploy/install-dependencies.sh" --list-libraries | paste -sd,)" bookworm "$root.partial"
  local file
  for file in "$root.partial"/usr/lib/aarch64-linux-gnu/atlas/*.so*; do
    ln -sf "atlas/$(basename "$file")" "$root.partial/usr/lib/aarch64-linux-gnu/"
  done
  # The plugins of protoc run on this machine. CMake checks that all of the package exist.
  for file in cpp php python ruby; do ln -sf /usr/bin/grpc_cpp_plugin "$root.partial/usr/bin/grpc_${file}_plugin"; done
  # Absolute links and paths in CMake files are those of the root.
  find "$root.partial/usr/lib" "$root.partial/lib" -type l -lname '/*' | while read -r file; do
    ln -sfn "$root$(readlink "$file")" "$file"
  done
  find "$root.partial/usr/lib" -name '*.cmake' -exec sed -i -E "s#([\";]|>:)/usr/(lib|include)/#\1$root/usr/\2/#g" {} +
  mv "$root.partial" "$root"
}

# compare NAME: simulates a recording, and tracks it with both programs.
compare() {
  local name=$1 scene=$dir/recordings/$1 model=$dir/models/bracket-medium.obj
  rm -rf "$scene"
  if [[ $name == bracket ]]; then
    "$source/tests/bench/models/generate.py" "$dir/models" bracket >/dev/null
    "$evpose" simulate --model "$dir/models/bracket-reference.obj" --duration 0.5 --seed 1 --out "$scene" >/dev/null
  else
    "$evpose" simulate --scenario "$name" --duration 0.5 --seed 1 --out "$scene" >/dev/null
    model=$scene/model.obj
  fi
  local arguments=(replay "$scene/recording.raw" --camera "$scene/camera.yaml" --model "$model")
  "$evpose" "${arguments[@]}" --out "$scene/here.csv" >/dev/null
  qemu-aarch64-static -L "$root" "$dir/client/cli/evpose" "${arguments[@]}" --out "$scene/arm64.csv" >/dev/null
  cmp "$scene/here.csv" "$scene/arm64.csv" || fail "the poses of $name differ"
  echo "$name: $(($(wc -l <"$scene/arm64.csv") - 1)) poses, identical to the bit"
}

[[ -d $root ]] || make_root
export EVPOSE_ARM64_ROOT=$root
cmake -S "$source" -B "$dir" -G Ninja --toolchain "$source/tests/arm64/toolchain.cmake" -DCMAKE_BUILD_TYPE=Release \
  -DCMAKE_UNITY_BUILD=ON -DEVPOSE_WERROR=OFF -DLLD_PROGRAM=OFF -DEVPOSE_BUILD_TESTS=OFF -DEVPOSE_PCL_INCLUDE_DIR=/usr/local/include/pcl-1.13 >/dev/null
cmake --build "$dir" --target evpose
for scene in "${scenes[@]}"; do compare "$scene"; done
