"""Measured volumes of known shapes: makes each as a volume, prepares and trains it, and tracks its segment.

    python benches/places.py target/release/volseggs OUT [SHAPE...]

It needs numpy. Shapes are in millimetres, in a box of 81 mm; what is printed is the measured volume over the true one at
each time.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

DIMS = (54, 45, 36)
SIDES = (1.5, 1.8, 2.25)
SETTINGS = (
    "init.points=1500 densify.budget=1500 model.resolution=16 model.channels=8 model.width=32 "
    "stages.warmup_steps=100 stages.joint_steps={steps} optim.warmup_decay_steps={steps} "
    "output.eval_every=5000 output.checkpoint_every=5000"
)
# a rotation, so that no face lies along the axes of the voxels
TURN = np.array([[0.8, -0.6, 0.0], [0.48, 0.64, -0.6], [0.36, 0.48, 0.8]])


def ball(radius):
    return lambda p, t: radius - np.linalg.norm(p, axis=0)


def shell(outer, inner):
    def depth(p, t):
        r = np.linalg.norm(p, axis=0)
        return np.minimum(outer - r, r - inner)

    return depth


def turned(depth):
    return lambda p, t: depth(*np.tensordot(TURN, p, 1))


def box(*half):
    return turned(lambda *p: np.min([h - abs(v) for h, v in zip(half, p)], axis=0))


# depth below the surface in mm at places [3, ...] and a time in [0, 1]; opacity per 0.57 mm; times; joint steps
SHAPES = {
    "ball13": (ball(13), 0.8, 2, 600),
    "ball20": (ball(20), 0.8, 2, 600),
    "doubling": (lambda p, t: 13 * (1 + t) ** (1 / 3) - np.linalg.norm(p, axis=0), 0.8, 8, 600),
    "doubling-long": (lambda p, t: 13 * (1 + t) ** (1 / 3) - np.linalg.norm(p, axis=0), 0.8, 8, 2500),
    "torus": (turned(lambda u, v, w: 7 - np.hypot(np.hypot(u, v) - 19, w)), 0.8, 2, 600),
    "box": (box(18, 14, 10), 0.8, 2, 600),
    "plate": (box(22, 22, 4), 0.8, 2, 600),
    "cup": (turned(lambda u, v, w: np.minimum(shell(22, 15)(np.array([u, v, w]), 0), 5 - w)), 0.8, 2, 600),
    "tube": (
        turned(lambda u, v, w: np.min([16 - np.hypot(u, v), np.hypot(u, v) - 9, 25 - abs(w)], axis=0)),
        0.8,
        2,
        600,
    ),
    "hollow-0.02": (shell(22, 15), 0.02, 2, 600),
    "hollow-0.08": (shell(22, 15), 0.08, 2, 600),
    "thin-0.02": (ball(18), 0.02, 2, 600),
    "thin-0.08": (ball(18), 0.08, 2, 600),
}


def write(path, values):
    extent = [s * (n - 1) for s, n in zip(SIDES, DIMS)]
    header = (
        "NRRD0005\ntype: float\ndimension: 3\nspace: left-posterior-superior\n"
        f"sizes: {DIMS[0]} {DIMS[1]} {DIMS[2]}\n"
        f"space directions: ({SIDES[0]},0,0) (0,{SIDES[1]},0) (0,0,{SIDES[2]})\n"
        f"space origin: ({-extent[0] / 2},{-extent[1] / 2},{-extent[2] / 2})\n"
        'space units: "mm" "mm" "mm"\nendian: little\nencoding: raw\n\n'
    )
    path.write_bytes(header.encode() + values.astype("<f4").transpose(2, 1, 0).tobytes())


def measure(program, folder, depth, opacity, times, steps):
    def run(*arguments):
        said = subprocess.run([program, *arguments], cwd=folder, capture_output=True, text=True)
        if said.returncode:
            sys.exit(said.stderr)
        return said.stdout

    folder.mkdir(parents=True)
    axes = [s * (np.arange(n) - 0.5 * (n - 1)) for n, s in zip(DIMS, SIDES)]
    places = np.array(np.meshgrid(*axes, indexing="ij"))
    all_times = np.linspace(0, 1, times)
    for i, time in enumerate(all_times):
        # the distance to the surface as a value around one half, over 4 mm
        write(folder / f"v{i}.nrrd", np.clip(0.5 + depth(places, time) / 4, 0, 1))
    (folder / "tf.toml").write_text(
        'name = "shape"\nrange = [0.0, 1.0]\nunit_length = 0.01\ncolors = [[0, "#d7263d"], [1, "#d7263d"]]\n'
        f"opacity = [[0, 0], [0.49, 0], [0.51, {opacity}], [1, {opacity}]]\n"
    )
    run(
        *"prepare --volume v*.nrrd --transfer-function tf.toml --out data --size 64 --side 1.4".split(),
        *f"--views 10 --test-views 4 --times {times}".split(),
    )
    settings = [word for s in SETTINGS.format(steps=steps).split() for word in ("--set", s)]
    run("train", "--data", "data", "--out", "run", "--config", "quick", *settings)
    run("segment", "coarse", "run")
    listed = json.loads(run("segment", "list", "run", "--json"))
    body = listed["segments"][0]["name"]
    at = [word for t in all_times for word in ("--at", str(t))]
    rows = json.loads(run("track", "run", "--segment", body, "--json", *at))[0]["statistics"]
    fine = np.array(np.meshgrid(*[np.linspace(-45, 45, 181)] * 3, indexing="ij"))
    true = [(depth(fine, time) > 0).sum() * 0.5**3 for time in all_times]
    return [round(float(row["volume"] / volume), 3) for row, volume in zip(rows, true)]


def main():
    program, out = str(Path(sys.argv[1]).resolve()), Path(sys.argv[2])
    for name in sys.argv[3:] or SHAPES:
        print(name, measure(program, out / name, *SHAPES[name]), flush=True)


main()
