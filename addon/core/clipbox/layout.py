"""Where the boxes lie about a viewer: a function of where the viewer is, and of nothing else.

Level 0 is the innermost box. A voxel of level k has 2^k times the side of one of level 0, and lattices are nested: voxel i of level k + 1
holds the voxels 2 i and 2 i + 1 of level k. What a level shows is cut to whole pairs of voxels of the next one: so no voxel is half hidden,
and a box that follows with every voxel has a new surface with every fourth one only.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from .settings import ClipboxSettings

GRAIN = 4  # voxels that what a level shows grows or shrinks by
NEAR = 1.0e5  # voxels: so near to the origin, single precision holds vertices well


@dataclass(frozen=True)
class Cuboid:
    """Voxels `low` to `high` of a level's lattice, (3,) int64 each, `high` not included."""

    low: np.ndarray
    high: np.ndarray

    def contains(self, voxels: np.ndarray) -> np.ndarray:
        """Whether it holds each of `voxels` (..., 3)."""
        return ((voxels >= self.low) & (voxels < self.high)).all(axis=-1)

    def touches(self, corners: np.ndarray) -> np.ndarray:
        """Whether each of `corners` (..., 3) lies in it or on its border."""
        return ((corners >= self.low) & (corners <= self.high)).all(axis=-1)

    def clipped(self, other: "Cuboid") -> "Cuboid":
        """What it has in common with `other`; `low` is not below `high` where that is nothing."""
        return Cuboid(np.maximum(self.low, other.low), np.minimum(self.high, other.high))

    @property
    def empty(self) -> bool:
        """Whether there is no voxel in it."""
        return bool((self.low >= self.high).any())

    @property
    def key(self) -> tuple[int, ...]:
        """Its bounds."""
        return (*self.low.tolist(), *self.high.tolist())


@dataclass(frozen=True)
class Layout:
    """Boxes about a viewer. origins: one (3,) int64 a level, the first voxel of each box. shown: what each level shows, but for what the
    next finer one does."""

    origins: list[np.ndarray]
    shown: list[Cuboid]

    def hole(self, level: int) -> Cuboid | None:
        """The voxels of `level` that finer levels show, None for the finest."""
        return Cuboid(self.shown[level - 1].low // 2, self.shown[level - 1].high // 2) if level else None


def layout_about(viewer: np.ndarray, settings: ClipboxSettings) -> Layout:
    """The boxes about a viewer at (3,) float64 scene units, in whole steps of as many voxels as the viewer may go."""
    resolution, places = settings.resolution, np.asarray(viewer, np.float64) / (settings.voxel * settings.threshold)
    steps = [np.floor(places / 2**level + 0.5 - 0.5 / settings.threshold).astype(np.int64) for level in range(settings.boxes)]
    origins = [each * settings.threshold - resolution // 2 for each in steps]
    shown = [Cuboid((origin + GRAIN - 1) // GRAIN * GRAIN, (origin + resolution) // GRAIN * GRAIN) for origin in origins[:-1]]
    return Layout(origins, [*shown, Cuboid(origins[-1], origins[-1] + resolution)])


def same_layout(one: Layout, other: Layout) -> bool:
    """Whether all boxes of two layouts lie at the same place."""
    return all(np.array_equal(first, second) for first, second in zip(one.origins, other.origins, strict=True))


def good_origin(viewer: np.ndarray, settings: ClipboxSettings) -> np.ndarray:
    """The place of the terrain (3,) float64, scene units, from which single precision should count about a viewer at (3,): its own origin,
    but along the axes along which the viewer is far away."""
    unit = settings.voxel * 2 ** (settings.boxes - 1)
    return np.where(np.abs(viewer) > NEAR * settings.voxel, np.rint(viewer / unit) * unit, 0.0)


def blocks_of(layout: Layout, level: int, side: int) -> list[tuple[int, int, int]]:
    """The blocks of `side` voxels a side, by their place among blocks, in which `level` shows something."""
    shown, hole = layout.shown[level], layout.hole(level)
    first, last = shown.low // side, -(-shown.high // side)
    blocks = product(*(range(low, high) for low, high in zip(first.tolist(), last.tolist(), strict=True)))
    if hole is None:
        return list(blocks)
    covered_low, covered_high = (-(-hole.low // side)).tolist(), (hole.high // side).tolist()
    return [block for block in blocks if not all(low <= at < high for low, at, high in zip(covered_low, block, covered_high, strict=True))]
