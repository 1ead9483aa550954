"""The ground that objects are put on, straight above or below them."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..jobs.progress import Progress, Steps
from .triangle_search import TriangleSearch, evaluate_planes

POINTS_PER_STEP = 1 << 16


class Surface(Protocol):
    """Ground in the space of a terrain. damages: sentences about parts of it that cannot be read."""

    damages: list[str]

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (N,) float64 and unit normals (N, 3) float64 of the ground for `points` (N, 3), NaN where there is none."""


class MeshSurface:
    """Meshes that cover each place at most once, except for their common borders; see `Surface`."""

    def __init__(self, meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """meshes: vertices (V, 3) float64 and triangles (T, 3) int, counterclockwise from above."""
        self._corners = [positions[triangles] for positions, triangles in meshes if len(triangles)]
        self._searches = [TriangleSearch(positions[:, :2], triangles) for positions, triangles in meshes if len(triangles)]
        self.damages: list[str] = []

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights and normals; see `Surface.find`."""
        points = points[:, :2]
        heights, normals = np.full(len(points), np.nan), np.full((len(points), 3), np.nan)
        missing = np.flatnonzero(np.isfinite(points).all(axis=1))
        for corners, search in zip(self._corners, self._searches, strict=True):
            low, high = corners[..., :2].min(axis=(0, 1)), corners[..., :2].max(axis=(0, 1))
            candidates = missing[((points[missing] >= low) & (points[missing] <= high)).all(axis=1)]
            triangles = search.find(points[candidates])
            candidates, triangles = candidates[triangles >= 0], triangles[triangles >= 0]
            heights[candidates], normals[candidates] = evaluate_planes(points[candidates], corners[triangles])
            missing = missing[np.isnan(heights[missing])]
        return heights, normals


class SolidSurface:
    """Meshes of solid ground with caves and overhangs; see `Surface`.

    A point in the air is above the ground that it falls on. One in the rock, below which the next surface upwards faces up, is put on that
    surface. Where there is no ground below, it is the nearest one above.
    """

    def __init__(self, meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """meshes: vertices (V, 3) float64 and triangles (T, 3) int, counterclockwise from outside."""
        corners = np.concatenate([positions[triangles] for positions, triangles in meshes]) if meshes else np.zeros((0, 3, 3))
        edges = corners[:, 1:, :2] - corners[:, :1, :2]
        areas = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
        corners, self._is_floor = corners[areas != 0.0], areas[areas != 0.0] > 0.0
        corners[~self._is_floor] = corners[~self._is_floor, ::-1]
        self._corners = corners
        self._search = TriangleSearch(corners[..., :2].reshape(-1, 2), np.arange(3 * len(corners)).reshape(-1, 3)) if len(corners) else None
        self.damages: list[str] = []

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights and normals; see `Surface.find`."""
        heights, normals = np.full(len(points), np.nan), np.full((len(points), 3), np.nan)
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        if self._search is None or not len(finite):
            return heights, normals
        of_point, triangles, _ = self._search.find_all(points[finite, :2])
        of_point = finite[of_point]
        found, facing = evaluate_planes(points[of_point, :2], self._corners[triangles])
        above, is_floor = found - points[of_point, 2], self._is_floor[triangles]
        next_above = np.full(len(points), np.inf)
        np.minimum.at(next_above, of_point, np.where(above > 0.0, above, np.inf))
        is_buried = is_floor & (above == next_above[of_point])
        rank = np.where(is_buried, 0, np.where(above <= 0.0, 1, 2))
        of_point, rank, distance, found, facing = (array[is_floor] for array in (of_point, rank, np.abs(above), found, facing))
        order = np.lexsort((distance, rank, of_point))
        inside, first = np.unique(of_point[order], return_index=True)
        heights[inside], normals[inside] = found[order][first], facing[order][first]
        return heights, normals


def find_ground(surface: Surface, points: np.ndarray) -> Steps[tuple[np.ndarray, np.ndarray]]:
    """Return heights (N,) and normals (N, 3) of a surface for any number of `points` (N, 3)."""
    heights, normals = np.empty(len(points)), np.empty((len(points), 3))
    for start in range(0, len(points), POINTS_PER_STEP):
        yield Progress(start / len(points), "Finding heights")
        part = slice(start, start + POINTS_PER_STEP)
        heights[part], normals[part] = surface.find(points[part])
    return heights, normals
