#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests the images, compose.yaml and compose.cluster.yaml under faults: killed containers, disconnected networks, restarts. Every
# trajectory must be identical to that of a replay without containers.
#   tests/container/run.sh            all tests; prints SKIPPED where no container engine can run
#   tests/container/run.sh single     compose.yaml only; or cluster: compose.cluster.yaml; or upgrade, which the tests without arguments
#                                     leave out: the servers of compose.cluster.yaml are replaced by the next version, and back
# Uses a private engine, which cannot reach other machines once the images are built, and removes everything at the end.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."
parts=("$@")
((${#parts[@]})) || parts=(single cluster)
for part in "${parts[@]}"; do
  [[ -f $here/$part.sh && $part =~ ^(single|cluster|upgrade)$ ]] || { echo "usage: $0 [single] [cluster] [upgrade]" >&2; exit 2; }
done

ENGINE_DIR=$(mktemp -d /tmp/evpose-containers.XXXXXX)
work=$ENGINE_DIR/work
mkdir "$work"
background=()
# shellcheck source=engine.sh
source "$here/engine.sh"
clean_up() {
  local status=$?
  trap '' INT TERM
  set +e
  ((status == 0)) || show_what_is_there >&2
  ((${#background[@]} == 0)) || kill "${background[@]}" 2>/dev/null
  engine_remove
}
trap clean_up EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

obstacle=$(engine_obstacle)
if [[ -n $obstacle ]]; then
  echo "container tests: SKIPPED: $obstacle"
  exit 0
fi

began=$SECONDS
# shellcheck source=helpers.sh
source "$here/helpers.sh"
[[ -x $bin/client/cli/evpose && -x $bin/server/evpose-server ]] || fail "there is no build in $bin: deploy/demo.sh makes one"
say "a separate container engine"
make_references &
references=$!
background=("$references")
engine_fetch
engine_start
engine_base_image
say "images"
build_images
check_files
wait "$references" || fail "no recording to compare with"
background=()
engine_stop
say "the engine without a route to other networks"
engine_start "$engine_cgroup"
[[ -z $(engine_run ip -n "$engine_cgroup" route show default) ]] || fail "the engine has a default route"
for part in "${parts[@]}"; do
  # shellcheck source=/dev/null
  source "$here/$part.sh"
done
say "container tests: passed"
