"""Fields of bodies on a grid, and how bodies move, merge and divide. Coordinates in [-1, 1], arrays `[z, y, x]`."""

import numpy as np


class Grid:
    """The coordinates of `size` voxels along each side."""

    def __init__(self, size):
        self.size = size
        line = np.linspace(-1, 1, size, dtype=np.float32)
        self.z, self.y, self.x = np.meshgrid(line, line, line, indexing="ij", sparse=True)
        self.shape = (size,) * 3

    def around(self, centre):
        """The three coordinates relative to a point."""
        return self.x - np.float32(centre[0]), self.y - np.float32(centre[1]), self.z - np.float32(centre[2])

    def turned(self, centre, rotation):
        """The same along the axes of a body, which are the columns of `rotation`."""
        x, y, z = self.around(centre)
        return [r[0] * x + r[1] * y + r[2] * z for r in rotation.T.astype(np.float32)]


def smooth(t, start=0.0, end=1.0):
    """From 0 at `start` to 1 at `end`, smoothly."""
    s = np.clip((t - start) / (end - start), 0, 1)
    return s * s * (3 - 2 * s)


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def rotation(axis, angle):
    """The matrix that turns by `angle` around the unit vector `axis`."""
    a, (x, y, z) = np.asarray(axis), axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.cos(angle) * np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * np.outer(a, a)


def frame(axis):
    """A rotation whose third column is the unit vector `axis`."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    u = np.cross(other, axis)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(axis, u), axis], axis=1)


def spread(rng, count, reach, apart, dims=3):
    """`count` points within `reach` of the centre, at least `apart` from each other if that can be had."""
    points = []
    while len(points) < count:
        for _ in range(200):
            point = rng.uniform(-reach, reach, dims)
            if np.linalg.norm(point) <= reach and all(np.linalg.norm(point - p) >= apart for p in points):
                points.append(point)
                break
        else:
            apart *= 0.9
    return points


def ball(grid, centre, radius, sharpness=4):
    """1 inside, 0 outside, 1/e at `radius`."""
    x, y, z = grid.around(centre)
    return np.exp(-(((x * x + y * y + z * z) / radius**2) ** (sharpness / 2)))


def ring(grid, centre, axis, radius, tube, sharpness=4):
    """A torus around `axis`: 1 at its middle line, 1/e at the distance `tube` from it."""
    u, v, w = grid.turned(centre, frame(axis))
    return np.exp(-((((np.sqrt(u * u + v * v) - radius) ** 2 + w * w) / tube**2) ** (sharpness / 2)))


def join(fields, power=4):
    """Fields of parts of one body, which grow necks towards each other."""
    fields = list(fields)
    if len(fields) == 1:
        return fields[0]
    return np.minimum(sum(f**power for f in fields) ** (1 / power), 1)


def relax(points, radii, bound, close=0.95, rounds=60):
    """Pushes balls apart that overlap by more than touching (`bound` pairs excepted: they belong together)."""
    points = np.array(points, float)
    for _ in range(rounds):
        for i in range(len(points)):
            for j in range(i):
                if (j, i) in bound:
                    continue
                apart = points[i] - points[j]
                distance = max(np.linalg.norm(apart), 1e-6)
                missing = close * (radii[i] + radii[j]) - distance
                if missing > 0:
                    points[i] += 0.25 * missing * apart / distance
                    points[j] -= 0.25 * missing * apart / distance
    return points


class Canvas:
    """The union of bodies: the largest value, and whose it is."""

    def __init__(self, grid):
        self.values = np.zeros(grid.shape, np.float32)
        self.owner = np.zeros(grid.shape, np.uint8)

    def put(self, values, label):
        more = values > self.values
        self.owner[more] = label[more] if isinstance(label, np.ndarray) else label
        self.values = np.maximum(self.values, values)

    def put_joined(self, fields, labels):
        """Parts of one body; a voxel belongs to the part that has most of it."""
        fields = list(fields)
        labels = np.asarray(labels, np.uint8)
        self.put(join(fields), labels[np.argmax(np.stack(fields), axis=0)])
