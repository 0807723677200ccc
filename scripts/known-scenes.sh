#!/usr/bin/env bash
# Trains the small scenes with known segments in tests/data/scenes, on which a test clicks (tests/program/known_scenes.rs).
# Run it after a change of the configuration's keys or of a file's format, and commit what it writes.
# usage: scripts/known-scenes.sh [VOLSEGGS]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
volseggs="$(realpath "${1:-target/release/volseggs}")"
out="$(realpath tests/data)/scenes"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"

for scene in jets vortices shells; do
    "$volseggs" prepare --synthetic "$scene" --dims 64 --series-steps 20 --size 96 --times 10 --views 10 \
        --test-views 12 --segment-views 0 --out "data/$scene"
    "$volseggs" train --data "data/$scene" --config quick --out "$scene" \
        --set init.points=2500 --set densify.budget=2500 --set model.resolution=12 --set model.levels=2 \
        --set model.time_knots=6 --set model.channels=8 --set model.width=16 --set model.sh_degree=2 \
        --set stages.warmup_steps=600 --set stages.joint_steps=1500
    "$volseggs" pack "$scene" --out packed
    # the dataset is not kept, so its place on this machine says nothing
    sed -i "s#\"dataset\": \"$work/#\"dataset\": \"/#" packed/run.json
    rm -rf "${out:?}/$scene"
    mkdir -p "$out"
    mv packed "$out/$scene"
done
