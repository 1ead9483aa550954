"""Stretch energy of a UV map in both directions, weighted by importance, with gradient and Hessian.

A triangle with area A, whose Jacobian from the surface to the UV map has singular values s1 and s2, has the stretch energy
w A (1 / s1^2 + 1 / s2^2) / 2 (Sander et al.: Texture mapping progressive meshes, 2001; equation 2 of the paper with importance w). With a
free boundary a larger map would always have less stretch, so the expansion A ((1 - t) s1 s2 + t (s1^2 + s2^2) / 2) is added. The minimum of
the sum is that of stretch times expansion, which does not depend on size (the minimum of a s^-2 + b s^2 over the scale s is 2 sqrt(a b)).

With the symmetry t = 0 this is L2 stretch, which hardly sees triangles that are too large in the map, and with t = 1 the symmetric
Dirichlet energy. For every t the map has the least stretch of all maps with its symmetric Dirichlet energy. Triangles that become needles
in the map, a small part of the surface, get an additional expansion, which is 0 for all others.

Hessians are projected to be positive semidefinite by clamping the four eigenvalues per triangle, which have a closed form for energies of
singular values (Smith, de Goes, Kim: Analytic eigensystems for isotropic distortion energies, 2019).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .rest_shapes import RestShapes

NEEDLE_SQUARES = 10.0  # Triangles with a larger s1^2 + s2^2 count as needles; it is 2 for an isometry.


class Expansion(NamedTuple):
    """How triangles count that are too large in the map: symmetry t, 0 to 1, and stiffness, at least 0, of the penalty on needles."""

    symmetry: float
    needle_stiffness: float


class Jacobians(NamedTuple):
    """T Jacobians from the surface to the UV map: derivatives (T,) of u (x) and v (y) along the two directions of the rest shape."""

    xx: np.ndarray
    xy: np.ndarray
    yx: np.ndarray
    yy: np.ndarray

    @property
    def determinants(self) -> np.ndarray:
        """Area ratios (T,) of UV map to surface; negative where triangles are flipped."""
        return self.xx * self.yy - self.xy * self.yx

    @property
    def frobenius_squared(self) -> np.ndarray:
        """Sums (T,) of the squared singular values."""
        return self.xx**2 + self.xy**2 + self.yx**2 + self.yy**2


def compute_jacobians(shapes: RestShapes, triangles: np.ndarray, uv: np.ndarray) -> Jacobians:
    """Return the Jacobians of uv (V, 2) for `triangles` (T, 3)."""
    x, y = (np.take(np.ascontiguousarray(axis), triangles.T) for axis in uv.T)
    first, second = shapes.gradients
    return Jacobians(*(u[0] * g[0] + u[1] * g[1] + u[2] * g[2] for u in (x, y) for g in (first, second)))


def squared_stretches(shapes: RestShapes, triangles: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return the squared L2 stretch (T,) of every triangle for uv (V, 2); infinite where flipped."""
    jacobians = compute_jacobians(shapes, triangles, uv)
    determinants = jacobians.determinants
    upright = determinants > 0.0
    return np.where(upright, 0.5 * jacobians.frobenius_squared / np.where(upright, determinants, 1.0) ** 2, np.inf)


@dataclass(frozen=True)
class StretchEnergy:
    """Stretch energy of uv (V, 2) for `triangles` (T, 3) with importance `weights` (T,).

    expansion: how triangles count that are too large in the map.
    """

    triangles: np.ndarray
    shapes: RestShapes
    weights: np.ndarray
    expansion: Expansion

    def value(self, uv: np.ndarray) -> float:
        """Return the energy; infinite where a triangle is flipped."""
        return sum(self.terms(uv))

    def terms(self, uv: np.ndarray) -> tuple[float, float]:
        """Return the terms of the energy: stretch, infinite where a triangle is flipped, and expansion."""
        jacobians = compute_jacobians(self.shapes, self.triangles, uv)
        determinants = jacobians.determinants
        if not determinants.min() > 0.0:
            return np.inf, 0.0
        stretch = self.shapes.areas @ (0.5 * self.weights * jacobians.frobenius_squared / determinants**2)
        t, squares = self.expansion.symmetry, jacobians.frobenius_squared
        needles = 0.5 * self.expansion.needle_stiffness * np.sqrt(self.weights) * self._needle_excess(squares) ** 2
        return float(stretch), float(self.shapes.areas @ ((1.0 - t) * determinants + 0.5 * t * squares + needles))

    def distortion_excess(self, uv: np.ndarray) -> float:
        """Return by which fraction symmetric Dirichlet energy exceeds that of a map without distortion, at the best scale."""
        jacobians = compute_jacobians(self.shapes, self.triangles, uv)
        squares, determinants = jacobians.frobenius_squared, jacobians.determinants
        stretch, dirichlet = self.shapes.areas @ (self.weights * squares / determinants**2), self.shapes.areas @ squares
        return float(np.sqrt(stretch * dirichlet) / self.lower_bound()) - 1.0

    def _needle_excess(self, squares: np.ndarray) -> np.ndarray:
        """Return by how much squared Frobenius norms (T,), relative to the requested density, exceed `NEEDLE_SQUARES`."""
        return np.maximum(squares / np.sqrt(self.weights) - NEEDLE_SQUARES, 0.0)

    def lower_bound(self) -> float:
        """Return a lower bound of the energy: every triangle undistorted and at its best scale."""
        return 2.0 * float(self.shapes.areas @ np.sqrt(self.weights))

    def max_step(self, uv: np.ndarray, displacement: np.ndarray) -> float:
        """Return the largest multiple of `displacement` (V, 2) before a triangle has no area left, or infinity."""
        at, by = (compute_jacobians(self.shapes, self.triangles, positions) for positions in (uv, displacement))
        mixed = at.xx * by.yy + by.xx * at.yy - at.xy * by.yx - by.xy * at.yx
        return smallest_positive_root(by.determinants, mixed, at.determinants)

    def gradients(self, uv: np.ndarray) -> np.ndarray:
        """Return the gradients (T, 6) by x and y of the corners of every triangle in turn."""
        jacobians = compute_jacobians(self.shapes, self.triangles, uv)
        xx, xy, yx, yy = jacobians
        determinants = jacobians.determinants
        squares, t = jacobians.frobenius_squared, self.expansion.symmetry
        a = self.shapes.areas * self.weights / determinants**2
        b = (1.0 - t) * self.shapes.areas - a * squares / determinants  # Coefficient of the cofactor matrix.
        a += self.shapes.areas * (t + 2.0 * self.expansion.needle_stiffness * self._needle_excess(squares))  # Of the Jacobian.
        by_jacobian = a * xx + b * yy, a * xy - b * yx, a * yx - b * xy, a * yy + b * xx
        first, second = self.shapes.gradients
        gradients = np.empty((len(determinants), 3, 2))
        for corner in range(3):
            for axis in range(2):
                gradients[:, corner, axis] = by_jacobian[2 * axis] * first[corner] + by_jacobian[2 * axis + 1] * second[corner]
        return gradients.reshape(-1, 6)

    def hessians(self, uv: np.ndarray) -> np.ndarray:
        """Return the Hessians (T, 6, 6) by the same coordinates, projected to be positive semidefinite."""
        eigenvalues, eigenmodes = self._eigensystem(*_decompose(compute_jacobians(self.shapes, self.triangles, uv)))
        factors = np.empty((4, 3, 2, len(eigenvalues[0])))
        first, second = self.shapes.gradients
        for index, (value, mode) in enumerate(zip(eigenvalues, eigenmodes, strict=True)):
            root = np.sqrt(np.maximum(value, 0.0) * self.shapes.areas)
            for corner in range(3):
                for axis in range(2):
                    factors[index, corner, axis] = root * (mode[2 * axis] * first[corner] + mode[2 * axis + 1] * second[corner])
        factors = factors.reshape(4, 6, -1).transpose(2, 0, 1)
        return np.matmul(factors.transpose(0, 2, 1), factors)

    def _eigensystem(self, s1: np.ndarray, s2: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple[list, list]:
        """Return the eigenvalues, four of (T,), of the energy's Hessian by the Jacobian, and the eigenmodes by xx, xy, yx and yy.

        Args:
            s1, s2, left, right: see `_decompose`.
        """
        weights, t = self.weights, self.expansion.symmetry
        product, square_sum = s1 * s2, s1**2 + s2**2
        needle_excess = self._needle_excess(square_sum)
        first_derivative = 2.0 * self.expansion.needle_stiffness * needle_excess
        second_derivative = 4.0 * self.expansion.needle_stiffness * (needle_excess > 0.0) / np.sqrt(weights)
        twist_value = 1.0 + first_derivative - weights * (square_sum - product) / product**3
        flip_value = weights * (square_sum + product) / product**3 - 1.0 + 2.0 * t + first_derivative
        # The two scaling modes: eigenvalues of the 2 by 2 matrix of second derivatives by s1 and s2.
        mean = 1.5 * weights * (s1**-4 + s2**-4) + t + first_derivative + 0.5 * second_derivative * square_sum
        half_difference = 1.5 * weights * (s1**-4 - s2**-4) + 0.5 * second_derivative * (s1**2 - s2**2)
        mixed = 1.0 - t + second_derivative * product
        split, angle = np.hypot(half_difference, mixed), 0.5 * np.arctan2(mixed, half_difference)
        (a, b), (c, d) = (np.cos(left), np.sin(left)), (np.cos(right), np.sin(right))
        scaling_1, scaling_2 = (a * c, -a * d, b * c, -b * d), (-b * d, -b * c, a * d, a * c)
        shear_1, shear_2 = (-b * c, b * d, a * c, -a * d), (a * d, a * c, b * d, b * c)
        cosine, sine, root_half = np.cos(angle), np.sin(angle), np.sqrt(0.5)
        modes = [
            [cosine * first + sine * second for first, second in zip(scaling_1, scaling_2, strict=True)],
            [cosine * second - sine * first for first, second in zip(scaling_1, scaling_2, strict=True)],
            [root_half * (first - second) for first, second in zip(shear_1, shear_2, strict=True)],
            [root_half * (first + second) for first, second in zip(shear_1, shear_2, strict=True)],
        ]
        return [mean + split, mean - split, twist_value, flip_value], modes


def _decompose(jacobians: Jacobians) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the singular values (T,), the larger first, and the angles (T,) of the rotations: R(left) diag(s1, s2) R(right)."""
    xx, xy, yx, yy = jacobians
    conformal, anticonformal = 0.5 * np.hypot(xx + yy, yx - xy), 0.5 * np.hypot(xx - yy, yx + xy)
    angle_sum, angle_difference = np.arctan2(yx - xy, xx + yy), np.arctan2(yx + xy, xx - yy)
    left, right = 0.5 * (angle_difference + angle_sum), 0.5 * (angle_sum - angle_difference)
    return conformal + anticonformal, conformal - anticonformal, left, right


def smallest_positive_root(quadratic: np.ndarray, linear: np.ndarray, constant: np.ndarray) -> float:
    """Return the smallest t > 0 at which any of quadratic t^2 + linear t + constant is 0, or infinity. All constants are above 0."""
    discriminant = linear**2 - 4.0 * quadratic * constant
    is_real = discriminant >= 0.0
    half = -0.5 * (linear[is_real] + np.copysign(np.sqrt(discriminant[is_real]), linear[is_real]))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.concatenate([half / quadratic[is_real], constant[is_real] / half])
    return float(roots[roots > 0.0].min(initial=np.inf))
