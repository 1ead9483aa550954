"""Vertex fit: moves the vertices of a coarse mesh so that it lies between the extremes of the fine surface.

Such a mesh has half the distance of one that only touches the fine surface from one side.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags, identity, kron
from scipy.sparse.linalg import spsolve

from ...arrays import TINY
from ...geometry.distance import closest_barycentric
from ...geometry.mesh import face_areas_and_normals
from ...geometry.tracked_points import TrackedPoints

DAMPING = 1e-2  # Relative to the mean diagonal of the normal equations.
EDGE_REGULARIZATION = 3e-3  # Relative to the same.
MIN_WEIGHT = 3e-2  # Added to the weight of every sample, so that those already close keep the mesh in place.
EXACT_FIT = 1e-12  # A maximum distance below this fraction of the longest side cannot be lowered by displacements.
MIN_DIRECTION_DISTANCE = 1e-6  # Relative to the maximum distance. Closer samples use the triangle's normal as their direction.


@dataclass(frozen=True)
class FitTargets:
    """N points of a mesh and the displacements that they should get.

    Attributes:
        triangles: (N,) triangle of each point.
        barycentric: (N, 3) its coordinates there.
        directions: (N, 3) unit vectors.
        residuals: (N,) desired displacement along the direction, a length.
        weights: (N,) of the residuals in the least-squares sum.
    """

    triangles: np.ndarray
    barycentric: np.ndarray
    directions: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray


def fit_vertices(samples: TrackedPoints, vertices: np.ndarray, triangles: np.ndarray, powers: tuple[float, ...]) -> np.ndarray:
    """Move vertices (V, 3) to bring the triangles closer to `samples`. Returns the best of the start and of all steps.

    Every step solves for the displacements that lower the sum of |distance|^power, linearized at the closest points (iteratively
    reweighted least squares). `powers` has one entry per step; high powers lower the maximum distance.
    """
    best, best_distance = vertices, np.inf
    spring_matrix = build_spring_matrix(triangles, len(vertices))
    for power in (*powers, None):
        corners = vertices[triangles]
        distances, nearest = samples.find_closest(corners)
        max_distance = float(distances.max())
        if max_distance < best_distance:
            best, best_distance = vertices, max_distance
        if power is None or max_distance <= EXACT_FIT * np.ptp(samples.points, axis=0).max():
            break
        barycentric = closest_barycentric(samples.points, corners[nearest])
        offsets = samples.points - np.einsum("nk,nkj->nj", barycentric, corners[nearest])
        _, normals = face_areas_and_normals(corners)
        has_offset = distances > MIN_DIRECTION_DISTANCE * max_distance
        directions = np.where(has_offset[:, None], offsets / np.where(has_offset, distances, 1.0)[:, None], normals[nearest])
        irls_weights = (distances / max_distance) ** (power - 2.0) + MIN_WEIGHT
        targets = FitTargets(nearest, barycentric, directions, distances, irls_weights)
        displacements = solve_displacements(vertices, triangles, targets, spring_matrix)
        # A full reweighted step is power - 1 times as long as the Newton step.
        vertices = vertices + displacements / max(power - 1.0, 1.0)
    return best


def solve_displacements(
    vertices: np.ndarray,
    triangles: np.ndarray,
    targets: FitTargets,
    spring_matrix: csr_matrix,
    edge_regularization: float = EDGE_REGULARIZATION,
) -> np.ndarray:
    """Solve for vertex displacements (V, 3) that move the points of `targets` by their residuals.

    Damped weighted least squares. `edge_regularization` scales springs along the edges that keep the mesh from folding, see
    `build_spring_matrix`. No displacement is longer than the largest residual.
    """
    count = 3 * len(vertices)
    columns = (3 * triangles[targets.triangles][:, :, None] + np.arange(3)).reshape(-1)
    values = (targets.barycentric[:, :, None] * targets.directions[:, None, :]).reshape(-1)
    jacobian = csr_matrix((values, columns, np.arange(0, len(columns) + 1, 9)), shape=(len(targets.residuals), count))
    normal_matrix = jacobian.T @ jacobian.multiply(targets.weights[:, None])
    scale = max(float(normal_matrix.diagonal().mean()), TINY)
    springs = edge_regularization * scale * spring_matrix
    rhs = jacobian.T @ (targets.weights * targets.residuals) - springs @ vertices.ravel()
    displacements = spsolve((normal_matrix + springs + DAMPING * scale * identity(count)).tocsc(), rhs).reshape(-1, 3)
    lengths = np.linalg.norm(displacements, axis=1)
    return displacements * np.minimum(1.0, np.abs(targets.residuals).max() / np.where(lengths > 0.0, lengths, 1.0))[:, None]


def build_spring_matrix(triangles: np.ndarray, count: int) -> csr_matrix:
    """Build the (3 count, 3 count) matrix K for which x' K x is the sum over all vertices of the mean squared length of their edges."""
    start, stop = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    inverse_degree = 1.0 / np.maximum(np.bincount(triangles.ravel(), minlength=count), 1.0)
    stiffness = 0.5 * (inverse_degree[start] + inverse_degree[stop])
    adjacency = csr_matrix((stiffness, (start, stop)), shape=(count, count))
    adjacency = adjacency + adjacency.T
    laplacian = diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency
    return kron(laplacian, identity(3)).tocsr()
