"""Edge splits of a level where it is farthest from the fine mesh."""

from dataclasses import replace

import numpy as np

from ...geometry.mesh import face_areas_and_normals
from .edge_flips import select_largest
from .level_state import LevelState, attach

SHORT_EDGE_FACTOR = 0.25  # of the deviation that counts for edges that are not the longest of their triangle


def split_edges(state: LevelState, count: int) -> LevelState:
    """Return the level with up to `count` edges split at their middle: those beside triangles with the largest deviation along the normal.

    Each adds two triangles. Seams and boundaries are not split. No two of the edges have a triangle in common.
    """
    mesh = state.mesh
    edges = state.find_edges()
    first, second = edges.interior_halfedges[~mesh.find_seams(edges)[edges.interior]].T
    peaks = find_peaks(state)
    lengths = np.linalg.norm(_end_points(state, first, 1) - _end_points(state, first, 2), axis=1)
    areas, _ = face_areas_and_normals(state.corners)
    longest = np.zeros(len(mesh.triangles))
    for halfedges in (first, second):
        np.maximum.at(longest, halfedges // 3, lengths)
    peaks_beside = [
        np.where(lengths >= longest[halfedges // 3], 1.0, SHORT_EDGE_FACTOR) * peaks[halfedges // 3] for halfedges in (first, second)
    ]
    scores = np.maximum(*peaks_beside) * ((areas[first // 3] > 0.0) & (areas[second // 3] > 0.0))
    chosen = select_largest(scores, np.stack([first // 3, second // 3], axis=1), len(mesh.triangles))
    chosen = chosen[np.argsort(-scores[chosen], kind="stable")[:count]]
    return _split(state, first[chosen], second[chosen])


def find_peaks(state: LevelState) -> np.ndarray:
    """Return the largest distance (T,) of the samples of each triangle from its plane."""
    _, normals = face_areas_and_normals(state.corners)
    triangles = state.found.triangles
    along = np.abs(np.einsum("ni,ni->n", state.residuals, normals[triangles]))
    peaks = np.zeros(len(state.islands))
    np.maximum.at(peaks, triangles, along)
    return peaks


def _end_points(state: LevelState, halfedges: np.ndarray, step: int) -> np.ndarray:
    """Return the positions (N, 3) of the starts, step 1, or ends, step 2, of halfedges (N,)."""
    return state.mesh.vertices[state.mesh.triangles[halfedges // 3, (halfedges % 3 + step) % 3]]


def _split(state: LevelState, first: np.ndarray, second: np.ndarray) -> LevelState:
    """Return the level with the edges of the halfedges `first` and `second` (K,) split."""
    mesh, count = state.mesh, len(first)
    vertices = len(mesh.vertices) + np.arange(count, dtype=np.int32)
    wedges = len(mesh.uvs) + np.arange(count, dtype=np.int32)
    faces, corners = first // 3, first % 3
    starts, ends = (mesh.wedge_triangles[faces, (corners + step) % 3] for step in (1, 2))
    midpoints = 0.5 * (_end_points(state, first, 1) + _end_points(state, first, 2))
    arrays = {"triangles": (mesh.triangles, vertices), "wedge_triangles": (mesh.wedge_triangles, wedges)}
    sides = np.concatenate([first, second])
    faces, corners = sides // 3, sides % 3
    rows = np.arange(len(sides))
    changed = {}
    for name, (old, added) in arrays.items():
        added = np.tile(added, 2)
        near, far = old[faces].copy(), old[faces].copy()
        near[rows, (corners + 2) % 3], far[rows, (corners + 1) % 3] = added, added
        result = old.copy()
        result[faces] = near
        changed[name] = np.concatenate([result, far])
    split = replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, midpoints]),
        wedge_vertices=np.concatenate([mesh.wedge_vertices, vertices]),
        uvs=np.concatenate([mesh.uvs, 0.5 * (mesh.uvs[starts] + mesh.uvs[ends])]),
        attributes=np.concatenate([mesh.attributes, 0.5 * (mesh.attributes[starts] + mesh.attributes[ends])]),
        materials=np.concatenate([mesh.materials, mesh.materials[faces]]),
        sources=np.concatenate([mesh.sources, mesh.sources[faces]]),
        **changed,
    )
    return attach(split, np.concatenate([state.islands, state.islands[faces]]), state.samples, state.normal_weight, state.found.triangles)
