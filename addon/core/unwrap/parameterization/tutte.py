"""Tutte embedding: an initial uv without flipped triangles. The boundary is fixed to a convex outline, and every interior vertex is at a
weighted mean of its neighbors (Tutte 1963; mean value weights, Floater 2003), improved by the reweighting of Yoshizawa, Belyaev and Seidel
(2004)."""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ...arrays import TINY
from ..energies.rest_shapes import compute_rest_shapes, half_angle_tangents
from ..energies.stretch_energy import squared_stretches

MAX_REWEIGHTINGS = 10
MIN_SCALE = 1e-6  # Minimum ratio of lengths in the map to lengths on the surface.
MIN_RELATIVE_WEIGHT = 1e-6  # Relative to the median: mean value weights may vanish where a triangle has no area.


def tutte_embedding(vertices: np.ndarray, triangles: np.ndarray, boundary: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    """Return the uv (V, 2) of a disk; None where triangles become too small for double precision, as in long closed ends.

    Args:
        vertices: (V, 3); those of no triangle stay at 0.
        triangles: (T, 3).
        boundary: (B,) vertices of the boundary loop.
        outline: (B, 2) their positions, convex and counter-clockwise.
    """
    weights = _mean_value_weights(vertices, triangles)
    shapes = compute_rest_shapes(vertices[triangles])
    best, min_stretch = None, np.inf
    for _ in range(MAX_REWEIGHTINGS):
        uv = _solve(weights, boundary, outline)
        squared = np.full(len(triangles), np.inf) if uv is None else squared_stretches(shapes, triangles, uv)
        stretch = float(shapes.areas @ squared)
        if not stretch < min_stretch or squared.max() > MIN_SCALE**-2:
            break
        best, min_stretch = uv, stretch
        weighted = np.bincount(triangles.ravel(), np.repeat(shapes.areas * squared, 3), len(vertices))
        areas = np.bincount(triangles.ravel(), np.repeat(shapes.areas, 3), len(vertices))
        weights = weights @ sparse.diags_array(1.0 / np.sqrt(np.maximum(weighted, TINY) / np.maximum(areas, TINY)))
    return best


def circle_outline(lengths: np.ndarray) -> np.ndarray:
    """Return positions (B, 2) on a circle of area 1, counter-clockwise, with distances in proportion to `lengths` (B,)."""
    angles = 2.0 * np.pi * _arc_length_parameters(lengths)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1) / np.sqrt(np.pi)


def square_outline(lengths: np.ndarray, bulge: float) -> np.ndarray:
    """Return positions (B, 2) on the unit square, counter-clockwise. The four points closest to quarters of the length are its corners.

    bulge: how far the middle of each side is moved outwards, for triangles with all corners on one side.
    """
    parameters = _arc_length_parameters(lengths)
    square_parameters = np.interp(parameters, np.append(parameters[_find_corners(parameters)], 1.0), np.arange(5.0))
    side, t = np.divmod(np.minimum(square_parameters, np.nextafter(4.0, 0.0)), 1.0)
    directions = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    starts = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    side = side.astype(int)
    offsets = 4.0 * bulge * t * (1.0 - t)
    return starts[side] + t[:, None] * directions[side] - offsets[:, None] * directions[(side + 1) % 4]


def _find_corners(parameters: np.ndarray) -> np.ndarray:
    """Return the indices of four different `parameters` (B,) close to 0, 1/4, 1/2 and 3/4, the first of them 0. B is 4 or more."""
    corners = [0]
    for quarter in (1, 2, 3):
        closest = int(np.abs(parameters - 0.25 * quarter).argmin())
        corners.append(min(max(closest, corners[-1] + 1), len(parameters) - (4 - quarter)))
    return np.array(corners)


def _arc_length_parameters(lengths: np.ndarray) -> np.ndarray:
    """Return the normalized arc length (B,) of the vertices of a loop, from 0 to 1; edges of length 0 get a small one."""
    lengths = np.maximum(lengths, 1e-3 * lengths.mean()) if lengths.any() else np.ones(len(lengths))
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) / lengths.sum()


def _mean_value_weights(vertices: np.ndarray, triangles: np.ndarray) -> sparse.csr_array:
    """Return mean value weights (V, V) of each row's vertex for its neighbors, all above 0."""
    rows, columns, values = [], [], []
    for corner in range(3):
        center, first, second = (triangles[:, (corner + offset) % 3] for offset in range(3))
        to_first, to_second = vertices[first] - vertices[center], vertices[second] - vertices[center]
        first_lengths, second_lengths = _positive_lengths(to_first), _positive_lengths(to_second)
        double_areas = np.linalg.norm(np.cross(to_first, to_second), axis=1)
        tangents = half_angle_tangents(to_first, to_second, first_lengths, second_lengths, double_areas, 1e-6)
        rows += [center, center]
        columns += [first, second]
        values += [tangents / first_lengths, tangents / second_lengths]
    weights = np.concatenate(values)
    weights = np.maximum(weights, MIN_RELATIVE_WEIGHT * np.median(weights) or 1.0)
    return sparse.csr_array((weights, (np.concatenate(rows), np.concatenate(columns))), shape=(len(vertices),) * 2)


def _positive_lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths (T,) of `vectors` (T, 3), limited to be above 0."""
    lengths = np.linalg.norm(vectors, axis=1)
    return np.maximum(lengths, 1e-6 * lengths.mean() or 1.0)


def _solve(weights: sparse.csr_array, boundary: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    """Return the uv (V, 2) with all interior vertices at the means of their neighbors by `weights` (V, V); None if that is singular."""
    uv = np.zeros((weights.shape[0], 2))
    uv[boundary] = outline
    totals = weights.sum(axis=1)
    is_interior = totals > 0.0
    is_interior[boundary] = False
    interior = np.flatnonzero(is_interior)
    if len(interior):
        means = sparse.diags_array(1.0 / totals[interior]) @ weights[interior]
        system = sparse.eye_array(len(interior), format="csc") - means[:, interior].tocsc()
        try:
            uv[interior] = splu(system.tocsc()).solve(means[:, boundary] @ outline)
        except RuntimeError:  # Singular.
            return None
    return uv
