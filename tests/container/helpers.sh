#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Functions of the container tests. To be sourced by run.sh.
version=$(sed -n 's/^project(evpose VERSION \([0-9.]*\).*/\1/p' CMakeLists.txt)
revision=$(git rev-parse HEAD)
bin=build/release
export EVPOSE_VERSION=$version EVPOSE_REVISION=$revision

say() { printf '== %4d s  %s\n' "$((SECONDS - began))" "$*"; }
fail() {
  echo "container tests: $*" >&2
  exit 1
}

show_what_is_there() {
  [[ -n $engine_pid ]] || return
  docker ps --all --format '{{.Names}}: {{.Status}}'
  local name
  for name in $(docker ps --all --format '{{.Names}}'); do
    echo "-- the last of $name's log"
    docker logs --tail 15 "$name" 2>&1
  done
}

# await WHAT COMMAND...: repeats a command until it succeeds, for at most 90 s. The interval of half a second keeps the load of the
# command itself low.
await() {
  local what=$1 end=$((SECONDS + 90))
  shift
  until "$@"; do
    ((SECONDS < end)) || fail "timeout while waiting for $what"
    sleep 0.5
  done
}

# page PORT/PATH [PARAMETERS...]: prints a page from 127.0.0.1 in the engine's network namespace; fails when there is no response.
page() {
  nsenter "--net=/run/netns/$engine_namespace" python3 -c '
import sys, urllib.parse, urllib.request
parameters = urllib.parse.urlencode([tuple(text.split("=", 1)) for text in sys.argv[2:]])
sys.stdout.write(urllib.request.urlopen(f"http://127.0.0.1:{sys.argv[1]}?{parameters}", timeout=5).read().decode())' "$@" 2>/dev/null
}

# metric PORT NAME: prints the sum of a metric's series at a server, 0 when it does not respond, for instance while it is started again.
metric() { { page "$1/metrics" || true; } | awk -v name="$2" '$1 == name || index($1, name "{") == 1 {sum += $2} END {printf "%.0f\n", sum}'; }

is_above() { (($("${@:2}") > $1)); }

directory_of_volume() { docker volume inspect --format '{{.Mountpoint}}' "$1"; }

pid_of() { docker inspect --format '{{.State.Pid}}' "$1"; }
has_started_again() { (($(docker inspect --format '{{.RestartCount}}' "$1") > $2)); }

# Kills the program of a container from outside, and waits until the engine has restarted it.
kill_and_await() {
  local restarts
  restarts=$(docker inspect --format '{{.RestartCount}}' "$1")
  kill -KILL "$(pid_of "$1")"
  await "$1 to be started again" has_started_again "$1" "$restarts"
}

# Copies recent objects of ccache, so that the image's build does not compile them again.
copy_ccache() {
  local cache
  cache=$(ccache --get-config cache_dir 2>/dev/null) && [[ -d $cache ]] || return 0
  mkdir "$1"
  # Builds that run beside this one have files in tmp/, and may remove old objects.
  (cd "$cache" && find . -path ./tmp -prune -o -type f -mmin -240 -print0 | tar --create --ignore-failed-read --null --files-from -) |
    tar --extract --directory "$1"
}

# build_image NAME TAG DOCKER_BUILD_ARGUMENTS...: builds in the background, with its output in $work/build-NAME.
build_image() {
  docker build --progress plain --network host --tag "$2" "${@:3}" >"$work/build-$1" 2>&1 &
  background+=($!)
  builds[$1]=$!
}
await_images() {
  local target
  for target in "$@"; do
    wait "${builds[$target]}" || { tail -n 30 "$work/build-$target" >&2; fail "the image of $target does not build"; }
  done
}

# Prints why the images have no page of evpose view, or no browser could show it; nothing if they can be tested. The packages of npm
# are not on the Debian mirror, the only host that the images are built from. So the page comes from the build before.
page_bundle=$bin/client/view/page/dist
page_obstacle() {
  local program
  [[ -f $page_bundle/app.js ]] || { echo "$bin has no page: node, npm or its packages were missing"; return; }
  [[ -z $(find client/view/page/src client/view/page/build.mjs client/view/page/package-lock.json -newer "$page_bundle/app.js") ]] ||
    { echo "the page in $bin is older than its source"; return; }
  for program in chromium chromedriver; do
    command -v "$program" >/dev/null || { echo "$program is missing: deploy/install-dependencies.sh --test installs it"; return; }
  done
  /usr/bin/python3 -c 'import selenium' 2>/dev/null || echo "python3-selenium is missing: deploy/install-dependencies.sh --test installs it"
}

declare -A builds
build_images() {
  local context=$work/context since=$SECONDS target
  local arguments=(--file "$context/deploy/Dockerfile" --build-arg "VERSION=$version" --build-arg "REVISION=$revision"
    ${LANG+--build-arg "LANG=$LANG"} "$context")
  mkdir "$context"
  page_missing=$(page_obstacle)
  if [[ -z $page_missing ]]; then
    cp -r "$page_bundle" "$context/.page"
  else
    arguments+=(--build-arg EVPOSE_VIEW=OFF)
  fi
  # The files of the work tree with uncommitted changes, including the Dockerfile.
  git ls-files -co --exclude-standard -z | tar --create --null --files-from - | tar --extract --directory "$context"
  copy_ccache "$context/.ccache"
  for target in server client haproxy redis; do build_image "$target" "evpose-$target:$version" --target "$target" "${arguments[@]}"; done
  mkdir "$work/empty"
  build_image prometheus "$(sed -n 's/^PROMETHEUS_IMAGE=//p' deploy/.env)" --file "$here/others.Dockerfile" "$work/empty"
  await_images server client
  echo "images of server and client: built in $((SECONDS - since)) s on $(nproc) cores; taken from what the build before compiled:" \
    "$(sed -n 's/.* Hits: *//p' "$work/build-server" | head -n 1)"
  await_images prometheus redis haproxy
  rm -rf "$context"
}

# shellcheck disable=SC2154  # the scripts that source this file set compose_file and project
compose() { docker compose --file "$compose_file" --project-name "$project" "$@"; }

# Makes two recordings in $work, "cube" as in the demo of compose.yaml and "long", and their trajectories without containers.
make_references() {
  make_reference cube --object cube --duration 5 --noise 0.1 --seed 1
  make_reference long --object cube --camera vga --duration 40 --speed 0.5 --seed 1
}
# make_reference NAME SIMULATE_OPTIONS...
make_reference() {
  local out=$work/$1
  "$bin/client/cli/evpose" simulate "${@:2}" --out "$out" >/dev/null 2>&1 || fail "no recording could be made"
  "$bin/client/cli/evpose" replay "$out/recording.raw" --model "$out/model.obj" --camera "$out/camera.yaml" --out "$out/reference.tum" >"$work/log" 2>&1 || fail "no reference: $(tail -n 1 "$work/log")"
}

same() { cmp "$1" "$2" || fail "$3: the trajectory differs from that without containers"; }

# one_line STATUS TEXT DOCKER_RUN_ARGUMENTS...: checks the exit status and that the only output is a line with this text.
one_line() {
  local status=0
  docker run --rm --read-only "${@:3}" >"$work/said" 2>&1 || status=$?
  [[ $status == "$1" && $(wc -l <"$work/said") == 1 && $(<"$work/said") == *"$2"* ]] ||
    fail "docker run ${*:3}: exit status $status, output: $(<"$work/said")"
}

# Checks the files before anything is started.
check_files() {
  local file
  make_secrets
  for file in compose.yaml compose.cluster.yaml compose.sentinel.yaml; do
    docker compose --file "deploy/$file" --profile '*' config --quiet || fail "deploy/$file is not valid"
  done
  for file in compose compose.cluster compose.sentinel; do
    docker compose --file "deploy/$file.yaml" --file "deploy/$file.tls.yaml" config --quiet || fail "deploy/$file.tls.yaml is not valid on top of $file.yaml"
  done
  # A command in the upper file replaces that in the lower file completely.
  docker compose --file deploy/compose.cluster.yaml --file deploy/compose.cluster.tls.yaml config --format json | python3 -c '
import json, sys
commands = [service["command"] for name, service in json.load(sys.stdin)["services"].items() if name.startswith("server-")]
sys.exit(len(commands) != 3 or not all("--shutdown-notice" in command for command in commands))' ||
    fail "with deploy/compose.cluster.tls.yaml the servers shut down without a notice"
}

# check_flood ADDRESS COMMAND...: floods a published port with calls that are reset, twice, while a command succeeds again and again: a
# call of a client with another address.
check_flood() {
  local pid calls=0
  nsenter "--net=/run/netns/$engine_namespace" python3 "$here/../http2_flood.py" "$1" 2 200000 >"$work/flood" &
  pid=$!
  background=("$pid")
  while kill -0 "$pid" 2>/dev/null || ((calls < 3)); do
    "${@:2}" >"$work/log" 2>&1 || fail "a call during a flood of resets fails: $(tail -n 1 "$work/log")"
    calls=$((calls + 1))
  done
  wait "$pid" || fail "the flood ended early"
  background=()
  [[ $(tail -n 1 "$work/flood") != all ]] || fail "HAProxy lets an address flood again"
  echo "flood of 200000 calls: connections cut after $(paste -sd ' ' "$work/flood"); $calls calls of another client"
}

make_secrets() {
  export EVPOSE_SECRETS=$work/secrets
  deploy/make-secrets.sh "$EVPOSE_SECRETS"
}
