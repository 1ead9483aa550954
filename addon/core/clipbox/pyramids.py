"""Samples on a regular lattice, averaged to coarser and coarser ones, and read between their places.

Coarse voxels read a coarse lattice, or far boxes would show chance samples. Between samples values run straight along one axis after the
other, with weights that follow from a place alone: every value comes out the same to the bit whatever grid it is part of.
"""

import math
from dataclasses import dataclass

import numpy as np

from .grids import blended

PORTION = 1 << 22  # samples that are averaged at once


@dataclass(frozen=True)
class Line:
    """Places along one axis among samples.

    start, stop: which samples they lie among; stop is excluded. below, above: (N,) int64 the samples about each place, counted from start.
    weights: (2, N) float64 what these two count.
    """

    start: int
    stop: int
    below: np.ndarray
    above: np.ndarray
    weights: np.ndarray


def line_among(places: np.ndarray, first: int, last: int) -> Line:
    """Places (N,) among samples `first` to `last`, beyond which they stay at these; sample i reaches from i to i + 1."""
    within = np.clip(places - 0.5, first, last)
    below = np.floor(within).astype(np.int64)
    above = np.minimum(below + 1, last)
    part = within - below
    start = int(below.min())
    return Line(start, int(above.max()) + 1, below - start, above - start, np.stack([1.0 - part, part]))


def swept(values: np.ndarray, line: Line, axis: int) -> np.ndarray:
    """`values`, samples `line.start` to `line.stop` along `axis`, read at the line's places along it; same type, floating."""
    return blended(values, line.below, line.above, line.weights.astype(values.dtype), axis)


def pyramid(values: np.ndarray, outside: float | None) -> list[np.ndarray]:
    """`values` and their averages over 2, 4, 8 ... samples along every axis, float32, down to a single one.

    What is missing to a last pair counts as `outside`, or as its neighbour where that is None. Sample i of level l begins where sample
    2^l i of the first level does.
    """
    levels = [values]
    while max(levels[-1].shape) > 1:
        levels.append(_halved(levels[-1], outside))
    return levels


def _halved(values: np.ndarray, outside: float | None) -> np.ndarray:
    made = np.empty([-(-count // 2) for count in values.shape], np.float32)
    layers = 2 * max(1, PORTION // (2 * values[0].size))
    for start in range(0, len(values), layers):
        part = values[start : start + layers].astype(np.float32)
        missing = [(0, count % 2) for count in part.shape]
        part = np.pad(part, missing, mode="edge") if outside is None else np.pad(part, missing, constant_values=outside)
        for axis in range(part.ndim):
            along = np.moveaxis(part, axis, 0)
            part = np.moveaxis((along[0::2] + along[1::2]) * np.float32(0.5), 0, axis)
        made[start // 2 : start // 2 + len(part)] = part
    return made


def level_for(voxel: float, sample: float, levels: int) -> int:
    """Which of `levels` of a pyramid, whose finest samples are `sample` wide, has the widest samples that are no wider than a voxel."""
    return min(max(math.floor(math.log2(voxel / sample)), 0), levels - 1)
