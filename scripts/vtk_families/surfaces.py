"""The family of contour surfaces: nested bodies as ParaView's users draw them, with Phong's shading."""

import numpy as np

from .scene import Light, Material, Scene, Surface, colour
from .shapes import direction, frame, rotation, smooth, spread


def surfaces(rng):
    """Opaque bodies in a translucent bumpy hull, some in a translucent bubble of their own, all of it turning."""
    count = int(rng.integers(3, 6))
    centres = spread(rng, count, 0.45, 0.5)
    radii = rng.uniform(0.13, 0.19, count)
    kinds = rng.choice(["ball", "ellipsoid", "box", "ring"], count)
    frames = [frame(direction(rng)) for _ in range(count)]
    stretch = rng.uniform(0.7, 1.25, (count, 3))
    bubbled = rng.permutation(count)[: int(rng.integers(1, 3))]
    axis, turns = direction(rng), rng.uniform(0.8, 2.2) * rng.choice([-1, 1])
    spin = [(direction(rng), rng.uniform(-2.5, 2.5)) for _ in range(count)]
    wander = [0.06 * direction(rng) for _ in range(count)]
    bumps = [(direction(rng) * rng.uniform(4, 7), rng.uniform(0, 6.28)) for _ in range(4)]
    breath = rng.uniform(0.0, 0.06)
    names = [f"body-{k + 1}" for k in range(count)]
    names += [f"bubble-{k + 1}" for k in range(len(bubbled))] + ["hull"]

    def hull(t, whole, grid):
        x, y, z = grid.turned((0, 0, 0), whole)
        away = np.sqrt(x * x + y * y + z * z) + 1e-6
        wavy = sum(np.sin((w[0] * x + w[1] * y + w[2] * z) / away * 0.6 + p) for w, p in bumps)
        return 0.8 + breath * np.sin(6.28 * t) + 0.03 * wavy - away

    def body(k, t, whole, grid):
        centre = whole @ (centres[k] + wander[k] * np.sin(3 * t + k))
        own = whole @ rotation(spin[k][0], spin[k][1] * t) @ frames[k]
        p = [c / s for c, s in zip(grid.turned(centre, own), np.ones(3) if kinds[k] == "ball" else stretch[k])]
        if kinds[k] == "box":
            return radii[k] - (p[0] ** 6 + p[1] ** 6 + p[2] ** 6) ** (1 / 6)
        if kinds[k] == "ring":
            return 0.36 * radii[k] - np.sqrt((np.sqrt(p[0] ** 2 + p[1] ** 2) - 0.8 * radii[k]) ** 2 + p[2] ** 2)
        return radii[k] - np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)

    def bubble(k, t, whole, grid):
        x, y, z = grid.around(whole @ (centres[k] + wander[k] * np.sin(3 * t + k)))
        reach = (1.35 if kinds[k] == "ball" else 1.6) * radii[k]
        return reach * (1 - 0.08 * smooth(np.sin(5 * t), -1, 1)) - np.sqrt(x * x + y * y + z * z)

    def at(t, grid):
        whole = rotation(axis, turns * t)
        fields = [body(k, t, whole, grid) for k in range(count)]
        fields += [bubble(k, t, whole, grid) for k in bubbled] + [hull(t, whole, grid)]
        return {k + 1: np.ascontiguousarray(field, np.float32) for k, field in enumerate(fields)}

    hue, looks = rng.uniform(), {}
    for k in range(count):
        # neighbours in number may share a colour
        shade = hue + 0.5 * (k // 2) / max(1, (count - 1) // 2)
        looks[k + 1] = Surface(colour(shade, rng.uniform(0.6, 0.8), rng.uniform(0.75, 0.95)), 1.0)
    for k in range(len(bubbled)):
        looks[count + k + 1] = Surface(colour(hue + 0.3, 0.5, 0.9), rng.uniform(0.25, 0.4))
    looks[len(names)] = Surface(colour(hue + 0.65, 0.4, 0.85), rng.uniform(0.15, 0.28))
    material = Material(rng.uniform(0.08, 0.2), rng.uniform(0.75, 0.9), rng.uniform(0.2, 0.6), rng.uniform(15, 50))
    return Scene(names, at, material, Light.draw(rng), surfaces=looks)
