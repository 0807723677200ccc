"""What a family draws from a seed."""

import colorsys
from dataclasses import dataclass, field
from typing import Callable

import numpy as np


@dataclass
class Light:
    """A headlight at the eye and, with `key` above 0, a lamp that is fixed in the scene."""

    head: float = 1.0
    key: float = 0.0
    direction: tuple = (0.0, 0.0, 1.0)

    @staticmethod
    def draw(rng):
        if rng.random() < 0.5:
            return Light()
        towards = rng.normal(size=3)
        return Light(head=0.7, key=0.5, direction=tuple(towards / np.linalg.norm(towards)))


@dataclass
class Material:
    """The numbers of VTK's lighting."""

    ambient: float
    diffuse: float
    specular: float
    power: float


@dataclass
class Transfer:
    """A volume's colours and opacities. Opacities accrue per `unit`, a fraction of the volume's side."""

    colors: list
    opacity: list
    unit: float = 0.01


@dataclass
class Surface:
    """A contour surface's colour and opacity."""

    color: tuple
    opacity: float


@dataclass
class Volume:
    """One step: a field and the cell of each voxel, `[z, y, x]`."""

    values: np.ndarray
    ids: np.ndarray


@dataclass
class Event:
    """A cell that `began` (split off `other`) or `ended` (merged into `other`)."""

    time: float
    segment: int
    change: str
    other: int


@dataclass
class Scene:
    """`at(time, grid)` gives a `Volume`; with `surfaces`, instead a field for each cell, whose contour at 0 is drawn."""

    names: list
    at: Callable
    material: Material
    light: Light
    transfer: Transfer = None
    surfaces: dict = None
    events: list = field(default_factory=list)

    def known_as(self, time):
        """For each id, from 0, the one that holds its material at `time`: parts of one body share an id."""
        ids = np.arange(len(self.names) + 1)
        for event in self.events:
            if (time >= event.time) == (event.change == "ended"):
                ids[ids == event.segment] = ids[event.other]
        return ids


def colour(hue, saturation, value):
    return colorsys.hsv_to_rgb(hue % 1.0, saturation, value)
