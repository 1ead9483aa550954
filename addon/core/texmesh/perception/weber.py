"""Weber's law for changes of shape (section IV.B): a refinement matters if its largest displacement is a noticeable part of the object."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import spsolve_triangular

from ...geometry.mesh import face_areas_and_normals, vertex_normals
from ..settings import TexmeshSettings

MAX_CANDIDATES = 8  # displacements of a scale whose thickness is measured: casting a line costs a pass over all triangles
MIN_LENGTH = 1e-6  # Relative to the diagonal; a shorter cross-section is that of a line which only touches the surface.
BORDER = 1e-9  # barycentric coordinate of a line that meets an edge


@dataclass(frozen=True, eq=False)
class Collapses:
    """Vertices that were removed from a mesh, in any order.

    removed, kept: (N,) indices, in the order of the collapses. values: (N,) float64, distances to mean planes, each with
    those of the vertices that had collapsed onto it. scales: (N,) the finest scale that contains the removed vertex; refining from scale i
    to i - 1 adds those of scale i - 1.
    """

    removed: np.ndarray
    kept: np.ndarray
    values: np.ndarray
    scales: np.ndarray


@dataclass(frozen=True, eq=False)
class Impacts:
    """How noticeable each refinement is.

    Row i - 1 is the refinement from scale i to i - 1.

    Attributes:
        values: (S,) largest displacement.
        lengths: (S,) what it is relative to.
        fractions: (S,) their quotient, 0 where nothing is added.
        vertices: (S,) removed vertex with that displacement, -1 where nothing is added.
        is_noticed: (S,) bool, above the threshold.
    """

    values: np.ndarray
    lengths: np.ndarray
    fractions: np.ndarray
    vertices: np.ndarray
    is_noticed: np.ndarray


def measure_impacts(
    vertices: np.ndarray, triangles: np.ndarray, collapses: Collapses, scale_count: int, settings: TexmeshSettings
) -> Impacts:
    """Return the Weber fraction of each refinement between `scale_count` + 1 scales, and whether it exceeds the threshold.

    Args:
        vertices, triangles: (V, 3) float64 and (T, 3), the mesh before any collapse.
    """
    kind = settings.perceptual_value
    displacements = _quadric_distances(vertices, triangles, collapses) if kind == "quadric" else accumulate_within_scales(collapses)
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    normals = _vertex_normals(vertices, triangles)
    values, lengths, rows = np.zeros(scale_count), np.full(scale_count, diagonal), np.full(scale_count, -1)
    for scale in range(scale_count):
        added = np.flatnonzero(collapses.scales == scale)
        if not len(added):
            continue
        order = added[np.argsort(-displacements[added], kind="stable")]
        if kind == "center":
            found = np.maximum(np.linalg.norm(vertices[collapses.kept[order]] - center, axis=1), MIN_LENGTH * diagonal)
        elif kind == "skeleton":
            order = order[:MAX_CANDIDATES]
            ends = collapses.kept[order]
            found = np.array([0.5 * measure_thickness(vertices, triangles, vertices[end], normals[end]) for end in ends])
        else:
            order = order[:1]
            position, direction = vertices[collapses.removed[order[0]]], normals[collapses.removed[order[0]]]
            found = np.array([measure_cross_section(vertices, triangles, position, direction)])
        best = int(np.argmax(displacements[order] / found))
        values[scale], lengths[scale], rows[scale] = displacements[order[best]], found[best], collapses.removed[order[best]]
    fractions = values / lengths
    return Impacts(values, lengths, fractions, rows, fractions > settings.weber_threshold)


def accumulate_within_scales(collapses: Collapses) -> np.ndarray:
    """Return perceptual values (N,) float64 that count what a refinement adds at once: the value of each removed vertex and of those of the
    same scale that had collapsed onto it (Figure 12)."""
    count = len(collapses.removed)
    position = np.full(max(int(collapses.removed.max(initial=-1)), int(collapses.kept.max(initial=-1))) + 1, -1)
    position[collapses.removed] = np.arange(count)
    onto = position[collapses.kept]  # the later collapse of the kept vertex, -1 if it stays
    followed = np.flatnonzero(onto >= 0)
    own = collapses.values - np.bincount(onto[followed], collapses.values[followed], count)
    same = followed[collapses.scales[followed] == collapses.scales[onto[followed]]]
    links = csr_array((np.full(len(same), -1.0), (onto[same], same)), shape=(count, count))
    return spsolve_triangular(eye_array(count, format="csr") + links, own, lower=True, unit_diagonal=True) if count else own


def measure_cross_section(vertices: np.ndarray, triangles: np.ndarray, position: np.ndarray, direction: np.ndarray) -> float:
    """Return the length of the object along the line through `position` (3,) in `direction` (3,), a unit vector: from the first to the
    last point on the surface. If the line only touches the surface, it is the extent of the object in this direction."""
    distances = _cast_line(vertices, triangles, position, direction)
    length = float(np.ptp(np.concatenate([distances, [0.0]])))
    return length if length > MIN_LENGTH * np.linalg.norm(np.ptp(vertices, axis=0)) else _extent(vertices, direction)


def measure_thickness(vertices: np.ndarray, triangles: np.ndarray, position: np.ndarray, normal: np.ndarray) -> float:
    """Return the distance from `position` (3,) on the surface to the opposite surface, against its `normal` (3,); the extent of the object
    in this direction if there is none. Half of it approximates the distance to the skeleton."""
    distances = -_cast_line(vertices, triangles, position, normal)
    inside = distances[distances > MIN_LENGTH * np.linalg.norm(np.ptp(vertices, axis=0))]
    return float(inside.min()) if len(inside) else _extent(vertices, normal)


def _extent(vertices: np.ndarray, direction: np.ndarray) -> float:
    """Return the extent of `vertices` in `direction`, at least a small part of the diagonal."""
    return max(float(np.ptp(vertices @ direction)), MIN_LENGTH * float(np.linalg.norm(np.ptp(vertices, axis=0))))


def _cast_line(vertices: np.ndarray, triangles: np.ndarray, position: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the signed distances (N,) along a line at which it meets triangles."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    right = np.cross(direction, helper)
    right /= np.linalg.norm(right)
    relative = vertices - position
    near = triangles
    for axis in (right, np.cross(direction, right)):  # the line crosses only triangles with corners on both sides of two planes
        is_left = relative @ axis <= 0.0
        is_right = relative @ axis >= 0.0
        first, second, third = near.T
        near = near[(is_left[first] | is_left[second] | is_left[third]) & (is_right[first] | is_right[second] | is_right[third])]
    axes = np.stack([right, np.cross(direction, right), direction], axis=1)
    x, y, heights = (relative[near] @ axes).transpose(2, 1, 0)
    areas = np.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])
    total = areas.sum(axis=0)
    weights = areas / np.where(total != 0.0, total, np.inf)
    hit = (total != 0.0) & (weights >= -BORDER).all(axis=0)
    return (weights * heights).sum(axis=0)[hit]


def _vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return area-weighted unit normals (V, 3); +Z where they cancel. They stand for those of the mean planes of the neighbors."""
    normals = vertex_normals(vertices, triangles)
    return np.where(normals.any(axis=1, keepdims=True), normals, [0.0, 0.0, 1.0])


def _quadric_distances(vertices: np.ndarray, triangles: np.ndarray, collapses: Collapses) -> np.ndarray:
    """Return the root mean square (N,) distance of the kept vertices to the planes around the removed ones, weighted by area."""
    areas, normals = face_areas_and_normals(vertices[triangles])
    count, corners = len(vertices), triangles.ravel()
    weights = np.bincount(corners, np.repeat(areas, 3), count)
    products = areas[:, None, None] * normals[:, :, None] * normals[:, None, :]
    quadrics = np.stack([np.bincount(corners, np.repeat(column, 3), count) for column in products.reshape(-1, 9).T], axis=1)
    steps = vertices[collapses.kept] - vertices[collapses.removed]
    squares = np.einsum("ni,nij,nj->n", steps, quadrics[collapses.removed].reshape(-1, 3, 3), steps)
    totals = weights[collapses.removed]
    return np.sqrt(np.maximum(squares, 0.0) / np.where(totals > 0.0, totals, 1.0))
