"""One-rings of vertices in a UV map, for moving single vertices while their neighbors stay fixed."""

import numpy as np

from ...arrays import TINY
from ...geometry.transforms import cross
from ..energies.rest_shapes import compute_rest_shapes

MAX_HALVINGS = 30
ARMIJO = 1e-4  # A step must reach this fraction of the decrease that the gradient predicts.


class OneRings:
    """The one-rings of N vertices in a UV map, no two adjacent: P counter-clockwise edges, ring by ring.

    ring (P,): index of the vertex. edges (P, 2): vertex indices. first, second (P, 2): uv of their ends. corners (P, 3, 3): triangles on
    the surface, starting at the center vertex.
    """

    def __init__(
        self, uv: np.ndarray, centers: np.ndarray, links: np.ndarray, vertices: np.ndarray, weights: np.ndarray, symmetry: float = 0.0
    ) -> None:
        """Collect the one-rings.

        Args:
            uv: (V, 2).
            centers: (N,) the vertices.
            links: (N, L, 2) see `vertex_links`.
            vertices: (V, 3) float64, on the surface.
            weights: (V,) as in StretchEnergy, but per vertex.
        """
        self.ring, slot = np.nonzero(links[:, :, 0] >= 0)
        self.edges = links[self.ring, slot]
        self._starts = np.searchsorted(self.ring, np.arange(len(centers)))
        self.first, self.second = uv[self.edges[:, 0]], uv[self.edges[:, 1]]
        triangles = np.column_stack([centers[self.ring], self.edges])
        self.corners = vertices[triangles]
        shapes = compute_rest_shapes(self.corners)
        self._areas = shapes.areas
        self._weights = weights[triangles].mean(axis=1)
        self._symmetry = symmetry
        gradients = shapes.gradients.transpose(2, 1, 0)
        self._center_gradients = gradients[:, 0]
        # Part of the Jacobians that does not depend on the center.
        self._fixed = np.einsum("ei,ej->eij", self.first, gradients[:, 1]) + np.einsum("ei,ej->eij", self.second, gradients[:, 2])

    def relax(self, positions: np.ndarray, steps: int) -> np.ndarray:
        """Return uv (N, 2) of the centers with a lower energy, by Newton `steps` of each vertex from `positions` (N, 2)."""
        value = self._energy(positions)
        for _ in range(steps):
            gradient, hessian = self._gradient_and_hessian(positions)
            direction = -_solve_definite(hessian, gradient)
            expected_decrease = -np.einsum("ni,ni->n", gradient, direction)
            step = np.ones(len(positions))
            for _ in range(MAX_HALVINGS):
                new_positions = positions + step[:, None] * direction
                new_value = self._energy(new_positions)
                is_rejected = ~(new_value <= value - ARMIJO * step * expected_decrease)
                if not is_rejected.any():
                    break
                step[is_rejected] *= 0.5
            is_better = new_value < value
            positions, value = np.where(is_better[:, None], new_positions, positions), np.where(is_better, new_value, value)
        return positions

    def sum_over_rings(self, values: np.ndarray) -> np.ndarray:
        """Return the sums (N, ...) of `values` (P, ...) per ring."""
        return np.add.reduceat(values, self._starts)

    def twice_areas(self, positions: np.ndarray) -> np.ndarray:
        """Return twice the areas (P,) of the triangles from `positions` (N, 2) to the edges."""
        return cross(self.first - positions[self.ring], self.second - positions[self.ring])

    def inward_normals(self) -> np.ndarray:
        """Return the unit normals (P, 2) of the edges, to the left."""
        edges = self.second - self.first
        normals = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
        return normals / np.maximum(np.hypot(*edges.T), TINY)[:, None]

    def clearance(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance (N,) of `positions` (N, 2) to the closest line through an edge, negative outside, and the edge (N,)."""
        distances = np.einsum("ei,ei->e", positions[self.ring] - self.first, self.inward_normals())
        order = np.lexsort((distances, self.ring))
        closest = order[self._starts]
        return distances[closest], closest

    def _jacobians(self, positions: np.ndarray) -> np.ndarray:
        return np.einsum("ei,ej->eij", positions[self.ring], self._center_gradients) + self._fixed

    def _energy(self, positions: np.ndarray) -> np.ndarray:
        """Return the energy (N,) of the triangles around each vertex; infinite where one is flipped."""
        jacobians = self._jacobians(positions)
        determinants = cross(jacobians[:, 0], jacobians[:, 1])
        squares = np.einsum("eij,eij->e", jacobians, jacobians)
        upright = determinants > 0.0
        stretch = 0.5 * self._weights * squares / np.where(upright, determinants, 1.0) ** 2
        expansion = (1.0 - self._symmetry) * determinants + 0.5 * self._symmetry * squares
        return self.sum_over_rings(np.where(upright, self._areas * (stretch + expansion), np.inf))

    def _gradient_and_hessian(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradient (N, 2) and Hessian (N, 2, 2) of the energy by the positions."""
        jacobians = self._jacobians(positions)
        (a, b), (c, d) = jacobians[:, 0].T, jacobians[:, 1].T
        determinants = (a * d - b * c)[:, None]
        squares = np.einsum("eij,eij->e", jacobians, jacobians)[:, None]
        x, y = self._center_gradients.T
        by_determinant = np.stack([d * x - c * y, a * y - b * x], axis=1)
        by_squares = np.einsum("eij,ej->ei", jacobians, self._center_gradients)
        scale = (self._areas * self._weights)[:, None]
        gradient = scale * (by_squares / determinants**2 - squares * by_determinant / determinants**3)
        gradient = gradient + self._areas[:, None] * ((1.0 - self._symmetry) * by_determinant + self._symmetry * by_squares)
        mixed = np.einsum("ei,ej->eij", by_squares, by_determinant)
        squared_length = np.einsum("ei,ei->e", self._center_gradients, self._center_gradients)[:, None, None]
        scale, determinants, squares = scale[:, :, None], determinants[:, :, None], squares[:, :, None]
        hessian = squared_length * np.eye(2) / determinants**2 - 2.0 * (mixed + mixed.transpose(0, 2, 1)) / determinants**3
        outer = np.einsum("ei,ej->eij", by_determinant, by_determinant)
        hessian = scale * (hessian + 3.0 * squares * outer / determinants**4)
        hessian = hessian + self._symmetry * (self._areas[:, None, None] * squared_length) * np.eye(2)
        return self.sum_over_rings(gradient), self.sum_over_rings(hessian)


def _solve_definite(hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return x (N, 2) with |hessian| x = gradient, where |hessian| (N, 2, 2) has the absolute eigenvalues."""
    values, vectors = np.linalg.eigh(hessian)
    values = np.maximum(np.abs(values), 1e-9 * np.abs(values).max(axis=1, keepdims=True) + TINY)
    return np.einsum("nij,nj->ni", vectors, np.einsum("nji,nj->ni", vectors, gradient) / values)
