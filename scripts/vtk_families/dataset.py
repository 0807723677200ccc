"""The cameras and the folder of a dataset, with the ground truth of its cells.

```text
transforms_{train,test}.json   cameras and times
{train,test}/r_N.png           pictures
labels/{train,test}/r_N.png    the cell with the largest share of each pixel, grey level = id
segments/NAME/r_N_step_S.png   the cell alone, as VTK draws it without the others; ..._mask.png its silhouette
volumes/step_S.safetensors     ids and opacities in space
segments.json                  lists all of it; merges and divisions
scene.json                     how it was made
```
"""

import json
import math
import shutil
import sys
import time as clock
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import vtk

from .drawing import drawer_of
from .files import straight, write_png, write_truth_volume
from .shapes import Grid
from .truth import in_space

# As `volseggs prepare` has them: distance of the cameras, their field of view, the side of the volume (half of what they
# see at that distance), the least alpha of a pixel in a mask, and the number of times that have it.
RADIUS, FOV, MASK_ALPHA, TRUTH_TIMES = 4.0311, math.radians(30), 0.05, 5
SIDE = RADIUS * math.tan(FOV / 2)


@dataclass
class Layout:
    """How many pictures of what size. Training sees every other step, the test views all of them."""

    size: int = 240
    times: int = 15
    views: int = 14
    test_views: int = 40
    segment_views: int = 10
    voxels: int = 96

    @property
    def steps(self):
        return max(1, 2 * self.times - 1)

    def time(self, step):
        return step / max(1, self.steps - 1)


@dataclass
class View:
    pose: np.ndarray
    step: int


def look_at(eye):
    """Camera to world, +x right, +y up, looking along -z at the origin, z upwards."""
    back = eye / np.linalg.norm(eye)
    right = np.cross([0, 0, 1], back)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0, 0])
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return pose


def training_views(layout, seed):
    """A Fibonacci sphere, dealt to the times at random."""
    n = layout.times * layout.views
    h = (2 * np.arange(n) + 1) / n - 1
    turn = (3 - math.sqrt(5)) * math.pi * np.arange(n)
    s = np.sqrt(1 - h * h)
    eyes = RADIUS * np.stack([-s * np.cos(turn), h, s * np.sin(turn)], axis=1)
    steps = 2 * np.random.default_rng([seed, 1]).permutation(np.arange(n) % layout.times)
    return [View(look_at(eye), int(step)) for eye, step in zip(eyes, steps)]


def test_views(layout):
    """A spiral from pole to pole, once around, while time runs through all steps."""
    last = max(1, layout.test_views - 1)
    found = []
    for i in range(layout.test_views):
        up = np.clip(math.pi * i / last - math.pi / 2, -math.pi / 2 + 1.75e-4, math.pi / 2 - 1.75e-4)
        round_ = 2 * math.pi * i / last - math.pi / 2
        eye = RADIUS * np.array([math.cos(up) * math.cos(round_), math.cos(up) * math.sin(round_), math.sin(up)])
        found.append(View(look_at(eye), i * (layout.steps - 1) // last))
    return found


def even(count, all_of):
    """`count` of the indices below `all_of`, evenly, with the first and the last."""
    count = min(count, all_of)
    return sorted({k * (all_of - 1) // max(1, count - 1) for k in range(count)})


def shows(pixels):
    """Where a picture's bytes show anything."""
    return pixels[..., 3] >= MASK_ALPHA * 255


def transforms(layout, split, views):
    frames = [
        {"file_path": f"./{split}/r_{i}", "transform_matrix": view.pose.tolist(), "time": layout.time(view.step)}
        for i, view in enumerate(views)
    ]
    return {"camera_angle_x": FOV, "w": layout.size, "h": layout.size, "frames": frames}


class Writer:
    """Draws a scene into a folder, step by step."""

    def __init__(self, root, scene, layout, seed):
        self.root, self.scene, self.layout = root, scene, layout
        self.splits = {"train": training_views(layout, seed), "test": test_views(layout)}
        chosen = even(layout.segment_views, layout.test_views) if layout.segment_views else []
        self.alone = [(i, self.splits["test"][i]) for i in chosen]
        self.truth_steps = [2 * k for k in even(TRUTH_TIMES, layout.times)] if self.alone else []
        self.frames = {k + 1: [] for k in range(len(scene.names))}
        self.volumes = []
        self.grid = Grid(layout.voxels)
        self.drawer = drawer_of(scene, layout.size, math.degrees(FOV), SIDE, layout.voxels)

    def write(self, record):
        for split, views in self.splits.items():
            (self.root / split).mkdir()
            (self.root / "labels" / split).mkdir(parents=True)
            self.json(f"transforms_{split}.json", transforms(self.layout, split, views))
        (self.root / "volumes").mkdir()
        for name in self.scene.names:
            (self.root / "segments" / name).mkdir(parents=True)
        for step in range(self.layout.steps):
            self.step(step)
        self.json("segments.json", self.segments())
        self.json("scene.json", {**record, "vtk": vtk.vtkVersion.GetVTKVersion(), "opengl": self.drawer.graphics()})

    def json(self, name, content):
        (self.root / name).write_text(json.dumps(content, indent=1) + "\n")

    def step(self, step):
        views = [(split, i, v) for split, all_of in self.splits.items() for i, v in enumerate(all_of) if v.step == step]
        if not views and step not in self.truth_steps:
            return
        time = self.layout.time(step)
        shown = self.scene.at(time, self.grid)
        self.drawer.show(shown)
        # a cell that does not exist at this time has no voxel, or is another's
        known = self.scene.known_as(time)
        present = [k for k in range(1, len(known)) if known[k] == k]
        for split, i, view in views:
            self.view(split, i, view, present)
        if step in self.truth_steps:
            self.cells(step, time, present)
            name = f"volumes/step_{step}.safetensors"
            write_truth_volume(self.root / name, time, SIDE, *in_space(self.scene, shown, SIDE))
            self.volumes.append({"time": time, "file": f"./{name}"})

    def view(self, split, i, view, present):
        self.drawer.aim(view.pose)
        picture = self.drawer.picture()
        pixels = straight(picture)
        write_png(self.root / split / f"r_{i}.png", pixels)
        shares = self.drawer.shares(present)
        # what belongs to no cell competes as well
        rest = picture[..., 3] - shares.sum(axis=0)
        largest = np.argmax(np.concatenate([rest[None], shares]), axis=0)
        ids = np.array([0, *present])[largest]
        write_png(self.root / "labels" / split / f"r_{i}.png", np.where(shows(pixels), ids, 0))

    def cells(self, step, time, present):
        nothing = np.zeros((self.layout.size, self.layout.size, 4), np.float32)
        for segment, name in enumerate(self.scene.names, 1):
            if segment in present:
                self.drawer.pick(segment)
            for i, view in self.alone:
                self.drawer.aim(view.pose)
                pixels = straight(self.drawer.picture() if segment in present else nothing)
                mask = shows(pixels)
                path = f"segments/{name}/r_{i}_step_{step}"
                write_png(self.root / f"{path}.png", pixels)
                write_png(self.root / f"{path}_mask.png", np.where(mask, 255, 0))
                self.frames[segment].append(
                    {
                        "file_path": f"./{path}.png",
                        "mask_path": f"./{path}_mask.png",
                        "transform_matrix": view.pose.tolist(),
                        "time": time,
                        "pixels": int(mask.sum()),
                    }
                )
        self.drawer.unpick()

    def segments(self):
        entries = [{"id": k, "name": self.scene.names[k - 1], "frames": frames} for k, frames in self.frames.items()]
        return {
            "format": 1,
            "source": "labels",
            "mask_alpha": MASK_ALPHA,
            "camera_angle_x": FOV,
            "size": [self.layout.size] * 2,
            "label_images": ["./labels/train", "./labels/test"],
            "segments": entries,
            "volumes": self.volumes,
            "lineage": self.lineage(),
        }

    def lineage(self):
        """The events, each at the first step at which it has happened."""
        times = [self.layout.time(step) for step in range(self.layout.steps)]
        found = []
        for event in sorted(self.scene.events, key=lambda e: e.time):
            first = next((t for t in times if t >= event.time), None)
            if first is not None:
                found.append({"time": first, "segment": event.segment, "change": event.change, "other": event.other})
        return found


def write_dataset(out, scene, layout, family, seed):
    """Writes the dataset, which appears at `out` once it is whole. Returns the seconds it took."""
    started = clock.perf_counter()
    out = Path(out)
    if out.exists():
        sys.exit(f"{out}: already exists; choose another folder with --out")
    building = out.with_name(f".{out.name}.part")
    shutil.rmtree(building, ignore_errors=True)
    building.mkdir(parents=True)
    record = {"family": family, "seed": seed, **vars(layout), "cells": scene.names}
    Writer(building, scene, layout, seed).write(record)
    building.rename(out)
    return clock.perf_counter() - started
