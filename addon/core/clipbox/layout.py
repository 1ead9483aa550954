"""The placement of the boxes, as a function of the viewer position only.

Level 0 is the innermost box. A voxel of level k has 2^k times the side of one of level 0, and lattices are nested: voxel i of level k + 1
contains the voxels 2 i and 2 i + 1 of level k. The visible part of a level is aligned to multiples of `ALIGNMENT` voxels. No voxel of the
next coarser level is therefore half hidden, and a box that is recentered with every voxel gets a new surface with every fourth voxel only.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..geometry.transforms import choose_origin
from .settings import ClipboxSettings

ALIGNMENT = 4  # voxels
SMOOTH_ALIGNMENT = 2  # Voxels to which it is aligned if moves are smooth.
REACH_FRACTION = 0.35  # Of a voxel, between the ends of boxes and the viewer: no two of them then change together, nor with a transition.
CENTER_STEPS = 4  # Positions of the viewer per voxel along an axis that smooth moves distinguish.
RESOLUTION_PER_TRANSITION = 8  # Voxels along a side of a box per voxel of the transition of smooth moves at its ends, at least.
BORDER_DEPTH = 3.5  # Voxels from the reach to the center of the second voxel at the border, the last one that a coarser level reads.
FINER_DEPTH = 1.5  # Voxels from the border of a finer level to the center of the second voxel around it.
MAX_SINGLE_PRECISION = 1.0e5  # voxels from the origin up to which single precision is accurate enough for vertices


@dataclass(frozen=True)
class IntBox:
    """The voxels `low` to `high` of a level's lattice, (3,) int64 each, `high` exclusive."""

    low: np.ndarray
    high: np.ndarray

    def contains(self, voxels: np.ndarray) -> np.ndarray:
        """Return whether each of `voxels` (..., 3) is inside."""
        return ((voxels >= self.low) & (voxels < self.high)).all(axis=-1)

    def contains_corners(self, corners: np.ndarray) -> np.ndarray:
        """Return whether each of `corners` (..., 3) is inside or on the boundary."""
        return ((corners >= self.low) & (corners <= self.high)).all(axis=-1)

    def intersection(self, other: "IntBox") -> "IntBox":
        """Return the common voxels. If there are none, `is_empty` is true for the result."""
        return IntBox(np.maximum(self.low, other.low), np.minimum(self.high, other.high))

    @property
    def is_empty(self) -> bool:
        """Whether it contains no voxel."""
        return bool((self.low >= self.high).any())

    @property
    def bounds(self) -> tuple[int, ...]:
        """The six bounds, low ones first."""
        return (*self.low.tolist(), *self.high.tolist())


@dataclass(frozen=True)
class BoxLayout:
    """The boxes around a viewer.

    origins: (3,) int64 per level, the first voxel of each box. visible: visible part of each level, including the part that the next finer
    level covers. centers: (3,) int64 per level, the viewer in voxels / `CENTER_STEPS`, from whom transitions are measured; none if moves
    are not smooth. first_level: the finest level with voxels that is shown.
    """

    origins: list[np.ndarray]
    visible: list[IntBox]
    centers: list[np.ndarray]
    first_level: int

    def hole(self, level: int) -> IntBox | None:
        """Return the voxels of `level` that finer voxels replace, None if none do."""
        return IntBox(self.visible[level - 1].low // 2, self.visible[level - 1].high // 2) if level > self.first_level else None


def box_slices(low: np.ndarray, high: np.ndarray) -> tuple[slice, ...]:
    """Return the slices of the part `low` to `high` (3,) of an array."""
    return tuple(slice(*span) for span in zip(low.tolist(), high.tolist(), strict=True))


def layout_around(viewer: np.ndarray, settings: ClipboxSettings, travel: float = 0.0) -> BoxLayout:
    """Return the boxes around a viewer at (3,) float64 scene units. Boxes move in steps of `threshold` voxels.

    If moves are smooth, the visible part of each box follows the viewer more closely than the box, by the fewest voxels. Boxes that the
    viewer leaves on a path of the length `travel`, scene units, are not shown, except for the outermost one, and of subdivided boxes.
    """
    resolution, threshold = settings.resolution, settings.threshold
    positions = [np.asarray(viewer, np.float64) / (settings.voxel_size * 2**level) for level in range(settings.boxes)]
    steps = [np.floor(position / threshold + 0.5 - 0.5 / threshold).astype(np.int64) for position in positions]
    origins = [step * threshold - resolution // 2 for step in steps]
    if settings.has_smooth_moves:
        reach = visible_reach(settings)
        visible = [_align(position - reach, position + reach, SMOOTH_ALIGNMENT) for position in positions[:-1]]
        centers = [np.floor(position * CENTER_STEPS + 0.5).astype(np.int64) for position in positions[:-1]]
    else:
        visible, centers = [_align(origin, origin + resolution, ALIGNMENT) for origin in origins[:-1]], []
    first_level = settings.subdivided_boxes
    while not settings.subdivided_boxes and first_level < settings.boxes - 1 and travel > 0.5 * settings.extent_of(first_level):
        first_level += 1
    return BoxLayout(origins, [*visible, IntBox(origins[-1], origins[-1] + resolution)], centers, first_level)


def _align(low: np.ndarray, high: np.ndarray, alignment: int) -> IntBox:
    """Return the largest box between `low` and `high` (3,) that is aligned to multiples of some voxels."""
    return IntBox(*(rounded(end / alignment).astype(np.int64) * alignment for rounded, end in ((np.ceil, low), (np.floor, high))))


def visible_reach(settings: ClipboxSettings) -> float:
    """Return the distance from the viewer, in voxels of a level, that its visible part does not exceed if moves are smooth."""
    return math.floor(settings.resolution // 2 - settings.threshold / 2 - 0.5 - REACH_FRACTION) + REACH_FRACTION


def transition_range(settings: ClipboxSettings) -> tuple[float, float]:
    """Return the distances from the viewer, in voxels of a level, at which the transition of smooth moves starts and ends.

    It ends before the border and starts after that of the next finer level. At a border, both levels therefore show the same densities.
    """
    reach = visible_reach(settings)
    end = reach - BORDER_DEPTH
    return max(reach / 2 + FINER_DEPTH, end - settings.resolution / RESOLUTION_PER_TRANSITION), end


def is_same_layout(layout: BoxLayout, other: BoxLayout) -> bool:
    """Return whether two layouts show the same boxes at the same positions, and transitions have the same centers."""
    return layout.first_level == other.first_level and all(
        np.array_equal(position, other_position) for position, other_position in zip(_positions(layout), _positions(other), strict=True)
    )


def _positions(layout: BoxLayout) -> list[np.ndarray]:
    return [*layout.origins, *layout.centers, *(end for box in layout.visible for end in (box.low, box.high))]


def choose_terrain_origin(viewer: np.ndarray, settings: ClipboxSettings) -> np.ndarray:
    """Return the terrain position (3,) float64, scene units, that single-precision vertices around a viewer at (3,) are relative to.

    It is the origin of the terrain, except along axes on which the viewer is far from it.
    """
    return choose_origin(viewer, settings.voxel_size * 2 ** (settings.boxes - 1), MAX_SINGLE_PRECISION * settings.voxel_size)


def visible_blocks(layout: BoxLayout, level: int, side: int) -> list[tuple[int, int, int]]:
    """Return the indices of the blocks of `side` voxels per side in which `level` is visible."""
    visible, hole = layout.visible[level], layout.hole(level)
    first, last = visible.low // side, -(-visible.high // side)
    blocks = product(*(range(low, high) for low, high in zip(first.tolist(), last.tolist(), strict=True)))
    if hole is None:
        return list(blocks)
    covered_low, covered_high = (-(-hole.low // side)).tolist(), (hole.high // side).tolist()
    return [
        block for block in blocks if not all(low <= index < high for low, index, high in zip(covered_low, block, covered_high, strict=True))
    ]
