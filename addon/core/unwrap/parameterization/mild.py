"""Flattens charts that need little distortion: a conformal map, made as rigid as possible by a few linear solves.

Levy et al.: Least squares conformal maps, 2002; Liu et al.: A local/global approach to mesh parameterization, 2008.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ...arrays import TINY
from ...geometry.transforms import signed_areas
from ..cutting.chart import Chart
from ..energies.boundary_barrier import overlaps_itself
from ..energies.rest_shapes import RestShapes, compute_rest_shapes
from ..energies.stretch_energy import compute_jacobians

MAX_EXCESS = 0.01  # Of symmetric Dirichlet energy; other charts need a descent of energy.
MAX_TRIANGLE_ENERGY = 3.0  # The energy of any triangle, relative to that of an isometry.
SOLVES = 6  # Of the local/global method.
MAX_TRIANGLES = 50_000  # A factorization of more takes longer, and much more memory, than a descent from coarse to fine.


def flatten_mild(chart: Chart) -> np.ndarray | None:
    """Return uv (V, 2) of a chart, a disk, possibly with holes, without overlaps; None where distortion exceeds `MAX_EXCESS`, or the chart
    has more than `MAX_TRIANGLES`."""
    if len(chart.triangles) > MAX_TRIANGLES:
        return None
    scale = 1.0 / max(float(np.ptp(chart.vertices, axis=0).max()), TINY)
    shapes = compute_rest_shapes((chart.vertices[chart.triangles] - chart.vertices[0]) * scale)
    if not shapes.areas.min() > 0.0:
        return None
    by_x, by_y = _gradient_operators(shapes, chart.triangles, len(chart.vertices))
    uv = _conformal_uv(by_x, by_y, shapes.areas, chart.vertices)
    if uv is None:
        return None
    laplacian = (by_x.T * shapes.areas) @ by_x + (by_y.T * shapes.areas) @ by_y
    solver = _factorize(laplacian[1:, 1:])
    for _ in range(SOLVES if solver is not None else 0):
        xx, xy, yx, yy = compute_jacobians(shapes, chart.triangles, uv)
        cosine, sine = xx + yy, yx - xy
        length = np.maximum(np.hypot(cosine, sine), TINY)
        cosine, sine = shapes.areas * cosine / length, shapes.areas * sine / length  # The closest rotation of each triangle.
        right = np.stack([by_x.T @ cosine - by_y.T @ sine, by_x.T @ sine + by_y.T @ cosine], axis=1)
        uv = np.concatenate([np.zeros((1, 2)), solver.solve(right[1:])])
    return uv / scale if _is_good(shapes, chart.triangles, uv) else None


def _is_good(shapes: RestShapes, triangles: np.ndarray, uv: np.ndarray) -> bool:
    if not signed_areas(uv[triangles]).min() > 0.0:
        return False
    jacobians = compute_jacobians(shapes, triangles, uv)
    squares, determinants = jacobians.frobenius_squared, jacobians.determinants
    energies = 0.25 * (squares + squares / determinants**2)
    if shapes.areas @ energies > (1.0 + MAX_EXCESS) * shapes.areas.sum() or energies.max() > MAX_TRIANGLE_ENERGY:
        return False
    return not overlaps_itself(uv, triangles)


def _gradient_operators(shapes: RestShapes, triangles: np.ndarray, vertex_count: int) -> list[sparse.csr_array]:
    """Return the matrices (T, V) that map values at vertices to their derivatives along both directions of the rest shapes."""
    rows = np.repeat(np.arange(len(triangles)), 3)
    return [
        sparse.csr_array((np.asarray(gradients).T.ravel(), (rows, triangles.ravel())), shape=(len(triangles), vertex_count))
        for gradients in shapes.gradients
    ]


def _conformal_uv(by_x: sparse.csr_array, by_y: sparse.csr_array, areas: np.ndarray, vertices: np.ndarray) -> np.ndarray | None:
    """Return the least squares conformal uv (V, 2) with two distant vertices in place; None where it is not unique."""
    axis = int(np.ptp(vertices, axis=0).argmax())
    pinned = np.array([vertices[:, axis].argmin(), vertices[:, axis].argmax()])
    count, weights = len(vertices), np.sqrt(areas)[:, None]
    conformal = sparse.vstack([sparse.hstack([weights * by_x, -(weights * by_y)]), sparse.hstack([weights * by_y, weights * by_x])]).tocsc()
    free = np.setdiff1d(np.arange(2 * count), [*pinned, *(pinned + count)])
    values = np.zeros(2 * count)
    values[pinned[1]] = 1.0
    solver = _factorize(conformal[:, free].T @ conformal[:, free])
    if solver is None:
        return None
    values[free] = solver.solve(-(conformal[:, free].T @ (conformal @ values)))
    uv = values.reshape(2, count).T
    return uv if np.isfinite(uv).all() else None


def _factorize(matrix: sparse.sparray) -> object | None:
    try:
        return splu(matrix.tocsc())
    except RuntimeError:  # Singular.
        return None
