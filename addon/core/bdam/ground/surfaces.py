"""The ground that objects are put on: the finest data of a store, or the meshes that a scene shows."""

from collections.abc import Sequence

import numpy as np

from ...jobs.progress import Progress, Steps
from ..store.terrain_store import TerrainStore
from ..view.extraction import extract_uniform_cut
from .heights import HeightQuery, evaluate_planes
from .triangle_search import TriangleSearch

POINTS_PER_STEP = 1 << 16


class StoreSurface:
    """The finest triangles of a store, whose heights are multiplied by `exaggeration`, in the space of a terrain.

    Coarser patches replace those that turn out to be damaged, see `store.patch_links`. damages: sentences about these.
    """

    def __init__(self, store: TerrainStore, exaggeration: float) -> None:
        self._store, self._query, self._exaggeration = store, HeightQuery(store), exaggeration
        self.damages: list[str] = []

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (N,) float64 and unit normals (N, 3) float64 at `points` (N, 2), NaN where there is no ground."""
        for attempt in self._store.attempts():
            if attempt:
                self._query = HeightQuery(self._store, extract_uniform_cut(self._store, 0.0))
            heights, normals = self._query.find(points)
            self.damages += [sentence for sentence in self._query.damages if sentence not in self.damages]
        normals = normals / [1.0, 1.0, self._exaggeration]
        return heights * self._exaggeration, normals / np.linalg.norm(normals, axis=1, keepdims=True)


class MeshSurface:
    """Meshes that cover each place at most once, except for their common borders, in the space of a terrain."""

    def __init__(self, meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """meshes: vertices (V, 3) float64 and triangles (T, 3) int, counterclockwise from above."""
        self._corners = [positions[triangles] for positions, triangles in meshes if len(triangles)]
        self._searches = [TriangleSearch(positions[:, :2], triangles) for positions, triangles in meshes if len(triangles)]
        self.damages: list[str] = []

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights and normals; see `StoreSurface.find`."""
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


Surface = StoreSurface | MeshSurface


def find_ground(surface: Surface, points: np.ndarray) -> Steps[tuple[np.ndarray, np.ndarray]]:
    """Return heights (N,) and normals (N, 3) of a surface at any number of `points` (N, 2)."""
    heights, normals = np.empty(len(points)), np.empty((len(points), 3))
    for start in range(0, len(points), POINTS_PER_STEP):
        yield Progress(start / len(points), "Finding heights")
        part = slice(start, start + POINTS_PER_STEP)
        heights[part], normals[part] = surface.find(points[part])
    return heights, normals
