"""gsplat's CUDA rasteriser on the scenes S, M and L of `kernels/benches`: forward, and forward with backward.

Needs numpy, torch with CUDA, and gsplat. Prints a Markdown table, milliseconds, minimum and median of 50 runs.
"""

import math
import statistics

import gsplat
import numpy as np
import torch

SCENES = [("S", 10_000, 200, 11), ("M", 50_000, 400, 12), ("L", 150_000, 800, 13)]
SH_C0 = 0.28209479177387814


class Numbers:
    """splitmix64, many at a time: the stream of the Rust benches."""

    def __init__(self, seed):
        self.state = np.uint64(seed)

    def uniform(self, *shape):
        n = math.prod(shape)
        step = np.uint64(0x9E3779B97F4A7C15)
        with np.errstate(over="ignore"):
            x = self.state + step * np.arange(1, n + 1, dtype=np.uint64)
            self.state = x[-1]
            x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return (((x ^ (x >> np.uint64(31))) >> np.uint64(11)) / 2.0**53).reshape(shape)


def normal(u):
    """Standard normals from pairs of uniforms in the last axis."""
    return np.sqrt(-2 * np.log(1 - u[..., 0::2])) * np.cos(2 * np.pi * u[..., 1::2])


def scene(n, seed):
    r = Numbers(seed)
    spacing = (4 / 3 * math.pi / n) ** (1 / 3)
    u = r.uniform(n, 7)
    d = normal(u[:, :6])
    means = d / np.linalg.norm(d, axis=1, keepdims=True) * np.cbrt(u[:, 6:])
    u = r.uniform(n, 93)
    base = (0.05 + 0.9 * u[:, :3] - 0.5) / SH_C0
    sh = np.concatenate([base, 0.08 * normal(u[:, 3:])], 1).reshape(n, 16, 3)
    rotations = normal(r.uniform(n, 8))
    scales = np.exp(math.log(0.7 * spacing) + 0.35 * normal(r.uniform(n, 6)))
    opacities = 0.05 + 0.55 * r.uniform(n)
    arrays = [means, rotations, scales, opacities, sh]
    return [torch.tensor(a, dtype=torch.float32, device="cuda", requires_grad=True) for a in arrays]


def camera(size):
    a, b = 0.4, 0.7
    f = np.array([-math.cos(a) * math.cos(b), -math.cos(a) * math.sin(b), -math.sin(a)])
    right = np.array([f[1], -f[0], 0.0]) / math.hypot(f[0], f[1])
    down = np.cross(f, right)
    view = np.eye(4)
    view[:3, :3] = [right, down, f]
    view[2, 3] = 4.0
    focal = 0.5 * size / math.tan(math.radians(15))
    k = [[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]]
    return [torch.tensor(np.array(m), dtype=torch.float32, device="cuda")[None] for m in (view, k)]


def measure(f, runs=50):
    times = []
    for _ in range(runs + 5):
        start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        start.record()
        f()
        end.record()
        torch.cuda.synchronize()
        times.append(start.elapsed_time(end))
    return min(times[5:]), statistics.median(times[5:])


print(f"gsplat {gsplat.__version__}, torch {torch.__version__}, {torch.cuda.get_device_name()}\n")
print("| scene | pass | min | median |\n|---|---|--:|--:|")
for name, n, size, seed in SCENES:
    means, rotations, scales, opacities, sh = scene(n, seed)
    view, k = camera(size)
    target = torch.rand(1, size, size, 3, device="cuda")

    def forward():
        return gsplat.rasterization(
            means, rotations, scales, opacities, sh, view, k, size, size, near_plane=0.2, sh_degree=3
        )[0]

    def both():
        ((forward() - target) ** 2).mean().backward()

    with torch.no_grad():
        print(f"| {name} | forward | {'%.2f | %.2f' % measure(forward)} |")
    print(f"| {name} | forward + backward | {'%.2f | %.2f' % measure(both)} |")
