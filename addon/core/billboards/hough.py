"""Greedy planes in Hough space (section 4.1, after Decoret et al.): few planes for any soup of triangles or points.

A plane is a unit normal n and an offset rho, n . x = rho. Space is cut into cells of (normal, rho). A primitive is valid for a cell if some
plane of the cell lies within the error of all its corners, and adds its projected area there; where a plane just misses it, on the side
against its normal, it takes area away. The best cell is refined to a plane, the primitives that the plane covers are taken out, and so on
until nothing is left.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..progress import Progress, Steps
from .regions import split_into_regions

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
DIRECTION_SPACING = 1.4  # of sqrt(error / extent): the turn that a patch of mean curvature bears within the error
DIRECTION_COUNTS = (96, 2048)
MAX_EXTRA_DIRECTIONS = 512
MAX_CELLS = 4_000_000
CHUNK_PAIRS = 1_000_000
MISSED_WIDTH = 1.0  # e_m, in errors
MISSED_WEIGHT = 0.5
REFINEMENTS = 4


@dataclass(frozen=True)
class Planes:
    """Q regions on planes, in the space of the primitives.

    normals (Q, 3) unit and offsets (Q,) float64: the plane n . x = offset; a plane that was split into regions stands once for each.
    covers: Q int32 arrays, ascending: the primitives drawn on each region, every corner of theirs within the error of the plane.
    owner (T,) int32: the region that each primitive faces best among those that cover it.
    """

    normals: np.ndarray
    offsets: np.ndarray
    covers: list[np.ndarray]
    owner: np.ndarray


@dataclass(frozen=True)
class _Primitives:
    corners: np.ndarray  # (T, C, 3), about their common center
    areas: np.ndarray
    normals: np.ndarray
    error: float


def find_planes(corners: np.ndarray, areas: np.ndarray, normals: np.ndarray, error: float, seed: int) -> Steps[Planes]:
    """Planes that together pass within `error` of every corner of every primitive.

    Args:
        corners: (T, C, 3) float64 corner positions; C is 3 for triangles, 1 for points.
        areas: (T,) float64, positive.
        normals: (T, 3) float64 unit normals; their sign counts only for missed primitives, a plane serves both sides.
        error: largest distance of a corner to its plane, in the unit of `corners`.
        seed: turns the lattice of directions.
    """
    center = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    primitives = _Primitives(corners - center, areas, normals, error)
    space = _HoughSpace(primitives, _directions(primitives, seed))
    yield from space.fill()
    taken_by = np.full(len(corners), -1, np.int32)
    planes: list[tuple[np.ndarray, float]] = []
    left, total = len(corners), len(corners)
    while left:
        normal, offset = _next_plane(primitives, space, taken_by)
        covered = np.flatnonzero((taken_by < 0) & _within(primitives, normal, offset))
        taken_by[covered] = len(planes)
        planes.append((normal, offset))
        space.take_out(covered)
        left -= len(covered)
        yield Progress(0.3 + 0.6 * (1.0 - left / total), f"{len(planes)} planes, {left} faces left")
    yield Progress(0.9, "splitting planes")
    return _regions(primitives, planes, taken_by, center)


def _directions(primitives: _Primitives, seed: int) -> np.ndarray:
    """(D, 3) unit normals: a lattice over the hemisphere, and the normals of faces too large to be valid at any lattice direction."""
    extent = float(np.ptp(primitives.corners, axis=(0, 1)).max())
    spacing = DIRECTION_SPACING * np.sqrt(primitives.error / extent)
    count = int(np.clip(2.0 * np.pi / spacing**2, *DIRECTION_COUNTS))
    height = (np.arange(count) + 0.5) / count
    turn = GOLDEN_ANGLE * np.arange(count) + 2.0 * np.pi * np.random.default_rng(seed).random()
    flat = np.sqrt(1.0 - height**2)
    lattice = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    sizes = np.linalg.norm(primitives.corners - primitives.corners[:, :1], axis=2).max(axis=1)
    large = np.flatnonzero(sizes * np.sqrt(2.0 * np.pi / count) > primitives.error)
    if len(large) == 0:
        return lattice
    upright = primitives.normals[large] * np.where(primitives.normals[large, 2:] < 0.0, -1.0, 1.0)
    _, first, group = np.unique(np.round(upright * 200.0), axis=0, return_index=True, return_inverse=True)
    weight = np.bincount(group.ravel(), primitives.areas[large])
    chosen = np.sort(np.argsort(-weight, kind="stable")[:MAX_EXTRA_DIRECTIONS])
    return np.concatenate([lattice, upright[first[chosen]]])


class _HoughSpace:
    """Densities over cells (direction, rho), of the primitives that have not been taken out."""

    def __init__(self, primitives: _Primitives, directions: np.ndarray) -> None:
        self.primitives, self.directions = primitives, directions
        radius = float(np.linalg.norm(primitives.corners, axis=2).max()) + primitives.error * (2.0 + MISSED_WIDTH)
        self.width = max(0.5 * primitives.error, 2.0 * radius * len(directions) / MAX_CELLS)
        self.cells = int(np.ceil(2.0 * radius / self.width)) + 2
        self.low = -0.5 * self.width * self.cells
        self.density = np.zeros((len(directions), self.cells))

    def fill(self) -> Iterator[Progress]:
        """Add all primitives."""
        chunk = max(1, CHUNK_PAIRS // len(self.directions))
        for start in range(0, len(self.primitives.areas), chunk):
            self._add(np.arange(start, min(start + chunk, len(self.primitives.areas))), 1.0)
            yield Progress(0.3 * start / len(self.primitives.areas), "filling the Hough space")

    def take_out(self, chosen: np.ndarray) -> None:
        """Remove the primitives `chosen`."""
        chunk = max(1, CHUNK_PAIRS // len(self.directions))
        for start in range(0, len(chosen), chunk):
            self._add(chosen[start : start + chunk], -1.0)

    def best(self) -> tuple[np.ndarray, float, float]:
        """Normal (3,), offset of the middle, and density of the fullest cell."""
        row, column = divmod(int(self.density.argmax()), self.cells)
        return self.directions[row], self.low + (column + 0.5) * self.width, float(self.density[row, column])

    def _add(self, chosen: np.ndarray, sign: float) -> None:
        error = self.primitives.error
        rho = self.primitives.corners[chosen] @ self.directions.T
        low, high = rho.max(axis=1) - error, rho.min(axis=1) + error
        facing = self.primitives.normals[chosen] @ self.directions.T
        valid = low <= high
        weight = sign * np.where(valid, np.abs(facing), 0.0) * self.primitives.areas[chosen, None]
        # Along rho a primitive first takes area away and then adds it, or the other way round: three changes either way.
        front, missed = facing > 0.0, MISSED_WEIGHT * weight
        steps = (
            (np.where(front, low - MISSED_WIDTH * error, low), 0, np.where(front, -missed, weight)),
            (np.where(front, low, high), ~front, np.where(front, weight + missed, -weight - missed)),
            (np.where(front, high, high + MISSED_WIDTH * error), 1, np.where(front, -weight, missed)),
        )
        row = np.arange(len(self.directions)) * self.cells
        cells = np.concatenate([(row + self._cell(rho) + after).ravel() for rho, after, _ in steps])
        amounts = np.concatenate([amount.ravel() for _, _, amount in steps])
        changes = np.bincount(cells, amounts, minlength=self.density.size).reshape(self.density.shape)
        self.density += np.cumsum(changes, axis=1, out=changes)

    def _cell(self, rho: np.ndarray) -> np.ndarray:
        return ((rho - self.low) / self.width).astype(np.int64)


def _within(primitives: _Primitives, normal: np.ndarray, offset: float) -> np.ndarray:
    """(T,) bool: all corners lie within the error of the plane."""
    return (np.abs(primitives.corners @ normal - offset) <= primitives.error).all(axis=1)


def _next_plane(primitives: _Primitives, space: _HoughSpace, taken_by: np.ndarray) -> tuple[np.ndarray, float]:
    """The plane of the fullest cell, refined; or, where no plane of a cell holds what is left, the own plane of the largest primitive."""
    normal, offset, density = space.best()
    left = np.flatnonzero(taken_by < 0)
    if density > 0.0:
        normal, offset, gain = _refine(primitives, left, normal, offset, np.sqrt(2.0 * np.pi / len(space.directions)))
        if gain > 0.0:
            return normal, offset
    largest = left[primitives.areas[left].argmax()]
    normal = primitives.normals[largest]
    rho = primitives.corners[largest] @ normal
    return _refine(primitives, left, normal, 0.5 * (rho.min() + rho.max()), 0.0)[:2]


def _refine(primitives: _Primitives, left: np.ndarray, normal: np.ndarray, offset: float, spread: float) -> tuple[np.ndarray, float, float]:
    """The plane near (normal, offset) that covers the most projected area of the primitives `left`, and that area.

    The patch of directions `spread` radians wide is searched on a grid of 3 x 3 that halves around its best direction; the offset is found
    exactly for each direction, as the most covered point of the intervals of rho.
    """
    corners = primitives.corners[left]
    heights = np.abs(corners @ normal - offset)
    covered = (heights <= primitives.error).all(axis=1)
    pivot = corners[covered].mean(axis=(0, 1)) if covered.any() else np.zeros(3)
    reach = 2.0 * primitives.error + 1.5 * spread * np.linalg.norm(corners - pivot, axis=2)
    near = (heights <= reach).all(axis=1)
    corners, areas, normals = corners[near], primitives.areas[left][near], primitives.normals[left][near]
    best_offset, best_gain = _best_offset(corners, areas, normals, normal, primitives.error)
    step = 0.5 * spread
    for _ in range(REFINEMENTS if spread > 0.0 else 0):
        for candidate in _around(normal, step):
            found, gain = _best_offset(corners, areas, normals, candidate, primitives.error)
            if gain > best_gain:
                normal, best_offset, best_gain = candidate, found, gain
        step *= 0.5
    return normal, best_offset, best_gain


def _around(normal: np.ndarray, step: float) -> np.ndarray:
    """(8, 3) unit normals on a square of half side `step` around `normal`."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    turns = np.array([(u, v) for u in (-1.0, 0.0, 1.0) for v in (-1.0, 0.0, 1.0) if u or v]) * np.tan(step)
    turned = normal + turns[:, :1] * first + turns[:, 1:] * second
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _best_offset(corners: np.ndarray, areas: np.ndarray, normals: np.ndarray, normal: np.ndarray, error: float) -> tuple[float, float]:
    """The offset of the plane along `normal` that covers the most projected area, and that area."""
    rho = corners @ normal
    low, high = rho.max(axis=1) - error, rho.min(axis=1) + error
    valid = low <= high
    if not valid.any():
        return 0.0, 0.0
    facing = normals[valid] @ normal
    # A face seen edge-on still has to be covered by some plane, so it counts a little.
    weight = (np.abs(facing) + 0.01) * areas[valid]
    low, high = low[valid], high[valid]
    ends = np.concatenate([low, high])
    ranked = np.lexsort((np.repeat([0, 1], len(low)), ends))
    covered = np.cumsum(np.concatenate([weight, -weight])[ranked])
    top = int(covered.argmax())
    return 0.5 * float(ends[ranked[top]] + ends[ranked[min(top + 1, len(ranked) - 1)]]), float(covered[top])


def _regions(primitives: _Primitives, planes: list[tuple[np.ndarray, float]], taken_by: np.ndarray, center: np.ndarray) -> Planes:
    """All that lies on each plane, in compact regions; each primitive then belongs to the region that it faces best."""
    normals, offsets, covers = [], [], []
    owner = np.full(len(taken_by), -1, np.int32)
    best_facing = np.full(len(taken_by), -1.0)
    for index, (normal, offset) in enumerate(planes):
        near = np.flatnonzero(_within(primitives, normal, offset))
        facing = np.abs(primitives.normals[near] @ normal)
        for members in split_into_regions(primitives.corners[near], taken_by[near] == index, normal, primitives.error):
            better = near[members & (facing > best_facing[near])]
            best_facing[better] = np.abs(primitives.normals[better] @ normal)
            owner[better] = len(covers)
            covers.append(near[members].astype(np.int32))
            normals.append(normal)
            offsets.append(offset + float(normal @ center))
    used, owner = np.unique(owner, return_inverse=True)
    return Planes(np.array(normals)[used], np.array(offsets)[used], [covers[index] for index in used], owner.astype(np.int32).ravel())
