"""The families that VTK's volume ray caster draws."""

import numpy as np

from .scene import Event, Light, Material, Scene, Transfer, Volume, colour
from .shapes import Canvas, ball, direction, relax, ring, rotation, smooth, spread


def plumes(rng):
    """Swaying plumes, each an opaque core in a thin body in a translucent shell, with dark rims."""
    count = int(rng.integers(3, 6))
    bases = spread(rng, count, 0.46, 0.5, dims=2)
    radius, height = rng.uniform(0.16, 0.22, count), rng.uniform(0.5, 0.78, count)
    phase, sway = rng.uniform(0, 6.28, (2, count)), rng.uniform(0.06, 0.14, count)
    speed = rng.uniform(2.0, 4.5, count) * rng.choice([-1, 1], count)
    cuts = (0.14, 0.42, 0.72)

    def at(t, grid):
        canvas = Canvas(grid)
        for k, (bx, by) in enumerate(bases):
            top = -0.8 + 2 * height[k] * (0.55 + 0.45 * t)
            up = np.clip((grid.z + 0.85) / (top + 0.85), 0, 1.5)
            x = grid.x - bx - sway[k] * up * np.sin(3.0 * up + phase[0, k] + speed[k] * t)
            y = grid.y - by - sway[k] * up * np.cos(2.5 * up + phase[1, k] - 0.8 * speed[k] * t)
            far = (x * x + y * y) / (radius[k] * (0.55 + 0.55 * up)) ** 2
            far = far + 1.2 * (np.clip(grid.z - top + 0.25, 0, None) / 0.25) ** 2
            far = far + (np.clip(-0.7 - grid.z, 0, None) / 0.12) ** 2
            canvas.put(np.exp(-0.9 * far).astype(np.float32), k)
        layer = sum((canvas.values >= cut).astype(np.uint8) for cut in cuts)
        return Volume(canvas.values, np.where(layer > 0, 3 * canvas.owner + layer, 0).astype(np.uint8))

    hues = [(0.61, 0.36, 0.0), (0.50, 0.08, 0.92), (0.75, 0.14, 0.36)][int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    shell, body, core = (colour(h + rng.uniform(-0.02, 0.02), rng.uniform(0.65, 0.85), 0.9) for h in hues)
    thin, middle, full = rng.uniform(0.035, 0.06), rng.uniform(0.13, 0.24), rng.uniform(0.55, 0.8)
    transfer = Transfer(
        colors=[(0, *shell), (0.40, *shell), (0.44, *body), (0.70, *body), (0.74, *core), (1, *core)],
        opacity=[
            *((0, 0), (0.13, 0), (0.18, thin), (0.24, 0)),
            *((0.42, 0), (0.47, middle), (0.55, 0)),
            *((0.71, 0), (0.76, full), (1, full)),
        ],
    )
    names = [f"plume-{k + 1}-{part}" for k in range(count) for part in ("shell", "body", "core")]
    material = Material(rng.uniform(0.06, 0.14), 0.85, rng.uniform(0.2, 0.4), rng.uniform(15, 30))
    return Scene(names, at, material, Light.draw(rng), transfer)


def rings(rng):
    """Vortex rings: pairs that approach along their axis and merge, and weaker ones of another colour that drift past."""
    pairs, singles = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    centres = spread(rng, pairs + singles, 0.55, 0.72)
    axes = [direction(rng) for _ in centres]
    drift = [0.18 * direction(rng) for _ in centres]
    radius, tube = rng.uniform(0.25, 0.32, len(centres)), rng.uniform(0.08, 0.105, len(centres))
    turn = [(direction(rng), rng.uniform(-1.2, 1.2)) for _ in centres]
    meet = rng.uniform(0.35, 0.65, pairs)
    uneven = rng.uniform(0.8, 1.0, pairs)
    events = [Event(meet[k], 2 * k + 2, "ended", 2 * k + 1) for k in range(pairs)]
    names = [f"ring-{k + 1}" for k in range(2 * pairs)] + [f"weak-ring-{k + 1}" for k in range(singles)]
    weak = 0.62

    def at(t, grid):
        canvas = Canvas(grid)
        for k, centre in enumerate(centres):
            axis = rotation(turn[k][0], turn[k][1] * (t - 0.5)) @ axes[k]
            middle = np.clip(centre + drift[k] * (t - 0.5), -0.55, 0.55)
            if k >= pairs:
                own = weak * ring(grid, middle, axis, radius[k], tube[k])
                canvas.put(own, 2 * pairs + k - pairs + 1)
                continue
            # apart by the thickness of a tube when they meet, one ring some time after
            touch = 2.1 * tube[k]
            apart = touch + 0.34 * (1 - t / meet[k]) if t < meet[k] else touch * (1 - smooth(t, meet[k], meet[k] + 0.25))
            fused = smooth(t, meet[k] - 0.1, meet[k] + 0.25)
            other = radius[k] * (uneven[k] + (1 - uneven[k]) * fused)
            own = [
                ring(grid, middle - 0.5 * apart * axis, axis, radius[k], tube[k]),
                ring(grid, middle + 0.5 * apart * axis, axis, other, tube[k]),
            ]
            canvas.put_joined(own, [2 * k + 1, 2 * k + 2])
        labels = scene.known_as(t)[canvas.owner]
        return Volume(canvas.values, np.where(canvas.values >= 0.38, labels, 0).astype(np.uint8))

    hue = rng.uniform()
    strong = colour(hue, 0.75, 0.9)
    faint = colour(hue + rng.uniform(0.3, 0.7), 0.6, 0.75)
    transfer = Transfer(
        colors=[(0, *faint), (0.66, *faint), (0.70, *strong), (1, *strong)],
        opacity=[(0, 0), (0.38, 0), (0.44, 0.3), (0.58, rng.uniform(0.35, 0.5)), (0.66, 0), (0.72, 0.5), (1, 0.7)],
    )
    material = Material(rng.uniform(0.12, 0.25), rng.uniform(0.7, 0.85), rng.uniform(0.2, 0.5), rng.uniform(15, 40))
    scene = Scene(names, at, material, Light.draw(rng), transfer, events=events)
    return scene


def cells(rng):
    """Cells of one colour in a touching cluster; some divide."""
    mothers = int(rng.integers(3, 5))
    dividing = int(rng.integers(1, 4))
    first = spread(rng, mothers, 0.34, 0.45)
    size = rng.uniform(0.29, 0.36, mothers)
    start = rng.uniform(0.15, 0.5, dividing)
    axes = [direction(rng) for _ in range(dividing)]
    sway = [(direction(rng), rng.uniform(0, 6.28)) for _ in range(mothers)]
    names = [f"cell-{k + 1}" for k in range(mothers + dividing)]
    # a division takes this long, and the halves count as two cells when they are this far on their way
    duration, pinched = 0.32, 0.57
    events = [Event(start[k] + pinched * duration, mothers + k + 1, "began", k + 1) for k in range(dividing)]

    def at(t, grid):
        points, radii, labels, bound = [], [], [], set()
        for k in range(mothers):
            centre = first[k] + 0.05 * sway[k][0] * np.sin(4 * t + sway[k][1])
            if k >= dividing:
                points.append(centre)
                radii.append(size[k])
                labels.append([k + 1])
                continue
            done = smooth(t, start[k], start[k] + duration)
            small = size[k] * (1 - (1 - 0.5 ** (1 / 3)) * done)
            apart = 1.9 * small * done * axes[k]
            bound.add((len(points), len(points) + 1))
            points += [centre - 0.5 * apart, centre + 0.5 * apart]
            radii += [small, small]
            labels.append([k + 1, mothers + k + 1])
        points = relax(points, radii, bound)
        points -= points.mean(axis=0)
        canvas, n = Canvas(grid), 0
        for own in labels:
            parts = [ball(grid, points[n + i], radii[n + i]) for i in range(len(own))]
            canvas.put_joined(parts, own)
            n += len(own)
        own = scene.known_as(t)[canvas.owner]
        return Volume(canvas.values, np.where(canvas.values >= 0.35, own, 0).astype(np.uint8))

    inside = colour(rng.uniform(), rng.uniform(0.45, 0.75), 0.9)
    skin, full = rng.uniform(0.08, 0.3), rng.uniform(0.15, 0.6)
    transfer = Transfer(
        colors=[(0, *inside), (1, *inside)],
        opacity=[(0, 0), (0.35, 0), (0.45, skin), (0.7, skin), (0.9, full), (1, full)],
    )
    material = Material(rng.uniform(0.15, 0.3), rng.uniform(0.65, 0.85), rng.uniform(0.1, 0.4), rng.uniform(10, 40))
    scene = Scene(names, at, material, Light.draw(rng), transfer, events=events)
    return scene


def drops(rng):
    """Drops of one colour that fall and merge beside or through a translucent film."""
    pairs, singles = int(rng.integers(1, 3)), int(rng.integers(2, 4))
    places = spread(rng, pairs + singles, 0.58, 0.42, dims=2)
    size = rng.uniform(0.12, 0.17, (pairs + singles, 2))
    # from these heights down by these lengths
    high, fall = rng.uniform(0.1, 0.75, pairs + singles), rng.uniform(0.4, 0.8, pairs + singles)
    # the upper one of a pair, this far above at first, begins inside of the volume
    ahead = 0.36
    high[:pairs] = np.minimum(high[:pairs], 0.92 - ahead - 2 * size[:pairs].sum(axis=1))
    meet = rng.uniform(0.35, 0.65, pairs)
    aside = rng.uniform(-0.08, 0.08, (pairs, 2))
    events = [Event(meet[k], 2 * k + 2, "ended", 2 * k + 1) for k in range(pairs)]
    names = [f"drop-{k + 1}" for k in range(2 * pairs + singles)] + ["film"]
    upright, phase, waves = rng.random() < 0.5, rng.uniform(0, 6.28), rng.uniform(3, 5)
    film_at = rng.uniform(-0.2, 0.2)

    def film(t, grid):
        u, v, w = (grid.y, grid.z, grid.x) if upright else (grid.x, grid.y, grid.z)
        off = w - film_at - 0.07 * np.sin(waves * u + phase + 2 * t) - 0.07 * np.cos(waves * v - phase + 1.5 * t)
        edge = np.clip((np.maximum(np.abs(u), np.abs(v)) - 0.8) / 0.06, 0, None)
        return 0.2 * np.exp(-((off / 0.045) ** 2) - edge**2)

    def at(t, grid):
        canvas = Canvas(grid)
        for k, (x, y) in enumerate(places):
            z = high[k] - fall[k] * (0.4 * t + 0.6 * t * t)
            low = np.array([x, y, max(z, -0.78)])
            if k >= pairs:
                canvas.put(ball(grid, low, size[k, 0]), 2 * pairs + k - pairs + 1)
                continue
            big = (size[k] ** 3).sum() ** (1 / 3)
            fused = smooth(t, meet[k], meet[k] + 0.22)
            touch = 0.98 * size[k].sum()
            apart = touch + ahead * (1 - t / meet[k]) if t < meet[k] else touch * (1 - fused)
            upper = low + np.array([*(aside[k] * apart), apart])
            radii = size[k] + (big - size[k]) * fused
            canvas.put_joined([ball(grid, low, radii[0]), ball(grid, upper, radii[1])], [2 * k + 1, 2 * k + 2])
        canvas.put(film(t, grid).astype(np.float32), len(names))
        own = scene.known_as(t)[canvas.owner]
        cut = np.where(own == len(names), 0.13, 0.35)
        return Volume(canvas.values, np.where(canvas.values >= cut, own, 0).astype(np.uint8))

    hue = rng.uniform()
    liquid, sheet = colour(hue, 0.75, 0.9), colour(hue + rng.uniform(0.25, 0.75), 0.65, 0.85)
    thin, full = rng.uniform(0.05, 0.1), rng.uniform(0.3, 0.7)
    transfer = Transfer(
        colors=[(0, *sheet), (0.28, *sheet), (0.32, *liquid), (1, *liquid)],
        opacity=[(0, 0), (0.13, 0), (0.17, thin), (0.24, 0), (0.36, 0), (0.48, full), (1, full)],
    )
    material = Material(rng.uniform(0.12, 0.25), rng.uniform(0.7, 0.85), rng.uniform(0.2, 0.5), rng.uniform(15, 40))
    scene = Scene(names, at, material, Light.draw(rng), transfer, events=events)
    return scene
