#!/usr/bin/env python3
"""Writes a dataset that VTK draws, with its own shading: a time-varying scene with known cells, made from a seed.

The dataset has pictures, cameras and the ground truth of every cell: `volseggs train --data DATASET` reads it, and
`volseggs eval RUN --segments` measures segmentation on it. The same FAMILY:SEED gives the same scene on any machine;
pixels depend on VTK's version and on OpenGL.

families:
  vtk-plumes    swaying plumes, each an opaque core in a thin body in a translucent shell, with dark rims
  vtk-rings     vortex rings that approach and merge, weaker ones that drift past
  vtk-cells     cells of one colour that touch and divide
  vtk-drops     drops of one colour that fall and merge, beside or through a translucent film
  vtk-surfaces  contour surfaces: opaque bodies in translucent bubbles in a translucent hull, turning

examples:
  scripts/vtk_scenes.py vtk-plumes:0 --out data/vtk-plumes-0
  scripts/vtk_scenes.py vtk-cells:3 --out data/small --size 64 --times 4 --views 4 --test-views 6 --segment-views 2
  scripts/vtk_scenes.py vtk-rings:1 --preview rings.png     # times across, views down; no dataset

Needs Python 3.11 with numpy and vtk (tried: 9.7.2), and EGL or OSMesa (Debian: libosmesa6) for drawing without a
screen.
"""

import argparse
import math
import sys
import zlib
from pathlib import Path

try:
    import numpy as np
    import vtk
except ImportError as error:
    sys.exit(f"{sys.argv[0]}: needs the Python packages numpy and vtk: {error}")

# the scripts' folder stays as it is
sys.dont_write_bytecode = True

from vtk_families import dataset, surfaces, volumes
from vtk_families.drawing import drawer_of
from vtk_families.files import write_png
from vtk_families.shapes import Grid

FAMILIES = {
    "vtk-plumes": volumes.plumes,
    "vtk-rings": volumes.rings,
    "vtk-cells": volumes.cells,
    "vtk-drops": volumes.drops,
    "vtk-surfaces": surfaces.surfaces,
}


def scene_of(text):
    """A family and a seed from `FAMILY:SEED`."""
    family, _, seed = text.partition(":")
    if family not in FAMILIES or not seed.isdecimal():
        raise argparse.ArgumentTypeError(f"`{text}` is not FAMILY:SEED with one of {', '.join(FAMILIES)}")
    return family, int(seed)


def make(family, seed):
    return FAMILIES[family](np.random.default_rng([zlib.crc32(family.encode()), seed]))


def preview(path, scene, layout):
    """A sheet over white: five times across; two views, closer than those of a dataset, and the cells in the first."""
    drawer = drawer_of(scene, layout.size, 0.65 * math.degrees(dataset.FOV), dataset.SIDE, layout.voxels)
    eyes = [np.array([0.2, -0.95, 0.35]), np.array([0.8, 0.5, -0.3])]
    poses = [dataset.look_at(dataset.RADIUS * eye / np.linalg.norm(eye)) for eye in eyes]
    colours = np.vstack([[1, 1, 1], np.random.default_rng(0).uniform(0.1, 0.95, (len(scene.names), 3))])
    columns = []
    for time in np.linspace(0, 1, 5):
        drawer.show(scene.at(time, Grid(layout.voxels)))
        column = []
        for pose in poses:
            drawer.aim(pose)
            picture = drawer.picture()
            column.append(picture[..., :3] + 1 - picture[..., 3:])
        drawer.aim(poses[0])
        shares = drawer.shares(list(range(1, len(scene.names) + 1)))
        ids = np.where(shares.sum(axis=0) >= dataset.MASK_ALPHA, 1 + np.argmax(shares, axis=0), 0)
        column.append(colours[ids])
        columns.append(np.concatenate(column))
    sheet = np.concatenate(columns, axis=1)
    opaque = np.concatenate([sheet, np.ones((*sheet.shape[:2], 1))], axis=-1)
    write_png(Path(path), (np.clip(opaque, 0, 1) * 255 + 0.5).astype(np.uint8))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", metavar="FAMILY:SEED", type=scene_of)
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("--out", metavar="DATASET", help="folder to write; must not exist")
    target.add_argument("--preview", metavar="PNG", help="write a sheet of pictures instead")
    usual = dataset.Layout()
    numbers = {
        "size": "width and height of the pictures",
        "times": "times that training sees; the test views see those between as well",
        "views": "training views of each time",
        "test_views": "test views, along a spiral",
        "segment_views": "test views in which each cell is drawn alone, at five times; 0 for no truth in space",
        "voxels": "voxels along each side of the volume",
    }
    for name, text in numbers.items():
        flag = "--" + name.replace("_", "-")
        parser.add_argument(flag, type=int, metavar="N", default=getattr(usual, name), help=f"{text} (%(default)s)")
    arguments = parser.parse_args()
    layout = dataset.Layout(**{name: getattr(arguments, name) for name in numbers})
    least = {"size": 8, "times": 2, "views": 1, "test_views": 2, "segment_views": 0, "voxels": 16}
    for name, smallest in least.items():
        if getattr(layout, name) < smallest:
            parser.error(f"--{name.replace('_', '-')}: must be at least {smallest}")
    family, seed = arguments.scene
    scene = make(family, seed)
    # warnings about a missing X server are no news
    vtk.vtkObject.GlobalWarningDisplayOff()
    if arguments.preview:
        preview(arguments.preview, scene, layout)
        return
    seconds = dataset.write_dataset(arguments.out, scene, layout, family, seed)
    pictures = layout.times * layout.views + layout.test_views
    print(f"{arguments.out}: {len(scene.names)} cells, {pictures} pictures, {seconds:.0f} s")


if __name__ == "__main__":
    main()
