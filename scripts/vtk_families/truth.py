"""The cell and the opacity of each voxel of a step, by which selections are judged in space."""

import numpy as np

from .drawing import opacity_at


def in_space(scene, step, side):
    """`ids` (u16) and `opacity` (0 to 1, over the length of a voxel), both `[z, y, x]`."""
    if scene.surfaces:
        return of_surfaces(scene, step)
    spacing = side / (step.values.shape[0] - 1)
    return step.ids.astype(np.uint16), of_volume(scene.transfer, step.values, spacing / (scene.transfer.unit * side))


def of_volume(transfer, values, units):
    """The mean extinction at eight places in each voxel; `units` is a voxel's length in those of the opacity."""
    total = 0
    for z, y, x in np.ndindex(2, 2, 2):
        opacity = np.minimum(opacity_at(transfer, shifted(values, (z, y, x))), 0.9999)
        total = total - np.log1p(-opacity)
    return (-np.expm1(-total / 8 * units)).astype(np.float32)


def shifted(values, forwards):
    """The values a quarter of a voxel further along each axis, or back."""
    for axis, forward in enumerate(forwards):
        length = values.shape[axis]
        beside = np.clip(np.arange(length) + (1 if forward else -1), 0, length - 1)
        values = 0.75 * values + 0.25 * np.take(values, beside, axis=axis)
    return values


def of_surfaces(scene, fields):
    """Opaque bodies are full; of a translucent one only the voxels on its surface count, with its opacity."""
    shape = next(iter(fields.values())).shape
    ids, opacity = np.zeros(shape, np.uint16), np.zeros(shape, np.float32)
    solid = [k for k, look in scene.surfaces.items() if look.opacity >= 1]
    for segment in sorted(fields, key=lambda k: k in solid):
        values = fields[segment]
        if segment in solid:
            own = values >= 0
        else:
            # the contour passes within half a voxel of the middle, along some axis
            steepest = np.max(np.abs(np.stack(np.gradient(values))), axis=0)
            own = np.abs(values) <= 0.5 * steepest
        ids[own], opacity[own] = segment, scene.surfaces[segment].opacity
    return ids, opacity
