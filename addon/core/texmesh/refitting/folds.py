"""Vertices stay where moves would turn triangles over."""

import numpy as np

from ...geometry.mesh import scaled_normals
from .fine_surface import FineSurface
from .level_state import LevelState

MAX_ROUNDS = 6  # of vertices that stay because of those that stayed before


def avoid_folds(state: LevelState, vertices: np.ndarray) -> np.ndarray:
    """Return `vertices` (V, 3), but those of triangles that would turn over stay where they are in `state`."""
    before = scaled_normals(state.corners)
    is_folded = np.einsum("ti,ti->t", before, scaled_normals(vertices[state.mesh.triangles])) < 0.0
    result = vertices.copy()
    stays = state.mesh.triangles[is_folded]
    result[stays] = state.mesh.vertices[stays]
    return result


def unfold(state: LevelState, vertices: np.ndarray, surface: FineSurface) -> np.ndarray:
    """Return `vertices` (V, 3), but those of triangles stay that would turn away from the fine surface, or would turn over without turning
    toward it."""
    mesh, result = state.mesh, vertices.copy()
    before = scaled_normals(state.corners)
    for _ in range(MAX_ROUNDS):
        after = scaled_normals(result[mesh.triangles])
        rows = np.flatnonzero(np.einsum("ti,ti->t", before, after) < 0.0)
        if not len(rows):
            break
        normals = surface.find_normals(state.corners[rows].mean(axis=1), mesh.corner_uvs[rows].mean(axis=1), state.islands[rows])
        stays = mesh.triangles[rows[np.einsum("ti,ti->t", normals, after[rows]) < 0.0]]
        if not len(stays):
            break
        result[stays] = mesh.vertices[stays]
    return result
