"""What keeps the triangles of a layout from becoming slivers, along which a texture would seem to crack (the paper's s(T), section 3.2).

The paper's bound is min(height / base) >= epsilon over the three sides of every triangle; the least is that over the longest side,
twice the area over its square. Each side has an energy that begins at START times the bound, grows smoothly and is infinite at it. While
a triangle is below the bound, as the layout that the work starts from may leave it, a parabola pulls it up instead.
"""

from dataclasses import dataclass

import numpy as np

from .plane import cross

START = 2.0  # times the bound: where the energy begins
STRENGTH = 0.5  # of the area of the triangle


def least_ratios(corners: np.ndarray) -> np.ndarray:
    """The least height over base (T,) of triangles `corners` (T, 3, 2), below 0 where they are flipped; 0.87 for equilateral ones."""
    return _ratios(corners).min(axis=0)


def _ratios(corners: np.ndarray) -> np.ndarray:
    """Height over base (3, T) for each side of triangles `corners` (T, 3, 2); the side from the corner of that number to the next."""
    (ax, ay), (bx, by), (cx, cy) = corners.transpose(1, 2, 0)
    doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    squares = np.stack([(bx - ax) ** 2 + (by - ay) ** 2, (cx - bx) ** 2 + (cy - by) ** 2, (ax - cx) ** 2 + (ay - cy) ** 2])
    return doubled / np.maximum(squares, 1e-300)


@dataclass(frozen=True)
class ShapeBarrier:
    """The energy of layouts (V, 2) of `triangles` (T, 3).

    which (T,): the numbers by which `elements` gives them. areas (T,): what each counts. bounds (T,): below which no triangle's least
    height over base may be. soft: whether triangles may be below, and are pulled up.
    """

    triangles: np.ndarray
    which: np.ndarray
    areas: np.ndarray
    bounds: np.ndarray
    soft: bool

    def value(self, layout: np.ndarray) -> float:
        """The energy; infinite where a triangle is not above its bound, unless the barrier is soft."""
        above = self._above(layout)
        if not self.soft and above.min() <= 0.0:
            return np.inf
        return float((STRENGTH * self.areas * self._energy(above)[0]).sum())

    def slopes(self, layout: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What pushes: the numbers (K,) of triangles, and slopes (K, 6) by their corners' x and y in turn."""
        side, triangle, corners, slope, _ = self._pushing(layout)
        return self.which[triangle], np.take_along_axis(slope[:, None] * _ratio_slopes(corners), _unrolled(side), axis=1)

    def bends(self, layout: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same triangles (K,), and bends (K, 6, 6), positive."""
        side, triangle, corners, slope, bend = self._pushing(layout)
        first = _ratio_slopes(corners)
        made = bend[:, None, None] * first[:, :, None] * first[:, None, :]
        made = _positive(made + slope[:, None, None] * _ratio_bends(corners))
        back, rows = _unrolled(side), np.arange(len(side))[:, None, None]
        return self.which[triangle], made[rows, back[:, :, None], back[:, None, :]]

    def _pushing(self, layout: np.ndarray) -> tuple[np.ndarray, ...]:
        """Sides (K,) of triangles (K,) below where the energy begins, their corners (K, 3, 2) from the side's first on, and the first and
        second derivatives (K,) of the energy by the side's ratio."""
        above = self._above(layout)
        side, triangle = np.nonzero(above < 1.0)
        corners = layout[np.take_along_axis(self.triangles[triangle], (side[:, None] + np.arange(3)) % 3, axis=1)]
        _, slope, bend = self._energy(above[side, triangle])
        scale, counts = 1.0 / (self.bounds[triangle] * (START - 1.0)), STRENGTH * self.areas[triangle]
        return side, triangle, corners, counts * slope * scale, counts * bend * scale**2

    def _above(self, layout: np.ndarray) -> np.ndarray:
        """How far each side's ratio is above its bound (3, T): 0 at the bound, 1 where the energy begins."""
        return (_ratios(layout[self.triangles]) / self.bounds - 1.0) / (START - 1.0)

    def _energy(self, above: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The energy by what `_above` gives, and its first and second derivatives by that."""
        short = np.minimum(above, 1.0) - 1.0
        if self.soft:
            return short**2, 2.0 * short, np.full_like(short, 2.0)
        logarithm, there = np.log(np.minimum(above, 1.0)), np.minimum(above, 1.0)
        value = -(short**2) * logarithm
        slope = -2.0 * short * logarithm - short**2 / there
        return value, slope, -2.0 * logarithm - 4.0 * short / there + short**2 / there**2


def _unrolled(side: np.ndarray) -> np.ndarray:
    """Where each x and y (K, 6) of a triangle's corners stands when they are given from the first of a `side` (K,) on."""
    return (2 * ((np.arange(3)[None] - side[:, None]) % 3)[:, :, None] + np.arange(2)).reshape(-1, 6)


def _ratio_slopes(corners: np.ndarray) -> np.ndarray:
    """Slopes (K, 6) of height over base, the base from the first of the `corners` (K, 3, 2) to the second."""
    doubled, square, area_slope, square_slope = _ratio_parts(corners)
    return area_slope / square[:, None] - (doubled / square**2)[:, None] * square_slope


def _ratio_bends(corners: np.ndarray) -> np.ndarray:
    """Bends (K, 6, 6) of the same."""
    doubled, square, area_slope, square_slope = _ratio_parts(corners)
    mixed = area_slope[:, :, None] * square_slope[:, None, :]
    bend = _AREA_BEND / square[:, None, None] - (mixed + mixed.transpose(0, 2, 1)) / square[:, None, None] ** 2
    bend += (2.0 * doubled / square**3)[:, None, None] * square_slope[:, :, None] * square_slope[:, None, :]
    return bend - (doubled / square**2)[:, None, None] * _SQUARE_BEND


def _ratio_parts(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Twice the area (K,), the square of the base (K,), and the slopes (K, 6) of both."""
    a, b, c = corners.transpose(1, 0, 2)
    base, far, near = b - a, c - b, c - a
    area_slope = np.stack([-far[:, 1], far[:, 0], near[:, 1], -near[:, 0], -base[:, 1], base[:, 0]], axis=1)
    square_slope = np.concatenate([-2.0 * base, 2.0 * base, np.zeros_like(base)], axis=1)
    return cross(base, near), (base**2).sum(axis=1), area_slope, square_slope


def _positive(matrices: np.ndarray) -> np.ndarray:
    """The nearest matrices (K, 6, 6) without negative eigenvalues."""
    values, vectors = np.linalg.eigh(matrices)
    return np.matmul(vectors * np.maximum(values, 0.0)[:, None, :], vectors.transpose(0, 2, 1))


_AREA_BEND = np.zeros((6, 6))  # of twice the area of a triangle, by its corners' x and y in turn
for _one, _other in ((0, 1), (1, 2), (2, 0)):
    _AREA_BEND[2 * _one, 2 * _other + 1] = _AREA_BEND[2 * _other + 1, 2 * _one] = 1.0
    _AREA_BEND[2 * _one + 1, 2 * _other] = _AREA_BEND[2 * _other, 2 * _one + 1] = -1.0
_SQUARE_BEND = 2.0 * np.kron(np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]), np.eye(2))
