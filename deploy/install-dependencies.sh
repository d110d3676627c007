#!/usr/bin/env bash
# Installs what evpose needs from Debian 12's own packages.
#   deploy/install-dependencies.sh            to build and run
#   deploy/install-dependencies.sh --test     also what the tests and linters need
# Needs root, or sudo. Does nothing when everything is there already.
set -euo pipefail

build_packages=(
  g++ cmake ninja-build ccache pkg-config git ca-certificates
  libabsl-dev libassimp-dev libboost-dev libceres-dev libcli11-dev libeigen3-dev libgrpc++-dev
  libopencv-calib3d-dev libopencv-core-dev libopencv-imgcodecs-dev libopencv-imgproc-dev libopencv-videoio-dev
  libprotobuf-dev libspdlog-dev libssl-dev libyaml-cpp-dev nlohmann-json3-dev protobuf-compiler protobuf-compiler-grpc
)
test_packages=(clang-format clang-tidy libgmock-dev libgtest-dev python3)

wanted=("${build_packages[@]}")
case "${1:-}" in
  "") ;;
  --test) wanted+=("${test_packages[@]}") ;;
  *) echo "usage: $0 [--test]" >&2; exit 2 ;;
esac

missing=()
for package in "${wanted[@]}"; do
  [[ $(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null) == installed ]] || missing+=("$package")
done
if ((${#missing[@]} == 0)); then
  echo "install-dependencies: all ${#wanted[@]} packages are installed already"
  exit 0
fi

as_root=()
if ((EUID != 0)); then
  command -v sudo >/dev/null || { echo "install-dependencies: run as root, or install sudo; missing: ${missing[*]}" >&2; exit 1; }
  as_root=(sudo)
fi
echo "install-dependencies: installing ${#missing[@]} packages with apt-get: ${missing[*]}"
apt_get=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=600)
"${apt_get[@]}" update -qq
"${apt_get[@]}" install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
echo "install-dependencies: done"
