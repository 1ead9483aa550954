"""Least squares for positions and texture coordinates of a level, linearized, solved by preconditioned conjugate gradients.

A sample u of triangle t with barycentric coordinates b has the residual P(u) - S(u) = sum of b_k p_k - S(u). A move of the texture
coordinates w_k changes it by -b_k J_t w_k, where J_t is the derivative of P by texture coordinates. All that the samples contribute are
the moments of each triangle, M_t = sum of b b^T and R_t = sum of b S^T, so that a step costs no more than the level has triangles.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.geometry_2d import signed_areas
from ...geometry.mesh import face_areas_and_normals
from .level_state import LevelState, sum_by

MAX_ITERATIONS = 30
TOLERANCE = 1e-3  # of the preconditioned gradient
DAMPING = 0.03  # of the weight that a vertex has if samples are dense: keeps vertices with few samples in place


@dataclass(frozen=True)
class Moments:
    """Moments of the samples of T triangles: products (T, 3, 3) of barycentric coordinates, and `gradients` (T, 3, 3), the derivatives of
    half the unweighted cost by the positions of the corners."""

    products: np.ndarray
    gradients: np.ndarray


def compute_moments(state: LevelState) -> Moments:
    """Return the moments of the triangles of the level."""
    count, triangles, barycentric = len(state.islands), state.found.triangles, state.found.barycentric
    residuals = state.residuals
    weighted = state.samples.weights[:, None] * barycentric
    products, gradients = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    for row in range(3):
        for column in range(3):
            gradients[:, row, column] = np.bincount(triangles, weighted[:, row] * residuals[:, column], count)
            if column >= row:
                products[:, row, column] = np.bincount(triangles, weighted[:, row] * barycentric[:, column], count)
                products[:, column, row] = products[:, row, column]
    return Moments(products, gradients)


@dataclass(frozen=True)
class Linearization:
    """The cost around a level, as a quadratic function of V displacements in space and V displacements in UV space.

    state: the level. moments: of its triangles. directions: (W, 2, 2), which map the two degrees of freedom of a vertex to the
    displacement of its wedges in UV space; zero where a wedge is fixed. None if only positions move: then all derivatives and steps have 3
    columns instead of 5. damping: added to the diagonal, as a fraction of it.
    """

    state: LevelState
    moments: Moments
    directions: np.ndarray | None
    damping: float

    @cached_property
    def _metric(self) -> np.ndarray:
        """(T, 3, 3) weights of residuals: the normal counts more."""
        _, normals = face_areas_and_normals(self.state.corners)
        return np.eye(3) + (self.state.normal_weight - 1.0) * normals[:, :, None] * normals[:, None, :]

    @cached_property
    def _derivatives(self) -> np.ndarray:
        """(T, 3 corners, 3, 2): the derivative of positions on the triangle by the degrees of freedom of each corner's vertex."""
        mesh = self.state.mesh
        uvs, corners = mesh.corner_uvs, self.state.corners
        edges = np.stack([uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]], axis=2)
        determinants = 2.0 * signed_areas(uvs)
        adjugate = np.stack(
            [np.stack([edges[:, 1, 1], -edges[:, 0, 1]], axis=1), np.stack([-edges[:, 1, 0], edges[:, 0, 0]], axis=1)], axis=1
        )
        inverse = adjugate * np.where(determinants == 0.0, 0.0, 1.0 / np.where(determinants == 0.0, 1.0, determinants))[:, None, None]
        sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
        jacobians = sides @ inverse
        return np.einsum("tab,tkbc->tkac", jacobians, self.directions[mesh.wedge_triangles])

    @cached_property
    def _sums(self):
        return sum_by(self.state.mesh.triangles, len(self.state.mesh.vertices))

    def _spread(self, corner_forces: np.ndarray) -> np.ndarray:
        """Return the derivatives (V, 5) by all degrees of freedom from those (T, 3, 3) by the residuals at corners."""
        if self.directions is None:
            return self._sums @ corner_forces.reshape(-1, 3)
        by_uv = -np.einsum("tkac,tka->tkc", self._derivatives, corner_forces)
        return self._sums @ np.concatenate([corner_forces, by_uv], axis=2).reshape(-1, 5)

    def gradient(self) -> np.ndarray:
        """Return the gradient (V, 5) of half the cost at the level."""
        return self._spread(np.einsum("tka,tab->tkb", self.moments.gradients, self._metric))

    def apply(self, step: np.ndarray) -> np.ndarray:
        """Return the product (V, 5) of the Gauss-Newton matrix, without damping, with a `step` (V, 5)."""
        at_corners = step[self.state.mesh.triangles]
        changes = at_corners[:, :, :3]
        if self.directions is not None:
            changes = changes - np.einsum("tkac,tkc->tka", self._derivatives, at_corners[:, :, 3:])
        return self._spread(self.moments.products @ changes @ self._metric)

    def diagonal_blocks(self) -> np.ndarray:
        """Return the diagonal blocks (V, 5, 5) of the Gauss-Newton matrix."""
        weights = np.einsum("tkk->tk", self.moments.products)
        if self.directions is None:
            return (self._sums @ (weights[:, :, None, None] * self._metric[:, None]).reshape(-1, 9)).reshape(-1, 3, 3)
        full = np.concatenate([np.broadcast_to(np.eye(3), (*self.state.mesh.triangles.shape, 3, 3)), -self._derivatives], axis=3)
        weighted = weights[:, :, None, None] * (self._metric[:, None] @ full)
        return (self._sums @ (full.swapaxes(2, 3) @ weighted).reshape(-1, 25)).reshape(-1, 5, 5)

    def solve(self, uv_scale: float) -> np.ndarray:
        """Return the step (V, 5) to the minimum, damped. uv_scale: length of a unit of UV space on the surface."""
        blocks = self.diagonal_blocks()
        areas, _ = face_areas_and_normals(self.state.corners)
        weight = self._sums @ np.repeat(areas / 6.0, 3)  # what `blocks` are if samples are dense
        scale = np.concatenate([np.ones(3), np.full(2, uv_scale**2)])
        damping = (weight[:, None] * scale * np.array([DAMPING] * 3 + [self.damping] * 2))[:, : blocks.shape[1]]
        inverses = np.linalg.inv(blocks + damping[:, :, None] * np.eye(blocks.shape[1]))
        residual = -self.gradient()
        step = np.zeros_like(residual)
        preconditioned = np.einsum("vij,vj->vi", inverses, residual)
        direction, product = preconditioned, float((residual * preconditioned).sum())
        limit = TOLERANCE**2 * product
        for _ in range(MAX_ITERATIONS):
            if product <= limit or product <= 0.0:
                break
            applied = self.apply(direction) + damping * direction
            length = product / float((direction * applied).sum())
            step = step + length * direction
            residual = residual - length * applied
            preconditioned = np.einsum("vij,vj->vi", inverses, residual)
            previous, product = product, float((residual * preconditioned).sum())
            direction = preconditioned + (product / previous) * direction
        return step
