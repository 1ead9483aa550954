"""Walls at the borders of boxes: faces between ground and air where two boxes meet, which the density of neither box has by itself."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from farfield.addon.core.clipbox.meshing.surface_nets import is_solid
from farfield.addon.core.clipbox.nested import NestedBoxes
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import Sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.jobs.progress import run_to_end

WALL_JUMP = 2.0  # Of the density across a face, in voxels of the coarser box. A distance changes by 0.75 between centers as far apart.


def count_walls(sampler: Sampler, settings: ClipboxSettings, viewers: np.ndarray) -> list[dict[str, int]]:
    """Return for each box but the outermost the number of faces at its border, of those between ground and air, and of walls among these.

    A face is a wall if the density jumps across it, and there is no surface between its two voxels in the finer box if that went on, nor in
    the coarser one within a voxel.

    viewers: (N, 3), scene units, around whom the boxes lie one after the other.
    """
    boxes = NestedBoxes(sampler, settings)
    counts = [dict.fromkeys(("faces", "surface", "walls"), 0) for _ in range(settings.boxes - 1)]
    for viewer in viewers:
        run_to_end(boxes.move(viewer))
        for level, count in enumerate(counts):
            shown, finer, coarser = _shown(boxes, level), _sampled(boxes, sampler, level, 0), _sampled(boxes, sampler, level, 1)
            for (inside, outside), (fine_inside, fine_outside), coarse in zip(shown, finer, coarser, strict=True):
                is_surface = is_solid(inside) != is_solid(outside)
                jump = np.abs(inside.astype(np.float32) - outside.astype(np.float32)) / (settings.voxel_size * 2 ** (level + 1))
                is_expected = is_solid(fine_inside) != is_solid(fine_outside)
                near = 5  # Voxels of the finer box: these and two more on each side.
                solid = np.stack([is_solid(layer) for layer in coarse])
                is_expected |= maximum_filter(solid.any(axis=0), near) & ~minimum_filter(solid.all(axis=0), near)
                count["faces"] += inside.size
                count["surface"] += int(is_surface.sum())
                count["walls"] += int((is_surface & (jump > WALL_JUMP) & ~is_expected).sum())
    return counts


def _shown(boxes: NestedBoxes, level: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the densities on both sides of each of the six borders of a level, (N, M) each."""
    visible = boxes.layout.visible[level]
    window = boxes.window(level, visible.low - 1, visible.high + 1)
    for axis in range(3):
        layers = np.moveaxis(window, axis, 0)[:, 1:-1, 1:-1]
        yield layers[1], layers[0]
        yield layers[-2], layers[-1]


def _sampled(boxes: NestedBoxes, sampler: Sampler, level: int, coarser: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the densities there of the terrain alone, with voxels of the level, or of the next coarser one, on both sides of the border."""
    visible, voxel_size = boxes.layout.visible[level], boxes.grid(level + coarser).voxel_size
    for axis in range(3):
        for first in (visible.low[axis] // 2**coarser - 1, visible.high[axis] // 2**coarser - 1):
            low, high = visible.low // 2**coarser, visible.high // 2**coarser
            low[axis], high[axis] = first, first + 2
            grid = Grid(tuple(low.tolist()), tuple((high - low).tolist()), voxel_size)
            layers = np.moveaxis(sampler.densities(grid), axis, 0).repeat(2**coarser, 1).repeat(2**coarser, 2)
            yield (layers[1], layers[0]) if first < visible.low[axis] // 2**coarser else (layers[0], layers[1])
