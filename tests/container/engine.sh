#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A private Docker engine with Compose for the container tests. It needs neither systemd nor a registry, installs nothing, and has
# all of its files below one directory. To be sourced with ENGINE_DIR set to an empty directory; then
#   engine_fetch               extracts the engine, Compose and their dependencies from Debian's packages
#   engine_start [NAMESPACE]   with a network namespace, the engine has no access to other machines
#   engine_base_image          debian:bookworm-slim, from this machine's Debian mirror
#   engine_stop, engine_remove
# Needs root. A step that fails writes the reason to standard error.
engine_root=$ENGINE_DIR/root
export DOCKER_HOST=unix://$ENGINE_DIR/docker.sock DOCKER_CONFIG=$ENGINE_DIR/config DOCKER_BUILDKIT=1
engine_pid=
engine_namespace=
engine_key=/etc/docker/key.json  # the only file outside ENGINE_DIR besides /run/netns/NAMESPACE
engine_made_key=
engine_cgroup=$(basename "$ENGINE_DIR")

# Prints the reason for which this kernel or user cannot run an engine, or nothing.
engine_obstacle() {
  ((EUID == 0)) || { echo "only root can start a container engine"; return; }
  command -v apt-get >/dev/null || { echo "the engine comes from Debian's packages, and there is no apt-get"; return; }
  unshare --mount --net --pid --fork true 2>/dev/null || { echo "namespaces cannot be created here"; return; }
  unshare --mount sh -c "mkdir -p '$ENGINE_DIR/a' '$ENGINE_DIR/b' '$ENGINE_DIR/c' '$ENGINE_DIR/d' &&
    mount -t overlay -o lowerdir='$ENGINE_DIR/a',upperdir='$ENGINE_DIR/b',workdir='$ENGINE_DIR/c' overlay '$ENGINE_DIR/d'" 2>/dev/null ||
    echo "this kernel mounts no overlay file systems here"
}

# engine_unpack DIRECTORY APT_OPTIONS... -- PACKAGE...: extracts the packages and those of their dependencies that are not installed.
engine_unpack() {
  local directory=$1 options=()
  shift
  while [[ $1 != -- ]]; do options+=("$1"); shift; done
  shift
  mkdir -p "$directory/partial"
  apt-get -qq -o DPkg::Lock::Timeout=600 -o Debug::NoLocking=true -o APT::Sandbox::User=root "${options[@]}" \
    -o Dir::Cache::archives="$directory" --no-install-recommends --reinstall --download-only -y install "$@" >/dev/null
  for file in "$directory"/*.deb; do dpkg -x "$file" "$engine_root"; done
}

engine_fetch() {
  local sources=/etc/apt/sources.list.d/debian.sources mirror trixie=$ENGINE_DIR/trixie
  apt-get -qq -o DPkg::Lock::Timeout=600 update
  engine_unpack "$ENGINE_DIR/packages" -- docker.io containerd runc tini mmdebstrap iptables iproute2
  # Debian 12 has no Compose v2. That of Debian 13 is one file that needs only libc.
  mirror=$(sed -n 's/^URIs: *//p' "$sources" | head -n 1)
  mkdir -p "$trixie/lists/partial" "$trixie/archives/partial"
  echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] $mirror trixie main" >"$trixie/sources.list"
  local apt=(apt-get -qq -o Dir::Etc::sourcelist="$trixie/sources.list" -o Dir::Etc::sourceparts=- -o Dir::State::lists="$trixie/lists"
    -o Dir::Cache="$trixie" -o APT::Sandbox::User=root)
  "${apt[@]}" update
  (cd "$trixie" && "${apt[@]}" download docker-compose docker-buildx && for file in *.deb; do dpkg -x "$file" "$engine_root"; done)
  mkdir -p "$DOCKER_CONFIG/cli-plugins"
  ln -sf "$engine_root"/usr/libexec/docker/cli-plugins/* "$DOCKER_CONFIG/cli-plugins/"
  echo '{}' >"$DOCKER_CONFIG/config.json"
  # The symbolic links that the packages' scripts would create.
  for tool in iptables ip6tables; do ln -sf xtables-nft-multi "$engine_root/usr/sbin/$tool"; done
}

# engine_run COMMAND...: runs a command with the programs and libraries that were extracted.
engine_run() { env "${engine_environment[@]}" "$@"; }
engine_environment=(
  "PATH=$engine_root/usr/sbin:$engine_root/usr/bin:$engine_root/sbin:$engine_root/bin:$PATH"
  "LD_LIBRARY_PATH=$engine_root/usr/lib/x86_64-linux-gnu:$engine_root/lib/x86_64-linux-gnu"
  "XTABLES_LIBDIR=$engine_root/usr/lib/x86_64-linux-gnu/xtables"
)

engine_start() {
  [[ -e $engine_key ]] || engine_made_key=1
  local enter=() network=()
  engine_namespace=${1:-}
  if [[ -n $engine_namespace ]]; then
    engine_run ip netns add "$engine_namespace"
    engine_run ip -n "$engine_namespace" link set lo up
    enter=(nsenter "--net=/run/netns/$engine_namespace")  # `ip netns exec` would hide the cgroups
    network=(--bip 10.99.0.1/24 --default-address-pool "base=10.99.128.0/17,size=24")
  else
    # Uses the network of the machine for builds, without changing its configuration.
    network=(--bridge none --iptables=false --ip6tables=false --ip-forward=false --ip-masq=false)
  fi
  env "${engine_environment[@]}" "${enter[@]}" dockerd --host "$DOCKER_HOST" --data-root "$ENGINE_DIR/data" --exec-root "$ENGINE_DIR/exec" \
    --pidfile "$ENGINE_DIR/docker.pid" --cgroup-parent "/$engine_cgroup" \
    "${network[@]}" >>"$ENGINE_DIR/dockerd.log" 2>&1 &
  engine_pid=$!
  local deadline=$((SECONDS + 90))
  until docker version >/dev/null 2>&1; do
    if ((SECONDS >= deadline)) || ! kill -0 "$engine_pid" 2>/dev/null; then
      tail -n 5 "$ENGINE_DIR/dockerd.log" >&2
      return 1
    fi
    sleep 0.1
  done
}

docker() { engine_run "$engine_root/usr/bin/docker" "$@"; }

engine_base_image() {
  local sources=/etc/apt/sources.list.d/debian.sources work=$ENGINE_DIR/base mirrors
  mapfile -t mirrors < <(sed -n 's/^URIs: *//p' "$sources")
  mkdir -p "$work"
  printf 'path-exclude=/usr/share/%s/*\n' info locale man doc >"$work/slim"
  echo 'path-include=/usr/share/doc/*/copyright' >>"$work/slim"
  echo force-unsafe-io >>"$work/slim"
  printf '#!/bin/sh\nexit 101\n' >"$work/policy-rc.d"
  chmod 755 "$work/policy-rc.d"
  local keyring="Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg"
  printf 'Types: deb\nURIs: %s\nSuites: bookworm bookworm-updates\nComponents: main\n%s\n\nTypes: deb\nURIs: %s\nSuites: bookworm-security\nComponents: main\n%s\n' \
    "${mirrors[0]}" "$keyring" "${mirrors[1]}" "$keyring" >"$work/debian.sources"
  # shellcheck disable=SC2016  # $1 is for mmdebstrap
  engine_run mmdebstrap --variant=minbase --mode=root --include=usr-is-merged,tzdata \
    --hook-dir="$engine_root/usr/share/mmdebstrap/hooks/merged-usr" \
    --aptopt='Acquire::Languages "none"' --dpkgopt="$work/slim" \
    --customize-hook="copy-in $work/slim /etc/dpkg/dpkg.cfg.d" \
    --customize-hook="copy-in $work/policy-rc.d /usr/sbin" \
    --customize-hook='rm -f "$1/etc/apt/sources.list"' \
    --customize-hook="copy-in $work/debian.sources /etc/apt/sources.list.d" \
    --customize-hook='rm -rf "$1"/var/lib/apt/lists/* "$1"/var/cache/apt/*.bin "$1/etc/hostname" "$1/etc/resolv.conf"' \
    bookworm "$work/root.tar" "deb ${mirrors[0]} bookworm main" "deb ${mirrors[0]} bookworm-updates main" \
    "deb ${mirrors[1]} bookworm-security main" 2>"$work/log" || { tail -n 20 "$work/log" >&2; return 1; }
  docker import -c 'CMD ["bash"]' -c 'ENV PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin' \
    "$work/root.tar" debian:bookworm-slim >/dev/null
  rm -rf "$work"
}

engine_stop() {
  if [[ -n $engine_pid ]]; then
    kill "$engine_pid" 2>/dev/null || true
    wait "$engine_pid" || true
    engine_pid=
  fi
  [[ -z $engine_namespace ]] || engine_run ip netns delete "$engine_namespace" || true
  engine_namespace=
}

# Removes everything, in any state.
engine_remove() {
  local containers mount
  if [[ -n $engine_pid ]]; then
    mapfile -t containers < <(docker ps --all --quiet 2>/dev/null)
    ((${#containers[@]} == 0)) || docker rm --force --volumes "${containers[@]}" >/dev/null 2>&1 || true
  fi
  engine_stop
  # Unmounts the deepest mount points first.
  while read -r mount; do umount --lazy "$mount" || true; done < <(awk -v top="$ENGINE_DIR/" 'index($2, top) == 1 {print $2}' /proc/mounts | sort -r)
  find /sys/fs/cgroup -depth -type d -path "*/$engine_cgroup*" -exec rmdir {} + 2>/dev/null || true
  [[ -z $engine_made_key ]] || { rm -f "$engine_key" && rmdir --ignore-fail-on-non-empty "${engine_key%/*}"; }
  rm -rf "$ENGINE_DIR"
}
