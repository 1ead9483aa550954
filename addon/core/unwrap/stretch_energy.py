"""Sander's L2 geometric stretch of a layout, with importance, and what a Newton step needs of it.

Of a triangle with area A whose Jacobian from the surface to the layout has singular values s1, s2, stretch counts
w A (1 / s1^2 + 1 / s2^2) / 2 (Texture mapping progressive meshes, 2001; the paper's equation 2 with importance w). Where the border is
free a larger layout would always be better, so the area of the layout is added: the sum has its least value where stretch times area has
it, which does not depend on size (of a s^-2 + b s^2 the least value over s is 2 sqrt(a b)). Within a fixed border that area is constant.

Bends are made positive by clamping the four eigenvalues of each triangle's energy, which are known in closed form for energies of the
singular values (Smith, de Goes, Kim: Analytic eigensystems for isotropic distortion energies, 2019).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .rest_shapes import RestShapes


class Jacobians(NamedTuple):
    """T Jacobians from the surface to the layout: of the layout's x and y along the two directions of the surface, (T,) each."""

    xx: np.ndarray
    xy: np.ndarray
    yx: np.ndarray
    yy: np.ndarray

    @property
    def determinants(self) -> np.ndarray:
        """How much larger the layout's areas (T,) are; below 0 where triangles are flipped."""
        return self.xx * self.yy - self.xy * self.yx

    @property
    def squares(self) -> np.ndarray:
        """Sums (T,) of the squared singular values."""
        return self.xx**2 + self.xy**2 + self.yx**2 + self.yy**2


def jacobians(shapes: RestShapes, triangles: np.ndarray, layout: np.ndarray) -> Jacobians:
    """Jacobians of a layout (V, 2) of `triangles` (T, 3)."""
    x, y = (np.take(np.ascontiguousarray(axis), triangles.T) for axis in layout.T)
    first, second = shapes.gradients
    return Jacobians(*(u[0] * g[0] + u[1] * g[1] + u[2] * g[2] for u in (x, y) for g in (first, second)))


def stretches(shapes: RestShapes, triangles: np.ndarray, layout: np.ndarray) -> np.ndarray:
    """L2 stretch squared (T,) of every triangle in a layout (V, 2); infinite where flipped."""
    at = jacobians(shapes, triangles, layout)
    areas = at.determinants
    return np.where(areas > 0.0, 0.5 * at.squares / np.where(areas > 0.0, areas, 1.0) ** 2, np.inf)


@dataclass(frozen=True)
class StretchEnergy:
    """The energy of layouts (V, 2) of `triangles` (T, 3).

    weights (T,): importance.
    """

    triangles: np.ndarray
    shapes: RestShapes
    weights: np.ndarray

    def value(self, layout: np.ndarray) -> float:
        """The energy; infinite where a triangle is flipped."""
        return sum(self.parts(layout))

    def parts(self, layout: np.ndarray) -> tuple[float, float]:
        """What the energy is the sum of: stretch, infinite where a triangle is flipped, and the layout's area."""
        at = jacobians(self.shapes, self.triangles, layout)
        areas = at.determinants
        if not areas.min() > 0.0:
            return np.inf, 0.0
        return float(self.shapes.areas @ (0.5 * self.weights * at.squares / areas**2)), float(self.shapes.areas @ areas)

    def least(self) -> float:
        """What the energy of no layout is below: every triangle for itself as large as it should be."""
        return 2.0 * float(self.shapes.areas @ np.sqrt(self.weights))

    def longest_step(self, layout: np.ndarray, move: np.ndarray) -> float:
        """The largest multiple of `move` (V, 2) before a triangle has no area left; infinite where none ever has."""
        at, by = (jacobians(self.shapes, self.triangles, each) for each in (layout, move))
        mixed = at.xx * by.yy + by.xx * at.yy - at.xy * by.yx - by.xy * at.yx
        return first_root(by.determinants, mixed, at.determinants)

    def slope(self, layout: np.ndarray) -> np.ndarray:
        """Slope (T, 6) of the energy by the corners of every triangle, x and y in turn."""
        at = jacobians(self.shapes, self.triangles, layout)
        areas = at.determinants
        along = self.shapes.areas * self.weights / areas**2
        across = self.shapes.areas - along * at.squares / areas
        by = along * at.xx + across * at.yy, along * at.xy - across * at.yx, along * at.yx - across * at.xy, along * at.yy + across * at.xx
        first, second = self.shapes.gradients
        slope = np.empty((len(areas), 3, 2))
        for corner in range(3):
            for axis in range(2):
                slope[:, corner, axis] = by[2 * axis] * first[corner] + by[2 * axis + 1] * second[corner]
        return slope.reshape(-1, 6)

    def bend(self, layout: np.ndarray) -> np.ndarray:
        """Bend (T, 6, 6) of the energy by the same, made positive."""
        at = jacobians(self.shapes, self.triangles, layout)
        values, ways = self._eigen(*_singular(at))
        slopes = np.empty((4, 3, 2, len(values[0])))
        first, second = self.shapes.gradients
        for number, (value, way) in enumerate(zip(values, ways, strict=True)):
            root = np.sqrt(np.maximum(value, 0.0) * self.shapes.areas)
            for corner in range(3):
                for axis in range(2):
                    slopes[number, corner, axis] = root * (way[2 * axis] * first[corner] + way[2 * axis + 1] * second[corner])
        slopes = slopes.reshape(4, 6, -1).transpose(2, 0, 1)
        return np.matmul(slopes.transpose(0, 2, 1), slopes)

    def _eigen(self, first: np.ndarray, second: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple[list, list]:
        """Eigenvalues, four of (T,), of the energy's bend by the Jacobian, and what each is a change of: of xx, xy, yx and yy."""
        weights = self.weights
        product, both = first * second, first**2 + second**2
        twist = 1.0 - weights * (both - product) / product**3
        mirror = weights * (both + product) / product**3 - 1.0
        mean, half = 1.5 * weights * (first**-4 + second**-4), 1.5 * weights * (first**-4 - second**-4)
        apart, turn = np.hypot(half, 1.0), 0.5 * np.arctan2(1.0, half)
        (a, b), (c, d) = (np.cos(left), np.sin(left)), (np.cos(right), np.sin(right))
        grow_first, grow_second = (a * c, -a * d, b * c, -b * d), (-b * d, -b * c, a * d, a * c)
        shear_up, shear_down = (-b * c, b * d, a * c, -a * d), (a * d, a * c, b * d, b * c)
        cosine, sine, root = np.cos(turn), np.sin(turn), np.sqrt(0.5)
        ways = [
            [cosine * one + sine * other for one, other in zip(grow_first, grow_second, strict=True)],
            [cosine * other - sine * one for one, other in zip(grow_first, grow_second, strict=True)],
            [root * (one - other) for one, other in zip(shear_up, shear_down, strict=True)],
            [root * (one + other) for one, other in zip(shear_up, shear_down, strict=True)],
        ]
        return [mean + apart, mean - apart, twist, mirror], ways


def _singular(at: Jacobians) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Singular values, the larger first, and the angles (T,) of the rotations left and right: R(left) diag(values) R(right)."""
    kept, mirrored = 0.5 * np.hypot(at.xx + at.yy, at.yx - at.xy), 0.5 * np.hypot(at.xx - at.yy, at.yx + at.xy)
    total, difference = np.arctan2(at.yx - at.xy, at.xx + at.yy), np.arctan2(at.yx + at.xy, at.xx - at.yy)
    return kept + mirrored, kept - mirrored, 0.5 * (difference + total), 0.5 * (total - difference)


def first_root(square: np.ndarray, linear: np.ndarray, constant: np.ndarray) -> float:
    """The least t > 0 at which any of square t^2 + linear t + constant is 0, where all constants are above 0; infinite without one."""
    inside = linear**2 - 4.0 * square * constant
    real = inside >= 0.0
    half = -0.5 * (linear[real] + np.copysign(np.sqrt(inside[real]), linear[real]))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.concatenate([half / square[real], constant[real] / half])
    return float(roots[roots > 0.0].min(initial=np.inf))
