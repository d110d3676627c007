#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Accuracy of one calibrated sensor at several event rates: with low thresholds its edges alone produce about 5 Mev/s. Noise in every pixel,
# a flickering lamp or fast motion raise that to tens of Mev/s.
#   tests/bench/event_rate.sh [--objects "cube book"] [--seeds "31 32 33"] [--json]
# --json prints a JSON object per line. Needs a release build. Recordings of 0.5 s, from the true first pose. About 20 s for each
# object and seed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
evpose=build/release/client/cli/evpose
[[ -x $evpose ]] || { echo "$0: build first: cmake --preset release && cmake --build --preset release" >&2; exit 1; }

objects="cube cuboid book spacecraft" seeds="31 32 33" is_json=false
while (($#)); do
  case "$1" in
    --objects) objects=${2:?$1 needs a value}; shift ;;
    --seeds) seeds=${2:?$1 needs a value}; shift ;;
    --json) is_json=true ;;
    *) sed -n '3,7s/^# //p' "$0" >&2; exit 2 ;;
  esac
  shift
done

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
simulate() {  # directory, options
  "$evpose" simulate --threshold 0.03 --duration 0.5 --out "$@" >/dev/null 2>&1
}

# The calibration uses other objects, paths and pixels than the measurement.
simulate "$work/1" --object cube --speed 4 --seed 11
simulate "$work/2" --object cube --speed 4 --seed 12
simulate "$work/3" --object cuboid --seed 21
simulate "$work/4" --object cuboid --seed 22
"$evpose" calibrate "$work"/[1-4]/recording.raw --truth "$work"/[1-4]/truth.tum --model "$work"/[1-4]/model.obj \
  --camera "$work/1/camera.yaml" --out "$work/sensor.yaml" >&2
rm -rf "$work"/[1-4]

declare -A conditions=(
  [alone]="" [noise]="--background-activity 47" [flicker]="--flicker 0.15" [haste]="--speed 8")
for object in $objects; do
  for seed in $seeds; do
    for condition in alone noise flicker haste; do
      scene=$work/scene
      # shellcheck disable=SC2086
      simulate "$scene" --object "$object" --seed "$seed" ${conditions[$condition]}
      inputs=(--model "$scene/model.obj" --camera "$scene/camera.yaml")
      if ! "$evpose" replay "$scene/recording.raw" "${inputs[@]}" --sensor "$work/sensor.yaml" --out "$work/poses.tum" \
        --init-pose "$(head -n 1 "$scene/truth.tum" | cut -d ' ' -f 2-)" >/dev/null 2>"$work/errors"; then
        echo "$object, seed $seed, $condition: no poses: $(tail -n 1 "$work/errors")" >&2
        rm -rf "$scene"
        continue
      fi
      rate=$("$evpose" info "$scene/recording.raw" | grep -oE '[0-9.]+ Mev/s')
      if $is_json; then
        "$evpose" evaluate --truth "$scene/truth.tum" "${inputs[@]}" --symmetric --estimate "$condition=$work/poses.tum" --json |
          python3 -c 'import json, sys; print(json.dumps({"object": sys.argv[1], "seed": int(sys.argv[2]), "condition": sys.argv[3],
            "mev_per_s": float(sys.argv[4]), "position_rmse_of_depth": json.load(sys.stdin)["estimates"][0]["position_rmse_of_depth"]}))' \
            "$object" "$seed" "$condition" "${rate% *}"
        rm -rf "$scene"
        continue
      fi
      name="$condition, ${rate% *}"
      "$evpose" evaluate --truth "$scene/truth.tum" "${inputs[@]}" --symmetric --estimate "$name=$work/poses.tum" \
        >"$work/table" || { echo "$name: no poses"; continue; }
      [[ $condition != alone ]] || printf '== %s, seed %s; Mev/s\n%s\n' "$object" "$seed" "$(head -n 2 "$work/table")"
      tail -n 1 "$work/table"
      rm -rf "$scene"
    done
  done
done
