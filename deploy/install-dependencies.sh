#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Installs the dependencies of evpose from Debian 12's packages.
#   deploy/install-dependencies.sh            for building and running
#   deploy/install-dependencies.sh --step     also for evpose-convert-step, which reads STEP and IGES files
#   deploy/install-dependencies.sh --hdf5     also for evpose-hdf5, which reads and writes recordings in HDF5
#   deploy/install-dependencies.sh --package  also for making Debian packages, those of both programs included
#   deploy/install-dependencies.sh --test     all of these, and for tests and linters
#   deploy/install-dependencies.sh --arm64    for building and running, and for tests/arm64/run.sh
#   deploy/install-dependencies.sh --list-libraries   prints the libraries of the build, one on each line, and installs nothing
# Needs root or sudo. Does nothing if everything is installed.
set -euo pipefail

build_packages=(
  g++ cmake ninja-build ccache pkg-config git ca-certificates
  libabsl-dev libassimp-dev libboost-dev libceres-dev libcli11-dev libeigen3-dev libgrpc++-dev libhiredis-dev
  liblz4-dev libmeshoptimizer-dev
  libopencv-calib3d-dev libopencv-core-dev libopencv-imgcodecs-dev libopencv-imgproc-dev libopencv-videoio-dev
  libminizip-dev libpcl-common1.13 libpcl-features1.13 libpcl-filters1.13 libpcl-kdtree1.13 libpcl-octree1.13
  libpcl-sample-consensus1.13 libpcl-search1.13 libpcl-segmentation1.13
  libpq-dev libprotobuf-dev libpugixml-dev libspdlog-dev libsqlite3-dev libssl-dev libyaml-cpp-dev libzstd-dev nlohmann-json3-dev nodejs npm prometheus-cpp-dev protobuf-compiler protobuf-compiler-grpc
  zlib1g-dev
)
# OpenCASCADE: 180 MB with its dependencies.
step_packages=(libocct-data-exchange-dev libocct-foundation-dev libocct-modeling-algorithms-dev libocct-modeling-data-dev)
hdf5_packages=(libhdf5-dev)
# A cross compiler, an emulator, and a program that unpacks packages of another architecture.
arm64_packages=(g++-aarch64-linux-gnu mmdebstrap qemu-user-static)
package_packages=("${step_packages[@]}" "${hdf5_packages[@]}" dpkg-dev file python3)
test_packages=("${package_packages[@]}" chromium chromium-driver clang clang-format clang-tidy codespell groff-base haproxy hdf5-filter-plugin-blosc-serial iproute2 libbenchmark-dev libclang-rt-14-dev libflatbuffers-dev libgmock-dev libgtest-dev lld man-db mandoc openssl postgresql python3-crc32c python3-diagnostic-msgs python3-geometry-msgs python3-grpcio python3-h5py python3-matplotlib python3-mypy python3-numpy python3-pip python3-prometheus-client python3-protobuf python3-selenium python3-setuptools python3-wheel python3-yaml redis-server shellcheck systemd zsh)

# Installing the package prometheus would start a service; so only promtool, which checks rules, is extracted from it.
promtool=/usr/local/bin/promtool
# kubectl renders the manifests. It is extracted from Debian's package, because that conflicts with other vendors' packages.
kubectl=/usr/local/bin/kubectl

wanted=("${build_packages[@]}")
is_for_tests=false
case "${1:-}" in
  "") ;;
  --step) wanted+=("${step_packages[@]}") ;;
  --hdf5) wanted+=("${hdf5_packages[@]}") ;;
  --package) wanted+=("${package_packages[@]}") ;;
  --test) wanted+=("${test_packages[@]}") is_for_tests=true ;;
  --arm64) wanted+=("${arm64_packages[@]}") ;;
  --list-libraries)
    printf '%s\n' "${build_packages[@]}" | grep -E -- '^lib|-dev$'
    exit 0
    ;;
  *) echo "usage: $0 [--step | --hdf5 | --package | --test | --arm64 | --list-libraries]" >&2; exit 2 ;;
esac

# libpcl-dev depends on VTK, Java and Qt, libflann-dev on MPI and HDF5: 3 GB for 12 MB of headers. Only the headers are
# extracted from the two packages, to a directory that compilers and CMake search by default.
header_packages=(libpcl-dev libflann-dev)
header_dir=/usr/local/include/pcl-1.13

is_installed() { [[ $(dpkg-query -W -f='${db:Status-Status}' "$1" 2>/dev/null) == installed ]]; }

# node and npm may come from another source: nodejs of nodesource contains npm, and conflicts with Debian's package npm.
has_program() {
  case $1 in
    nodejs) command -v node >/dev/null ;;
    npm) command -v npm >/dev/null ;;
    *) false ;;
  esac
}

missing=()
for package in "${wanted[@]}"; do
  is_installed "$package" || has_program "$package" || missing+=("$package")
done
needs_headers=()
[[ -d $header_dir ]] || is_installed libpcl-dev || needs_headers=("${header_packages[@]}")
needs_promtool=()
! $is_for_tests || [[ -x $(command -v promtool) ]] || needs_promtool=(prometheus)
needs_kubectl=()
! $is_for_tests || [[ -x $(command -v kubectl) ]] || needs_kubectl=(kubernetes-client)
if ((${#missing[@]} + ${#needs_headers[@]} + ${#needs_promtool[@]} + ${#needs_kubectl[@]} == 0)); then
  echo "install-dependencies: all ${#wanted[@]} packages are installed already"
  exit 0
fi

as_root=()
if ((EUID != 0)); then
  command -v sudo >/dev/null || {
    echo "install-dependencies: run as root, or install sudo; missing: ${missing[*]} ${needs_headers[*]} ${needs_promtool[*]} ${needs_kubectl[*]}" >&2
    exit 1
  }
  as_root=(sudo)
fi
apt_get=("${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=600)
"${apt_get[@]}" update -qq
if ((${#missing[@]} > 0)); then
  echo "install-dependencies: installing ${#missing[@]} packages with apt-get: ${missing[*]}"
  "${apt_get[@]}" install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
fi

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
# take_out PACKAGE...: downloads these packages and extracts them below $scratch.
take_out() {
  (cd "$scratch" && apt-get download -qq -o APT::Sandbox::User=root "$@" && for file in ./*.deb; do dpkg -x "$file" .; done)
}

if ((${#needs_headers[@]} > 0)); then
  echo "install-dependencies: taking the headers of ${needs_headers[*]} to $header_dir"
  take_out "${needs_headers[@]}"
  mv "$scratch/usr/include/flann" "$scratch/usr/include/pcl-1.13/"
  # Copied to a temporary name and renamed at the end, so that an interrupted run leaves no incomplete directory.
  "${as_root[@]}" rm -rf "$header_dir.partial"
  "${as_root[@]}" cp -r "$scratch/usr/include/pcl-1.13" "$header_dir.partial"
  "${as_root[@]}" chown -R root:root "$header_dir.partial"
  "${as_root[@]}" mv "$header_dir.partial" "$header_dir"
fi

if ((${#needs_promtool[@]} > 0)); then
  echo "install-dependencies: taking promtool of ${needs_promtool[*]} to $promtool"
  take_out "${needs_promtool[@]}"
  "${as_root[@]}" install -m 755 "$scratch/usr/bin/promtool" "$promtool"
fi

if ((${#needs_kubectl[@]} > 0)); then
  echo "install-dependencies: taking kubectl of ${needs_kubectl[*]} to $kubectl"
  take_out "${needs_kubectl[@]}"
  "${as_root[@]}" install -m 755 "$scratch/usr/bin/kubectl" "$kubectl"
fi
echo "install-dependencies: done"
