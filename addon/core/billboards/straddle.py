"""Move the vertices of a coarse mesh so that its surface straddles the fine one, at half the distance of one that only touches it."""

import numpy as np
from scipy.sparse import csr_matrix, diags, identity, kron
from scipy.sparse.linalg import spsolve

from ..distance import closest_on_mesh, closest_weights
from ..mesh import face_areas_and_normals

DAMPING = 1e-2  # of the mean diagonal of the normal equations
SPRINGS = 3e-3  # of the same
LEAST_WEIGHT = 3e-2
EXACT = 1e-12  # of the longest side: no distance that a move could lower


def straddle(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, powers: tuple[float, ...]) -> np.ndarray:
    """Vertices (V, 3) that bring the triangles nearer to `samples` (S, 3): the best of the start and of each step.

    Every step solves for the vertex moves that lower the sum of |distance|^power, linearised at the closest points (iteratively
    reweighted least squares). One step a power; high powers lower the largest distance.
    """
    best, best_distance = vertices, np.inf
    for power in (*powers, None):
        corners = vertices[triangles]
        distances, nearest = closest_on_mesh(samples, corners)
        largest = float(distances.max())
        if largest < best_distance:
            best, best_distance = vertices, largest
        if power is None or largest <= EXACT * np.ptp(samples, axis=0).max():
            break
        weights = closest_weights(samples, corners[nearest])
        away = samples - np.einsum("nk,nkj->nj", weights, corners[nearest])
        _, normals = face_areas_and_normals(corners)
        apart = distances > 1e-6 * largest
        directions = np.where(apart[:, None], away / np.where(apart, distances, 1.0)[:, None], normals[nearest])
        emphasis = (distances / largest) ** (power - 2.0) + LEAST_WEIGHT
        # A full reweighted step overshoots by power - 1: that much less is the Newton step.
        moves = solve_moves(vertices, triangles, nearest, weights, directions, distances, emphasis)
        vertices = vertices + moves / max(power - 1.0, 1.0)
    return best


def solve_moves(
    vertices: np.ndarray,
    triangles: np.ndarray,
    chosen: np.ndarray,
    weights: np.ndarray,
    directions: np.ndarray,
    residuals: np.ndarray,
    emphasis: np.ndarray,
    stiffness: float = SPRINGS,
) -> np.ndarray:
    """Vertex moves (V, 3) that take the points at `weights` (N, 3) on the triangles `chosen` (N,) by `residuals` (N,) along `directions`.

    directions (N, 3) are unit vectors. Least squares weighted by `emphasis` (N,), damped, with springs along the edges that keep the mesh
    from folding, as stiff as `stiffness`; no move is longer than the largest residual.
    """
    count = 3 * len(vertices)
    columns = (3 * triangles[chosen][:, :, None] + np.arange(3)).reshape(-1)
    values = (weights[:, :, None] * directions[:, None, :]).reshape(-1)
    rows = csr_matrix((values, columns, np.arange(0, len(columns) + 1, 9)), shape=(len(residuals), count))
    normal_matrix = rows.T @ rows.multiply(emphasis[:, None])
    scale = max(float(normal_matrix.diagonal().mean()), 1e-300)
    springs = stiffness * scale * _edge_springs(triangles, len(vertices))
    right = rows.T @ (emphasis * residuals) - springs @ vertices.ravel()
    moves = spsolve((normal_matrix + springs + DAMPING * scale * identity(count)).tocsc(), right).reshape(-1, 3)
    lengths = np.linalg.norm(moves, axis=1)
    return moves * np.minimum(1.0, np.abs(residuals).max() / np.where(lengths > 0.0, lengths, 1.0))[:, None]


def _edge_springs(triangles: np.ndarray, count: int) -> csr_matrix:
    """(3 count, 3 count) matrix K with x' K x the mean squared edge length around each vertex, summed."""
    start, stop = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    degree = 1.0 / np.maximum(np.bincount(triangles.ravel(), minlength=count), 1.0)
    stiffness = 0.5 * (degree[start] + degree[stop])
    links = csr_matrix((stiffness, (start, stop)), shape=(count, count))
    links = links + links.T
    laplacian = diags(np.asarray(links.sum(axis=1)).ravel()) - links
    return kron(laplacian, identity(3)).tocsr()
