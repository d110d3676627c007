#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests that the Debian packages of a build are complete, and that systemd accepts the unit file.
#   tests/packages_test.sh BUILD_DIRECTORY
set -euo pipefail
build=$(realpath "${1:?usage: $0 BUILD_DIRECTORY}")
source=$(realpath "$(dirname "${BASH_SOURCE[0]}")/..")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() { echo "packages_test: $*" >&2; exit 1; }

(cd "$work" && cpack --config "$build/CPackConfig.cmake" -B "$work/packages" >"$work/log" 2>&1) || { cat "$work/log" >&2; fail "cpack failed"; }
for component in server client dev; do
  package=$(echo "$work"/packages/evpose-"${component}"_*.deb)
  [[ -f $package ]] || fail "there is no package of $component"
  dpkg-deb --extract "$package" "$work/root"
  [[ $(dpkg-deb --field "$package" Depends) == *libgrpc++* ]] || fail "evpose-$component does not name its libraries"
  [[ -f $work/root/usr/share/doc/evpose-$component/copyright ]] || fail "evpose-$component has no copyright"
done
programs=(evpose evpose-server)
pages=(man1/evpose.1 man1/evpose-replay.1 man1/evpose-sessions-list.1 man8/evpose-server.8 man8/evpose-health-check.8)
# Only where OpenCASCADE is installed.
if [[ -x $build/client/convert_step/evpose-convert-step ]]; then
  package=$(echo "$work"/packages/evpose-convert-step_*.deb)
  dpkg-deb --extract "$package" "$work/root"
  [[ $(dpkg-deb --field "$package" Depends) == *libocct* ]] || fail "evpose-convert-step does not name its libraries"
  [[ $("$work/root/usr/bin/evpose-convert-step" --help) == *"Usage: "* ]] || fail "evpose-convert-step does not run"
  programs+=(evpose-convert-step)
  pages+=(man1/evpose-convert-step.1)
fi
# Only where HDF5 is installed.
if [[ -x $build/client/convert_hdf5/evpose-hdf5 ]]; then
  package=$(echo "$work"/packages/evpose-hdf5_*.deb)
  dpkg-deb --extract "$package" "$work/root"
  [[ $(dpkg-deb --field "$package" Depends) == *libhdf5* ]] || fail "evpose-hdf5 does not name its libraries"
  [[ $("$work/root/usr/bin/evpose-hdf5" --help) == *"Usage: "* ]] || fail "evpose-hdf5 does not run"
  programs+=(evpose-hdf5)
  pages+=(man1/evpose-hdf5.1)
fi
if [[ -d $build/client/python/evpose ]]; then
  package=$(echo "$work"/packages/python3-evpose_*_all.deb)
  dpkg-deb --extract "$package" "$work/root"
  [[ $(dpkg-deb --field "$package" Depends) == *python3-grpcio* ]] || fail "python3-evpose does not name its libraries"
  dpkg-deb --control "$package" "$work/control"
  [[ -f $work/control/postinst ]] || fail "python3-evpose does not compile its modules"
  PYTHONPATH=$work/root/usr/lib/python3/dist-packages /usr/bin/python3 -c 'import evpose; evpose.TrackState' || fail "python3-evpose cannot be imported"
fi
version=$(dpkg-deb --field "$work"/packages/evpose-server_*.deb Version)
for program in "${programs[@]}"; do
  said=$("$work/root/usr/bin/$program" --version)
  [[ $said == *"$version"* ]] || fail "$program prints $said, but its package has version $version"
done
for page in "${pages[@]}"; do
  man --warnings --local-file "$work/root/usr/share/man/$page" >"$work/page" 2>"$work/problems" || fail "man cannot display $page"
  [[ ! -s $work/problems ]] || { cat "$work/problems" >&2; fail "$page has problems"; }
  grep -q 'EXIT STATUS' "$work/page" || fail "$page has no exit status"
done
for program in "${programs[@]}"; do
  bash -n "$work/root/usr/share/bash-completion/completions/$program" || fail "there is no completion of $program for bash"
  grep -q "^#compdef $program\$" "$work/root/usr/share/zsh/vendor-completions/_$program" || fail "there is no completion of $program for zsh"
done
cmp "$work/root/usr/share/evpose/sensors/evk4.yaml" "$source/deploy/sensors/evk4.yaml"

# The unit must name the installed path of the program; systemd-analyze checks that the program exists.
unit=$work/root/usr/lib/systemd/system/evpose-server.service
[[ -f $unit ]] || fail "the unit file is not in the package"
grep -q '^ExecStart=/usr/bin/evpose-server ' "$unit" || fail "the unit starts something else"
mkdir "$work/units"
sed "s|^ExecStart=/usr/bin/|ExecStart=$work/root/usr/bin/|" "$unit" >"$work/units/evpose-server.service"
systemd-analyze verify --man=no "$work/units/evpose-server.service" 2>"$work/verify" || { cat "$work/verify" >&2; fail "systemd refuses the unit"; }
[[ ! -s $work/verify ]] || { cat "$work/verify" >&2; fail "systemd reports problems of the unit"; }
