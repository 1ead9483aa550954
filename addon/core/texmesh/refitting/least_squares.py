"""Least squares for positions and texture coordinates of a level, linearized, solved by preconditioned conjugate gradients.

A sample u of triangle t with barycentric coordinates b has the residual P(u) - S(u) = sum of b_k p_k - S(u). A move of the texture
coordinates w_k changes it by -b_k J_t w_k, where J_t is the derivative of P by texture coordinates. All that the samples contribute are
the moments of each triangle, M_t = sum of b b^T and R_t = sum of b S^T, so that a step costs no more than the level has triangles.
Factors L D L^T of many small symmetric matrices at once precondition the conjugate gradients.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ...jobs.chunks import slices
from .level_state import LevelState, sum_by

MAX_ITERATIONS = 30
TOLERANCE = 3e-2  # Relative size of the preconditioned gradient; with 1e-3 levels deviate as much.
CHUNK_TRIANGLES = 1 << 13
DAMPING = 0.03  # Relative to the weight of a vertex with dense samples; keeps vertices with few samples in place.
MIN_PIVOT = 1e-10  # A pivot below this fraction of a diagonal element means that rows depend on others.


@dataclass(frozen=True)
class Moments:
    """Moments of the samples of T triangles: products (T, 3, 3) of barycentric coordinates, and `gradients` (T, 3, 3), the derivatives of
    half the unweighted cost by the positions of the corners."""

    products: np.ndarray
    gradients: np.ndarray


def compute_moments(state: LevelState) -> Moments:
    """Return the moments of the triangles of the level."""
    count, triangles, barycentric = len(state.islands), state.found.triangles, state.found.barycentric
    products, gradients = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    columns = np.ascontiguousarray(barycentric.T)
    for row in range(3):
        weighted = state.samples.weights * columns[row]
        for column in range(3):
            gradients[:, row, column] = np.bincount(triangles, weighted * state.residuals[:, column], count)
            if column >= row:
                products[:, row, column] = np.bincount(triangles, weighted * columns[column], count)
                products[:, column, row] = products[:, row, column]
    return Moments(products, gradients)


@dataclass(frozen=True)
class Linearization:
    """The cost around a level, as a quadratic function of V displacements in space and V displacements in UV space.

    state: the level. moments: of its triangles. directions: (W, 2, 2), which map the two degrees of freedom of a vertex to the
    displacement of its wedges in UV space; zero where a wedge is fixed. None if only positions move: then all derivatives and steps have 3
    columns instead of 5. damping: added to the diagonal, as a fraction of it.

    Inside, values of wedges and triangles are rows of arrays whose last axis is that of the elements, and triangles are worked on in
    chunks, so that intermediate arrays stay in the cache.
    """

    state: LevelState
    moments: Moments
    directions: np.ndarray | None
    damping: float

    @property
    def _size(self) -> int:
        """Degrees of freedom of a vertex."""
        return 3 if self.directions is None else 5

    @cached_property
    def _normals(self) -> np.ndarray:
        """(3, T) normals; residuals along them count more."""
        return np.ascontiguousarray(self.state.areas_and_normals[1].T)

    @cached_property
    def _products(self) -> np.ndarray:
        """(3, 3, T), the products of the moments."""
        return np.ascontiguousarray(self.moments.products.transpose(1, 2, 0))

    @cached_property
    def _jacobians(self) -> np.ndarray:
        """(2, 3, T): the derivatives of positions on the triangle by both texture coordinates."""
        uvs, corners = self.state.mesh.corner_uvs, self.state.corners
        (a, b), (c, d) = (uvs[:, 1] - uvs[:, 0]).T, (uvs[:, 2] - uvs[:, 0]).T
        determinants = a * d - b * c
        scale = np.divide(1.0, determinants, out=np.zeros_like(determinants), where=determinants != 0.0)
        first, second = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
        return np.stack([(d * scale) * first - (b * scale) * second, (a * scale) * second - (c * scale) * first])

    @cached_property
    def _turns(self) -> np.ndarray:
        """(2, 2, W), the directions."""
        return np.ascontiguousarray(self.directions.transpose(1, 2, 0))

    @cached_property
    def _wedge_corners(self) -> np.ndarray:
        """(3, T), the wedges of the corners."""
        return np.ascontiguousarray(self.state.mesh.wedge_triangles.T)

    @cached_property
    def _corner_sums(self) -> csr_array:
        """(W, 3 T), which sums values of corners by their wedges."""
        return sum_by(self._wedge_corners, len(self.state.mesh.uvs))

    @cached_property
    def _wedge_sums(self) -> csr_array:
        """(V, W), which sums values of wedges by their vertices."""
        return sum_by(self.state.mesh.wedge_vertices, len(self.state.mesh.vertices))

    def _to_wedges(self, step: np.ndarray) -> np.ndarray:
        """Return the displacements (5, W) of wedges in space and UV space by a step (5, V)."""
        at_wedges = step.take(self.state.mesh.wedge_vertices, axis=1)
        if self.directions is not None:
            first, second = at_wedges[3:].copy()
            at_wedges[3:] = self._turns[:, 0] * first + self._turns[:, 1] * second
        return at_wedges

    def _to_vertices(self, at_wedges: np.ndarray) -> np.ndarray:
        """Return the derivatives (5, V) by the degrees of freedom from those (5, W) by displacements of wedges."""
        if self.directions is not None:
            first, second = at_wedges[3:].copy()
            at_wedges[3:] = self._turns[0] * first + self._turns[1] * second
        return np.stack([self._wedge_sums @ row for row in at_wedges])

    def _weigh(self, forces: np.ndarray, chunk: slice) -> np.ndarray:
        """Return the derivatives (3, 5, K) by displacements of corners from those (3, 3, K) by unweighted residuals at corners."""
        normals = self._normals[:, chunk]
        along = (self.state.normal_weight - 1.0) * (forces * normals).sum(axis=1)
        forces = forces + along[:, None] * normals
        if self.directions is None:
            return forces
        jacobians = self._jacobians[:, :, chunk]
        return np.concatenate([forces, *(-(forces * jacobian).sum(axis=1, keepdims=True) for jacobian in jacobians)], axis=1)

    def _sum_corners(self, at_corners: np.ndarray) -> np.ndarray:
        """Return the sums (5, V) of values (3, T, 5) at corners."""
        return self._to_vertices(np.ascontiguousarray((self._corner_sums @ at_corners.reshape(-1, self._size)).T))

    def gradient(self) -> np.ndarray:
        """Return the gradient (V, 5) of half the cost at the level."""
        forces = self.moments.gradients.transpose(1, 2, 0)
        return self._sum_corners(self._weigh(forces, slice(None)).transpose(0, 2, 1)).T

    def apply(self, step: np.ndarray) -> np.ndarray:
        """Return the product (V, 5) of the Gauss-Newton matrix, without damping, with a `step` (V, 5)."""
        return self._apply(np.ascontiguousarray(step.T)).T

    def _apply(self, step: np.ndarray) -> np.ndarray:
        """The same as `apply`, for and with arrays (5, V)."""
        at_wedges, count = self._to_wedges(step), len(self.state.mesh.triangles)
        result = np.empty((3, count, self._size))
        for chunk in slices(count, CHUNK_TRIANGLES):
            moves = [at_wedges.take(corner[chunk], axis=1) for corner in self._wedge_corners]
            products = self._products[:, :, chunk]
            sums = np.empty((3, *moves[0].shape))
            for corner in range(3):
                np.multiply(products[corner, 0], moves[0], out=sums[corner])
                sums[corner] += products[corner, 1] * moves[1]
                sums[corner] += products[corner, 2] * moves[2]
            forces = sums[:, :3]
            if self.directions is not None:
                for axis, jacobian in enumerate(self._jacobians[:, :, chunk]):
                    forces -= jacobian * sums[:, 3 + axis, None]
            result[:, chunk] = self._weigh(forces, chunk).transpose(0, 2, 1)
        return self._sum_corners(result)

    def diagonal_blocks(self) -> np.ndarray:
        """Return the diagonal blocks (5, 5, V) of the Gauss-Newton matrix, of which the lower triangles count."""
        normals = self._normals
        size, shape = self._size, (len(self.state.mesh.uvs), len(normals[0]))
        metric = [normals * ((self.state.normal_weight - 1.0) * normals[axis]) for axis in range(3)]
        columns = [metric[axis] + np.eye(3)[axis][:, None] for axis in range(3)]  # The columns of the weights of residuals.
        if self.directions is not None:
            columns += [-sum(jacobian[axis] * columns[axis] for axis in range(3)) for jacobian in self._jacobians]
        rows, places = np.tril_indices(size)
        values = []
        for row, column in zip(rows, places, strict=True):
            if row < 3:
                values.append(columns[column][row])
            else:
                values.append(-(self._jacobians[row - 3] * columns[column]).sum(axis=0))
        weights = self._products[[0, 1, 2], [0, 1, 2]].ravel()
        sums = self._corner_sums
        triangle_sums = csr_array((weights[sums.indices], sums.indices % shape[1], sums.indptr), shape=shape)
        at_wedges = np.zeros((size, size, shape[0]))
        at_wedges[rows, places] = (triangle_sums @ np.stack(values, axis=1)).T
        if self.directions is not None:
            across, along = at_wedges[3:, :3], at_wedges[3:, 3:]
            along[0, 1] = along[1, 0]
            at_wedges[3:, :3] = np.einsum("ijw,icw->jcw", self._turns, across)
            at_wedges[3:, 3:] = np.einsum("ijw,ilw->jlw", self._turns, np.einsum("ikw,klw->ilw", along, self._turns))
        return (self._wedge_sums @ at_wedges.reshape(size * size, -1).T).T.reshape(size, size, -1)

    def solve(self, uv_scale: float) -> np.ndarray:
        """Return the step (V, 5) to the minimum, damped. uv_scale: length of a unit of UV space on the surface."""
        blocks = self.diagonal_blocks()
        areas, _ = self.state.areas_and_normals
        vertices = self.state.mesh.triangles.ravel()
        weight = np.bincount(vertices, np.repeat(areas / 6.0, 3), blocks.shape[2])  # what `blocks` are if samples are dense
        scale = np.array([DAMPING] * 3 + [self.damping * uv_scale**2] * 2)[: len(blocks)]
        damping = scale[:, None] * weight
        blocks[np.arange(len(blocks)), np.arange(len(blocks))] += damping
        factors = factorize_blocks(blocks)
        residual = -self.gradient().T
        step = np.zeros_like(residual)
        direction = preconditioned = factors.solve(residual)
        product = float(np.vdot(residual, preconditioned))
        limit = TOLERANCE**2 * product
        for _ in range(MAX_ITERATIONS):
            if product <= limit or product <= 0.0:
                break
            applied = self._apply(direction) + damping * direction
            length = product / float(np.vdot(direction, applied))
            step += length * direction
            residual -= length * applied
            preconditioned = factors.solve(residual)
            previous, product = product, float(np.vdot(residual, preconditioned))
            direction = preconditioned + (product / previous) * direction
        return step.T


@dataclass(frozen=True)
class BlockFactors:
    """L D L^T of V matrices n x n. lower: (n, n, V), of which the part below the diagonal is L. inverse_pivots: (n, V), of D; 0 where a
    matrix is singular."""

    lower: np.ndarray
    inverse_pivots: np.ndarray

    def solve(self, values: np.ndarray) -> np.ndarray:
        """Return the solutions (n, V) for right-hand sides `values` (n, V)."""
        result = values.copy()
        count = len(values)
        for row in range(1, count):
            for column in range(row):
                result[row] -= self.lower[row, column] * result[column]
        result *= self.inverse_pivots
        for row in range(count - 2, -1, -1):
            for column in range(row + 1, count):
                result[row] -= self.lower[column, row] * result[column]
        return result


def factorize_blocks(blocks: np.ndarray) -> BlockFactors:
    """Return the factors of positive semidefinite `blocks` (n, n, V), of which the lower triangles are read."""
    count = len(blocks)
    lower, inverse_pivots = np.zeros_like(blocks), np.zeros_like(blocks[0])
    for column in range(count):
        scaled = [lower[column, before] * pivots for before, pivots in enumerate(_pivots(inverse_pivots[:column]))]
        pivot = blocks[column, column] - sum(lower[column, before] * part for before, part in enumerate(scaled))
        is_regular = pivot > MIN_PIVOT * blocks[column, column]
        np.divide(1.0, pivot, out=inverse_pivots[column], where=is_regular)
        for row in range(column + 1, count):
            rest = blocks[row, column] - sum(lower[row, before] * part for before, part in enumerate(scaled))
            lower[row, column] = rest * inverse_pivots[column]
    return BlockFactors(lower, inverse_pivots)


def _pivots(inverse_pivots: np.ndarray) -> np.ndarray:
    return np.divide(1.0, inverse_pivots, out=np.zeros_like(inverse_pivots), where=inverse_pivots > 0.0)
