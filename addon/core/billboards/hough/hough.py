"""Greedy planes in Hough space (section 4.1, after Decoret et al.): few planes for any triangle soup or point cloud.

A plane is a unit normal n and an offset rho, n . x = rho. The Hough space is divided into cells of (normal, rho). A primitive is valid for
a cell if some plane of the cell is within the error of all its corners; it adds its projected area there. It subtracts area where a plane
just misses it, on the side opposite to its normal. The best cell is refined to a plane, the primitives that the plane covers are removed,
and so on until none is left.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...geometry.directions import golden_spiral
from ...geometry.transforms import frame_from_normal
from ...jobs.progress import Progress, Steps
from ..clustering.planes import PlaneBounds
from .regions import split_into_regions

DIRECTION_SPACING = 1.4  # Times sqrt(error / extent): the rotation within the error of a surface patch of mean curvature.
DIRECTION_COUNTS = (96, 2048)  # Minimum and maximum.
MAX_EXTRA_DIRECTIONS = 512
NORMAL_STEPS = 200.0  # Per unit: normals of large faces that round to the same multiples share an extra direction.
MAX_CELLS = 4_000_000
MIN_CELL_WIDTH = 0.5  # In errors; the refinement finds the exact offset inside a cell.
PAIRS_PER_CHUNK = 1_000_000  # Pairs of a primitive and a direction at once.
MISSED_WIDTH = 1.0  # e_m, in errors.
MISSED_WEIGHT = 0.5
REFINEMENTS = 4  # Halvings of the direction grid around the best cell.
REFINEMENT_REACH = 1.5  # In direction spacings: more than the 1.33 by which the halved grids can rotate a plane.
EDGE_ON_WEIGHT = 0.01  # Fraction of its area with which a face counts that is seen edge-on: some plane must still cover it.
FILL_PROGRESS, PLANES_PROGRESS, SPLIT_PROGRESS = 0.3, 0.6, 0.1  # Fractions of the progress of the three stages.


@dataclass(frozen=True)
class HoughPlanes:
    """Q regions on planes, in the space of the primitives.

    normals (Q, 3) unit and offsets (Q,) float64: the plane n . x = offset; a plane that was split has one entry per region.
    drawn: Q int32 arrays, ascending: the primitives drawn on each region, with all corners within the error of the plane.
    owner (T,) int32: among the regions that draw a primitive, the one with the smallest angle to it.
    """

    normals: np.ndarray
    offsets: np.ndarray
    drawn: list[np.ndarray]
    owner: np.ndarray


@dataclass(frozen=True)
class _CenteredPrimitives:
    """corners (T, C, 3), relative to the center of their bounding box; areas (T,); normals (T, 3); error: a length."""

    corners: np.ndarray
    areas: np.ndarray
    normals: np.ndarray
    error: float

    def find_covered(self, normal: np.ndarray, offset: float) -> np.ndarray:
        """Test which primitives have all corners within the error of the plane: (T,) bool."""
        return PlaneBounds(self.error).contain(self.corners, self.normals, normal, offset)

    def subset(self, indices: np.ndarray) -> "_CenteredPrimitives":
        """Return the primitives `indices` (K,), integers or a (T,) mask."""
        return _CenteredPrimitives(self.corners[indices], self.areas[indices], self.normals[indices], self.error)


def find_planes(corners: np.ndarray, areas: np.ndarray, normals: np.ndarray, error: float, seed: int) -> Steps[HoughPlanes]:
    """Find planes that together are within `error` of every corner of every primitive.

    Args:
        corners: (T, C, 3) float64 corner positions; C is 3 for triangles, 1 for points.
        areas: (T,) float64, positive.
        normals: (T, 3) float64 unit normals; their sign matters only for missed primitives, since a plane is two-sided.
        error: maximum distance of a corner to its plane, in the unit of `corners`.
        seed: of the rotation of the direction lattice.
    """
    center = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    primitives = _CenteredPrimitives(corners - center, areas, normals, error)
    space = _HoughSpace(primitives, _choose_directions(primitives, seed))
    yield from space.fill()
    first_plane = np.full(len(corners), -1, np.int32)  # That covers each primitive.
    planes: list[tuple[np.ndarray, float]] = []
    remaining, total = len(corners), len(corners)
    while remaining:
        normal, offset = _find_next_plane(primitives, space, first_plane)
        covered = np.flatnonzero((first_plane < 0) & primitives.find_covered(normal, offset))
        first_plane[covered] = len(planes)
        planes.append((normal, offset))
        space.remove(covered)
        remaining -= len(covered)
        fraction = FILL_PROGRESS + PLANES_PROGRESS * (1.0 - remaining / total)
        yield Progress(fraction, f"{len(planes)} planes, {remaining} faces remaining")
    yield Progress(1.0 - SPLIT_PROGRESS, "Splitting planes")
    return _split_planes(primitives, planes, first_plane, center)


def _choose_directions(primitives: _CenteredPrimitives, seed: int) -> np.ndarray:
    """Return (D, 3) unit normals: a lattice over the hemisphere, and normals of faces too large to be valid at any lattice direction."""
    extent = float(np.ptp(primitives.corners, axis=(0, 1)).max())
    spacing = DIRECTION_SPACING * np.sqrt(primitives.error / extent)
    count = int(np.clip(2.0 * np.pi / spacing**2, *DIRECTION_COUNTS))
    heights = (np.arange(count) + 0.5) / count
    lattice = golden_spiral(heights, 2.0 * np.pi * np.random.default_rng(seed).random())
    sizes = np.linalg.norm(primitives.corners - primitives.corners[:, :1], axis=2).max(axis=1)
    large = np.flatnonzero(sizes * np.sqrt(2.0 * np.pi / count) > primitives.error)
    if len(large) == 0:
        return lattice
    upward = primitives.normals[large] * np.where(primitives.normals[large, 2:] < 0.0, -1.0, 1.0)
    _, first, group = np.unique(np.round(upward * NORMAL_STEPS), axis=0, return_index=True, return_inverse=True)
    group_areas = np.bincount(group.ravel(), primitives.areas[large])
    chosen = np.sort(np.argsort(-group_areas, kind="stable")[:MAX_EXTRA_DIRECTIONS])
    return np.concatenate([lattice, upward[first[chosen]]])


class _HoughSpace:
    """Densities of the cells (direction, rho), from the primitives that have not been removed."""

    def __init__(self, primitives: _CenteredPrimitives, directions: np.ndarray) -> None:
        self.primitives, self.directions = primitives, directions
        radius = float(np.linalg.norm(primitives.corners, axis=2).max()) + primitives.error * (2.0 + MISSED_WIDTH)
        self.cell_width = max(MIN_CELL_WIDTH * primitives.error, 2.0 * radius * len(directions) / MAX_CELLS)
        self.cell_count = int(np.ceil(2.0 * radius / self.cell_width)) + 2
        self.low = -0.5 * self.cell_width * self.cell_count
        self.density = np.zeros((len(directions), self.cell_count))

    def fill(self) -> Iterator[Progress]:
        """Add all primitives."""
        chunk = max(1, PAIRS_PER_CHUNK // len(self.directions))
        for start in range(0, len(self.primitives.areas), chunk):
            self._add(np.arange(start, min(start + chunk, len(self.primitives.areas))), 1.0)
            yield Progress(FILL_PROGRESS * start / len(self.primitives.areas), "Filling the Hough space")

    def remove(self, indices: np.ndarray) -> None:
        """Remove the primitives `indices` (K,)."""
        chunk = max(1, PAIRS_PER_CHUNK // len(self.directions))
        for start in range(0, len(indices), chunk):
            self._add(indices[start : start + chunk], -1.0)

    def find_densest(self) -> tuple[np.ndarray, float, float]:
        """Return the normal (3,), central offset, and density of the densest cell."""
        row, column = divmod(int(self.density.argmax()), self.cell_count)
        return self.directions[row], self.low + (column + 0.5) * self.cell_width, float(self.density[row, column])

    def _add(self, indices: np.ndarray, sign: float) -> None:
        error = self.primitives.error
        rho = self.primitives.corners[indices] @ self.directions.T
        low, high = rho.max(axis=1) - error, rho.min(axis=1) + error
        cosines = self.primitives.normals[indices] @ self.directions.T
        valid = low <= high
        weight = sign * np.where(valid, np.abs(cosines), 0.0) * self.primitives.areas[indices, None]
        # Along rho a primitive first subtracts area and then adds it, or the reverse: three changes either way.
        is_front, missed = cosines > 0.0, MISSED_WEIGHT * weight
        changes = (
            (np.where(is_front, low - MISSED_WIDTH * error, low), 0, np.where(is_front, -missed, weight)),
            (np.where(is_front, low, high), ~is_front, np.where(is_front, weight + missed, -weight - missed)),
            (np.where(is_front, high, high + MISSED_WIDTH * error), 1, np.where(is_front, -weight, missed)),
        )
        row_start = np.arange(len(self.directions)) * self.cell_count
        cells = np.concatenate([(row_start + self._find_column(rho) + shift).ravel() for rho, shift, _ in changes])
        amounts = np.concatenate([amount.ravel() for _, _, amount in changes])
        differences = np.bincount(cells, amounts, minlength=self.density.size).reshape(self.density.shape)
        self.density += np.cumsum(differences, axis=1, out=differences)

    def _find_column(self, rho: np.ndarray) -> np.ndarray:
        return ((rho - self.low) / self.cell_width).astype(np.int64)


def _find_next_plane(primitives: _CenteredPrimitives, space: _HoughSpace, first_plane: np.ndarray) -> tuple[np.ndarray, float]:
    """Find the plane of the densest cell, refined, or the plane of the largest primitive if no cell has a plane for the remaining ones."""
    normal, offset, density = space.find_densest()
    remaining = np.flatnonzero(first_plane < 0)
    if density > 0.0:
        spacing = np.sqrt(2.0 * np.pi / len(space.directions))
        normal, offset, covered_area = _refine(primitives, remaining, normal, offset, spacing)
        if covered_area > 0.0:
            return normal, offset
    largest = remaining[primitives.areas[remaining].argmax()]
    normal = primitives.normals[largest]
    rho = primitives.corners[largest] @ normal
    return _refine(primitives, remaining, normal, 0.5 * (rho.min() + rho.max()), 0.0)[:2]


def _refine(
    primitives: _CenteredPrimitives, remaining: np.ndarray, normal: np.ndarray, offset: float, spacing: float
) -> tuple[np.ndarray, float, float]:
    """Find the plane near (normal, offset) that covers the most projected area of the primitives `remaining`, and that area.

    The directions within `spacing` (radians) are searched on a grid of 3 x 3 that is halved around its best direction. The offset is exact
    for each direction: the most covered point of the intervals of rho.
    """
    candidates = primitives.subset(remaining)
    heights = np.abs(candidates.corners @ normal - offset)
    covered = (heights <= primitives.error).all(axis=1)
    pivot = candidates.corners[covered].mean(axis=(0, 1)) if covered.any() else np.zeros(3)
    reach = 2.0 * primitives.error + REFINEMENT_REACH * spacing * np.linalg.norm(candidates.corners - pivot, axis=2)
    near = candidates.subset((heights <= reach).all(axis=1))
    best_offset, best_area = _find_best_offset(near, normal)
    step = 0.5 * spacing
    for _ in range(REFINEMENTS if spacing > 0.0 else 0):
        for candidate in _neighbor_directions(normal, step):
            candidate_offset, area = _find_best_offset(near, candidate)
            if area > best_area:
                normal, best_offset, best_area = candidate, candidate_offset, area
        step *= 0.5
    return normal, best_offset, best_area


def _neighbor_directions(normal: np.ndarray, step: float) -> np.ndarray:
    """Return (8, 3) unit normals on a square with half side `step` (radians) around `normal`."""
    u, v, _ = frame_from_normal(normal)
    offsets = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y]) * np.tan(step)
    directions = normal + offsets[:, :1] * u + offsets[:, 1:] * v
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _find_best_offset(primitives: _CenteredPrimitives, normal: np.ndarray) -> tuple[float, float]:
    """Find the offset of the plane along `normal` that covers the most projected area of `primitives`, and that area."""
    rho = primitives.corners @ normal
    low, high = rho.max(axis=1) - primitives.error, rho.min(axis=1) + primitives.error
    valid = low <= high
    if not valid.any():
        return 0.0, 0.0
    cosines = primitives.normals[valid] @ normal
    weights = (np.abs(cosines) + EDGE_ON_WEIGHT) * primitives.areas[valid]
    low, high = low[valid], high[valid]
    ends = np.concatenate([low, high])
    order = np.lexsort((np.repeat([0, 1], len(low)), ends))
    covered = np.cumsum(np.concatenate([weights, -weights])[order])
    top = int(covered.argmax())
    return 0.5 * float(ends[order[top]] + ends[order[min(top + 1, len(order) - 1)]]), float(covered[top])


def _split_planes(
    primitives: _CenteredPrimitives, planes: list[tuple[np.ndarray, float]], first_plane: np.ndarray, center: np.ndarray
) -> HoughPlanes:
    """Split the primitives on each plane into compact regions, and assign each primitive to the region with the smallest angle to it."""
    normals, offsets, drawn = [], [], []
    owner = np.full(len(first_plane), -1, np.int32)
    best_cosine = np.full(len(first_plane), -1.0)
    for index, (normal, offset) in enumerate(planes):
        near = np.flatnonzero(primitives.find_covered(normal, offset))
        cosines = np.abs(primitives.normals[near] @ normal)
        for members in split_into_regions(primitives.corners[near], first_plane[near] == index, normal, primitives.error):
            better = near[members & (cosines > best_cosine[near])]
            best_cosine[better] = np.abs(primitives.normals[better] @ normal)
            owner[better] = len(drawn)
            drawn.append(near[members].astype(np.int32))
            normals.append(normal)
            offsets.append(offset + float(normal @ center))
    used, owner = np.unique(owner, return_inverse=True)
    return HoughPlanes(np.array(normals)[used], np.array(offsets)[used], [drawn[index] for index in used], owner.astype(np.int32).ravel())
