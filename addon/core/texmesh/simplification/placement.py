"""Moves of kept vertices to where they cost least, as far as no triangle folds over."""

from typing import Protocol

import numpy as np

from ...geometry.collapses import measure_quality
from ...geometry.mesh import scaled_normals
from .collapse_fans import MIN_NORMAL_COSINE, MIN_QUALITY, Surface

MAX_ATTEMPTS = 12  # until moves that fold triangles are given up
HALVINGS = 3  # in the first attempts; then the vertices stay


class VertexPlacement(Protocol):
    """A cost that tells where vertices should be."""

    def find_steps(self, vertices: np.ndarray, limits: np.ndarray) -> np.ndarray:
        """Return the steps (N, 3) to where `vertices` (N,) cost least, at most as long as `limits` (N,)."""

    def move(self, vertices: np.ndarray, steps: np.ndarray, owners: np.ndarray, wedges: np.ndarray) -> None:
        """Take note that `vertices` (N,) have moved by `steps` (N, 3), and with them their `wedges` (M,), which `owners` (M,) assigns."""


def shorten_steps(surface: Surface, triangles: np.ndarray, vertices: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return `steps` (N, 3) of `vertices` (N,), shorter where they would turn triangles too far, turn them away from the fine mesh, or
    make them slivers. triangles: (3, T), all that have any of the vertices."""
    rows = np.full(surface.positions.shape[1], -1)
    rows[vertices] = np.arange(len(vertices))
    rows = rows[triangles]
    corners = surface.positions[:, triangles].transpose(2, 1, 0)
    facing = surface.normals[:, triangles].sum(axis=1).T
    before = scaled_normals(corners)
    is_facing = np.einsum("ti,ti->t", before, facing) > 0.0
    quality = _measure_quality(corners, before)
    steps = steps.copy()
    for attempt in range(MAX_ATTEMPTS):
        moved = corners + np.where(rows.T[:, :, None] >= 0, steps[rows.T], 0.0)
        after = scaled_normals(moved)
        lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        is_bad = np.einsum("ti,ti->t", before, after) < MIN_NORMAL_COSINE * lengths
        is_bad |= is_facing & (np.einsum("ti,ti->t", after, facing) <= 0.0)
        is_bad |= _measure_quality(moved, after) < np.minimum(quality, MIN_QUALITY)
        worst = rows[:, is_bad]
        worst = np.unique(worst[worst >= 0])
        if not len(worst) or not steps[worst].any():
            return steps
        steps[worst] *= 0.5 if attempt < HALVINGS else 0.0
    return np.zeros_like(steps)


def _measure_quality(corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the qualities (T,) of triangles `corners` (T, 3, 3) with `normals` (T, 3), twice the area long."""
    squares = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=(1, 2))
    return measure_quality(np.linalg.norm(normals, axis=1), squares)
