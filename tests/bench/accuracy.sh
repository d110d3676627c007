#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Accuracy against simulated truth over several seeds, each with another path: the figures of core/experiments/RESULTS.md.
#   tests/bench/accuracy.sh [--objects "cube book"] [--seeds "1 2 3 4 5"] [--speed FACTOR] [--camera evk4|vga]
#     [--estimators "mixture static-mm"]    any of evpose replay --estimator
# Needs a release build. Recordings of 5 s with 10 % noise, from the true first pose. About a minute for each.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
evpose=build/release/client/cli/evpose
[[ -x $evpose ]] || { echo "$0: build first: cmake --preset release && cmake --build --preset release" >&2; exit 1; }

objects=cube seeds="1 2 3 4 5" speed=1 camera=evk4 estimators="mixture static-mm"
while (($#)); do
  case "$1" in
    --objects) objects=${2:?$1 needs a value} ;;
    --seeds) seeds=${2:?$1 needs a value} ;;
    --speed) speed=${2:?$1 needs a value} ;;
    --camera) camera=${2:?$1 needs a value} ;;
    --estimators) estimators=${2:?$1 needs a value} ;;
    *) sed -n '3,6s/^# //p' "$0" >&2; exit 2 ;;
  esac
  shift 2
done

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for object in $objects; do
  for seed in $seeds; do
    scene=$work/scene
    "$evpose" simulate --object "$object" --camera "$camera" --duration 5 --noise 0.1 --speed "$speed" --seed "$seed" \
      --out "$scene" 2>/dev/null >/dev/null
    inputs=(--model "$scene/model.obj" --camera "$scene/camera.yaml")
    first_pose=$(head -n 1 "$scene/truth.tum" | cut -d ' ' -f 2-)
    estimates=()
    for estimator in $estimators; do
      "$evpose" replay "$scene/recording.raw" "${inputs[@]}" --init-pose "$first_pose" --estimator "$estimator" \
        --out "$work/$estimator.tum" 2>"$work/errors" >"$work/$estimator.txt" ||
        { echo "$object, seed $seed, $estimator: no poses: $(tail -n 1 "$work/errors")"; continue; }
      estimates+=(--estimate "$estimator=$work/$estimator.tum")
    done
    echo "== $object, $camera, speed x$speed, seed $seed: $(tail -n 1 "$work/${estimators%% *}.txt")"
    "$evpose" evaluate --truth "$scene/truth.tum" "${inputs[@]}" "${estimates[@]}" || true
    rm -rf "$scene"
  done
done
