"""Regions of triangles from one photograph each: how well photographs show triangles, and the colors of vertices in these regions."""

from typing import NamedTuple

import numpy as np

from ..files.scratch import Scratch
from ..geometry.edges import Edges
from ..geometry.mesh import TriangleMesh
from .color_correction import ColorCorrection
from .leveling import VertexLabels, solve_corrections
from .photographs import Photograph
from .views import View

FACE_SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])  # barycentric


class VertexSurface(NamedTuple):
    """A mesh with unit normals of its vertices (V, 3) and of the corners of triangles (T, 3, 3), and its edges."""

    mesh: TriangleMesh
    normals: np.ndarray
    corner_normals: np.ndarray
    edges: Edges


class VertexColors(NamedTuple):
    """Encoded colors of vertices.

    colors: (V, 3), 0 where no photograph shows the vertex. bound: (V,) bool, where one does. corrections: (P, 3) float32, which are added
    to the colors of the photograph of each of P pairs of a vertex and a photograph.
    """

    colors: np.ndarray
    bound: np.ndarray
    corrections: np.ndarray


def rate_faces(surface: VertexSurface, views: list[View], scratch: Scratch) -> np.ndarray:
    """Return how well (T, K) float32 each of `views` shows each triangle, 0 if not all of it; `scratch` keeps their images."""
    corners, normals = surface.mesh.corners, surface.corner_normals
    qualities = np.zeros((len(corners), len(views)), np.float32)
    for index, view in enumerate(views):
        counts = np.zeros(len(corners), np.int32)
        for barycentric in FACE_SAMPLES:
            seen = view.see(np.einsum("i,tic->tc", barycentric, corners), _unit(np.einsum("i,tic->tc", barycentric, normals)))
            counts[seen.indices] += 1
            qualities[seen.indices, index] += seen.weights / np.float32(len(FACE_SAMPLES))
        qualities[counts < len(FACE_SAMPLES), index] = 0.0
        scratch.release(index)
    return qualities


def color_vertices(
    surface: VertexSurface,
    pairs: VertexLabels,
    photographs: list[Photograph],
    views: list[View],
    color_corrections: list[ColorCorrection],
    scratch: Scratch,
    *,
    is_leveled: bool,
) -> VertexColors:
    """Return the colors of vertices, from the photographs of the regions around them or otherwise from all that show them; `is_leveled`:
    corrected at the borders of regions so that these meet in the same color."""
    count = len(surface.mesh.vertices)
    corrections = np.zeros((len(pairs.keys), 3), np.float32)
    pair_colors, is_visible = np.zeros((len(pairs.keys), 3), np.float32), np.zeros(len(pairs.keys), bool)
    sums, weights = np.zeros((count, 3)), np.zeros(count)
    for index, (photograph, view, correction) in enumerate(zip(photographs, views, color_corrections, strict=True)):
        seen = view.see(surface.mesh.vertices, surface.normals)
        smooth, is_seen = np.zeros((count, 3), np.float32), np.zeros(count, bool)
        smooth[seen.indices] = correction.apply(photograph.smoothed().sample(seen.positions), seen.positions)
        is_seen[seen.indices] = True
        sums[seen.indices] += seen.weights[:, None] * smooth[seen.indices]
        weights[seen.indices] += seen.weights
        own = np.flatnonzero(pairs.photographs == index)
        pair_colors[own], is_visible[own] = smooth[pairs.vertices[own]], is_seen[pairs.vertices[own]]
        scratch.release(index)
    if is_leveled and len(pairs.keys):
        corrections = solve_corrections(pairs, pair_colors, is_visible, surface.edges)
    colors = np.where(weights[:, None] > 0.0, sums / np.maximum(weights, 1e-30)[:, None], 0.0)
    shown = pairs.weights * is_visible
    totals = np.bincount(pairs.vertices, shown, count)
    has_label = totals > 0.5
    for channel in range(3):
        leveled = np.bincount(pairs.vertices, shown * (pair_colors + corrections)[:, channel], count)
        colors[has_label, channel] = leveled[has_label] / totals[has_label]
    return VertexColors(colors, weights > 0.0, corrections)


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)
