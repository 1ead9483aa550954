"""Quadrics of shading normals, one per vertex: what collapses cost the shading of smooth surfaces.

The normals of a smooth triangle are a linear function of the position. Of the triangles that a vertex stands for, the mean of these
functions at a place is the best normal there, and their variance, integrated over the triangles, is what the shading loses. That keeps
narrow strips of triangles next to rounded edges. After Hoppe, "New Quadric Metric for Simplifying Meshes with Appearance Attributes", 1999,
section 3, with the attributes that cost least.
"""

import numpy as np

from ...arrays import TINY
from ...geometry.mesh import face_areas_and_normals, scaled_normals
from ..simplification.wedge_quadrics import POSITION_COLUMNS, POSITION_ROWS, evaluate_quadrics

LINEAR = slice(len(POSITION_ROWS), len(POSITION_ROWS) + 12)  # The sums of linear functions; the last column is that of weights.
MIN_SMOOTH_COSINE = np.cos(np.radians(2.0))  # between the normals of a vertex that has one normal


class NormalQuadrics:
    """Sums over the triangles of vertices. Vertices with several normals, as on hard edges, have none: levels divide them again."""

    def __init__(self, positions: np.ndarray, triangles: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> None:
        """positions: (V, 3). triangles: (T, 3). normals: (T, 3, 3) of their corners, unit vectors, zero on flat faces. weights: (T,), of
        squared differences between normals."""
        corners, count = positions[triangles], len(positions)
        _, faces = face_areas_and_normals(corners)
        is_behind = np.einsum("tci,ti->t", normals, faces) < 0.0
        normals = np.where(is_behind[:, None, None], -normals, normals)
        totals = np.zeros((count, 3))
        np.add.at(totals, triangles, normals)
        counts = np.bincount(triangles.ravel(), minlength=count)
        self._is_smooth = np.linalg.norm(totals, axis=1) >= MIN_SMOOTH_COSINE * np.maximum(counts, 1)
        functions = _find_functions(corners, normals)
        terms = np.empty((len(triangles), LINEAR.stop + 1))
        terms[:, : LINEAR.start] = np.einsum("tka,tka->ta", functions[:, :, POSITION_ROWS], functions[:, :, POSITION_COLUMNS])
        terms[:, LINEAR] = functions.reshape(-1, 12)
        terms[:, LINEAR.stop] = 1.0
        terms *= (weights / 3.0)[:, None]
        self._sums = np.zeros((count, LINEAR.stop + 1))
        for column in triangles.T:
            np.add.at(self._sums, column, terms)
        self._sums[~self._is_smooth] = 0.0

    def evaluate(self, removed: np.ndarray, kept: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return the costs (N,) of moving vertices `removed` (N,) onto those `kept` (N,), which are at `positions` (N, 3)."""
        sums = self._sums[removed] + self._sums[kept]
        squares = evaluate_quadrics(sums[:, : LINEAR.start], positions)
        homogeneous = np.column_stack([positions, np.ones(len(positions))])
        means = np.einsum("nka,na->nk", sums[:, LINEAR].reshape(-1, 3, 4), homogeneous)
        weights = sums[:, LINEAR.stop]
        return np.clip(squares - (means**2).sum(axis=1) / np.maximum(weights, TINY), 0.0, weights)

    def merge(self, removed: np.ndarray, kept: np.ndarray) -> None:
        """Take note that vertices `removed` (N,) have moved onto those `kept` (N,)."""
        rows = self._is_smooth[kept]
        np.add.at(self._sums, kept[rows], self._sums[removed[rows]])

    def append(self, vertices: np.ndarray) -> None:
        """Append copies of `vertices` (N,)."""
        self._sums, self._is_smooth = (np.concatenate([values, values[vertices]]) for values in (self._sums, self._is_smooth))


def _find_functions(corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the linear functions (T, 3, 4) of homogeneous positions that are `normals` (T, 3, 3) at `corners` (T, 3, 3), and constant
    across the triangles."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = scaled_normals(corners)
    squares = np.maximum(np.einsum("ti,ti->t", across, across), TINY)[:, None]
    gradients = np.einsum("tk,ta->tka", normals[:, 1] - normals[:, 0], np.cross(second, across) / squares)
    gradients += np.einsum("tk,ta->tka", normals[:, 2] - normals[:, 0], np.cross(across, first) / squares)
    constants = normals[:, 0] - np.einsum("tka,ta->tk", gradients, corners[:, 0])
    return np.concatenate([gradients, constants[:, :, None]], axis=2)
