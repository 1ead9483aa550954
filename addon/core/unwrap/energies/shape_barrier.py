"""Barrier that keeps UV triangles from becoming slivers, along which a texture would seem to crack (the paper's s(T), section 3.2).

The paper's constraint is min(height / base) >= epsilon over the three sides of every triangle. The minimum is that of the longest side:
twice the area over its squared length. Each side has an energy that sets in at ACTIVATION_RATIO times the limit, grows smoothly and is
infinite at the limit. A triangle below the limit, as in the initial map, gets a quadratic penalty that pulls it up instead (soft barrier).
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import TINY
from ...geometry.transforms import cross

ACTIVATION_RATIO = 2.0  # The energy sets in below this multiple of the limit.
STIFFNESS = 0.5  # Relative to the area of the triangle.


def min_height_to_base(corner_uvs: np.ndarray) -> np.ndarray:
    """Return the minimum height-to-base ratio (T,) of triangles (T, 3, 2): negative if flipped, 0.87 if equilateral."""
    return _height_to_base(corner_uvs).min(axis=0)


def _height_to_base(corner_uvs: np.ndarray) -> np.ndarray:
    """Return the height-to-base ratio (3, T) of each side of triangles (T, 3, 2); side c is from corner c to the next."""
    a, b, c = corner_uvs.transpose(1, 0, 2)
    squares = np.stack([side[:, 0] ** 2 + side[:, 1] ** 2 for side in (b - a, c - b, a - c)])
    return cross(b - a, c - a) / np.maximum(squares, TINY)


@dataclass(frozen=True)
class ShapeBarrier:
    """Barrier energy of uv (V, 2).

    Attributes:
        triangles: (T, 3).
        indices: (T,) indices of the triangles in the results.
        weights: (T,).
        min_ratios: (T,) lower limits of the minimum height-to-base ratio.
        is_soft: Triangles may be below their limit and are pulled up.
    """

    triangles: np.ndarray
    indices: np.ndarray
    weights: np.ndarray
    min_ratios: np.ndarray
    is_soft: bool

    def value(self, uv: np.ndarray) -> float:
        """Return the energy; infinite where a triangle is not above its limit, unless the barrier is soft."""
        clearance = self._clearance(uv)
        if not self.is_soft and clearance.min() <= 0.0:
            return np.inf
        return float((STIFFNESS * self.weights * self._energy(clearance)[0]).sum())

    def gradients(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices (K,) of active triangles, one per side, and gradients (K, 6) by x and y of their corners in turn."""
        side, triangle, corners, derivative, _ = self._active_sides(uv)
        gradients = derivative[:, None] * _ratio_gradients(corners)
        return self.indices[triangle], np.take_along_axis(gradients, _rotated_dofs(side), axis=1)

    def hessians(self, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the same indices (K,) and the Hessians (K, 6, 6), projected to be positive semidefinite."""
        side, triangle, corners, derivative, second_derivative = self._active_sides(uv)
        gradients = _ratio_gradients(corners)
        hessians = second_derivative[:, None, None] * gradients[:, :, None] * gradients[:, None, :]
        hessians = project_to_psd(hessians + derivative[:, None, None] * _ratio_hessians(corners))
        dofs, rows = _rotated_dofs(side), np.arange(len(side))[:, None, None]
        return self.indices[triangle], hessians[rows, dofs[:, :, None], dofs[:, None, :]]

    def _active_sides(self, uv: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the sides with a nonzero energy.

        Returns:
            sides (K,), triangles (K,), their corners (K, 3, 2) starting at the side, and the first and second derivatives (K,) of the
            energy by the side's ratio.
        """
        clearance = self._clearance(uv)
        side, triangle = np.nonzero(clearance < 1.0)
        corners = uv[np.take_along_axis(self.triangles[triangle], (side[:, None] + np.arange(3)) % 3, axis=1)]
        _, derivative, second_derivative = self._energy(clearance[side, triangle])
        scale = 1.0 / (self.min_ratios[triangle] * (ACTIVATION_RATIO - 1.0))
        weights = STIFFNESS * self.weights[triangle]
        return side, triangle, corners, weights * derivative * scale, weights * second_derivative * scale**2

    def _clearance(self, uv: np.ndarray) -> np.ndarray:
        """Return how far the ratio of each side (3, T) is above its limit: 0 at the limit, 1 where the energy sets in."""
        return (_height_to_base(uv[self.triangles]) / self.min_ratios - 1.0) / (ACTIVATION_RATIO - 1.0)

    def _energy(self, clearance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the energy per side from its clearance, and the first and second derivatives by the clearance."""
        deficit = np.minimum(clearance, 1.0) - 1.0
        if self.is_soft:
            return deficit**2, 2.0 * deficit, np.full_like(deficit, 2.0)
        logarithm, active = np.log(np.minimum(clearance, 1.0)), np.minimum(clearance, 1.0)
        value = -(deficit**2) * logarithm
        derivative = -2.0 * deficit * logarithm - deficit**2 / active
        return value, derivative, -2.0 * logarithm - 4.0 * deficit / active + deficit**2 / active**2


def _rotated_dofs(side: np.ndarray) -> np.ndarray:
    """Return the index (K, 6) of x and y of each corner of a triangle in arrays whose first corner is that of `side` (K,)."""
    return (2 * ((np.arange(3)[None] - side[:, None]) % 3)[:, :, None] + np.arange(2)).reshape(-1, 6)


def _ratio_gradients(corners: np.ndarray) -> np.ndarray:
    """Return the gradients (K, 6) of height over base, with the base from the first to the second of `corners` (K, 3, 2)."""
    double_area, base_squared, area_gradient, base_gradient = _ratio_terms(corners)
    return area_gradient / base_squared[:, None] - (double_area / base_squared**2)[:, None] * base_gradient


def _ratio_hessians(corners: np.ndarray) -> np.ndarray:
    """Return the Hessians (K, 6, 6) of height over base, as in `_ratio_gradients`."""
    double_area, base_squared, area_gradient, base_gradient = _ratio_terms(corners)
    mixed = area_gradient[:, :, None] * base_gradient[:, None, :]
    hessians = _AREA_HESSIAN / base_squared[:, None, None] - (mixed + mixed.transpose(0, 2, 1)) / base_squared[:, None, None] ** 2
    hessians += (2.0 * double_area / base_squared**3)[:, None, None] * base_gradient[:, :, None] * base_gradient[:, None, :]
    return hessians - (double_area / base_squared**2)[:, None, None] * _SQUARED_LENGTH_HESSIAN


def _ratio_terms(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return twice the area (K,), the squared length of the base (K,), and the gradients (K, 6) of both."""
    a, b, c = corners.transpose(1, 0, 2)
    ab, bc, ac = b - a, c - b, c - a
    area_gradient = np.stack([-bc[:, 1], bc[:, 0], ac[:, 1], -ac[:, 0], -ab[:, 1], ab[:, 0]], axis=1)
    base_gradient = np.concatenate([-2.0 * ab, 2.0 * ab, np.zeros_like(ab)], axis=1)
    return cross(ab, ac), (ab**2).sum(axis=1), area_gradient, base_gradient


def project_to_psd(matrices: np.ndarray) -> np.ndarray:
    """Return the nearest positive semidefinite matrices (K, 6, 6): negative eigenvalues become 0."""
    values, vectors = np.linalg.eigh(matrices)
    return np.matmul(vectors * np.maximum(values, 0.0)[:, None, :], vectors.transpose(0, 2, 1))


_AREA_HESSIAN = np.zeros((6, 6))  # Hessian of twice the area of a triangle, by x and y of its corners in turn.
for _first, _second in ((0, 1), (1, 2), (2, 0)):
    _AREA_HESSIAN[2 * _first, 2 * _second + 1] = _AREA_HESSIAN[2 * _second + 1, 2 * _first] = 1.0
    _AREA_HESSIAN[2 * _first + 1, 2 * _second] = _AREA_HESSIAN[2 * _second, 2 * _first + 1] = -1.0
_SQUARED_LENGTH_HESSIAN = 2.0 * np.kron(np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]), np.eye(2))
