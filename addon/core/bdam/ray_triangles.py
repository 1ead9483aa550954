"""Rays and triangles without gaps: a ray through an edge or vertex that triangles share hits at least one of them.

The method is that of Woop, Benthin and Wald, Watertight Ray/Triangle Intersection, 2013: positions are sheared into a space where the ray
is the positive z axis. Rounded products keep their order, so that the sign of their difference, on which side of the ray an edge passes, is
the exact one or zero. Zero counts as a hit. It is the same for both triangles of an edge because their corners are equal to the last bit.
"""

from dataclasses import dataclass

import numpy as np

from .textures.tile_index import morton_keys

BLOCK_TRIANGLES = 16  # that share a bounding box inside of a patch
MAX_BOX_TESTS = 1 << 18  # of rays and boxes that are evaluated at once, about 30 MB
MAX_BLOCK_TESTS = 1 << 13  # of rays and blocks of triangles that are evaluated at once, about 30 MB
BOX_MARGIN = 2.0**-40  # of the largest coordinate, more than the rounding of box and triangle tests
MIN_COMPONENT = 1e-290  # of a direction in box tests, instead of 0
NO_TRIANGLE = -1
MAX_PLACE, MIN_EXTENT = 255.0, 1e-9  # of the lattice that orders triangles


@dataclass(frozen=True)
class Rays:
    """Rays with finite origins and directions that are not zero.

    origins, directions: (N, 3) float64. axes: (N, 3) int64, the order of the axes in sheared space, the largest component of the direction
    last. shears: (N, 3) float64, the factors of that component in sheared x, y and z.
    """

    origins: np.ndarray
    directions: np.ndarray
    axes: np.ndarray
    shears: np.ndarray

    @classmethod
    def create(cls, origins: np.ndarray, directions: np.ndarray) -> "Rays":
        """Return the rays of origins and directions (N, 3)."""
        axes = (np.abs(directions).argmax(axis=1)[:, None] + np.array([1, 2, 0])) % 3
        sorted_directions = np.take_along_axis(directions, axes, axis=1)
        shears = np.concatenate([sorted_directions[:, :2], np.ones((len(axes), 1))], axis=1) / sorted_directions[:, 2:]
        return cls(origins, directions, axes, shears)

    def __len__(self) -> int:
        return len(self.origins)

    def take(self, rows: np.ndarray | slice) -> "Rays":
        """Return some of the rays."""
        return Rays(self.origins[rows], self.directions[rows], self.axes[rows], self.shears[rows])

    def enter_boxes(self, low: np.ndarray, high: np.ndarray, margin: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return where rays enter and leave boxes, as multiples of their directions, (...) float64 each.

        A ray misses its box if it leaves before it enters, or before its origin. Boxes are a little larger than given.

        Args:
            low, high: (..., 3), corners of boxes that fit (N, 1, 3) or (N, 3) if all rays are tested with one box each.
            margin: by which boxes are enlarged on every side, in addition to rounding.
        """
        shape = (len(self),) + (1,) * (low.ndim - 2) + (3,)
        origins, directions = self.origins.reshape(shape), self.directions.reshape(shape)
        largest = np.maximum(np.abs(low), np.abs(high)).max(axis=-1, keepdims=True)
        margins = margin + BOX_MARGIN * largest + BOX_MARGIN * np.abs(origins).max(axis=-1, keepdims=True)
        with np.errstate(over="ignore"):
            factors = 1.0 / np.where(np.abs(directions) < MIN_COMPONENT, MIN_COMPONENT, directions)
            first, second = (low - margins - origins) * factors, (high + margins - origins) * factors
        return np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)


class TriangleBlocks:
    """Triangles in blocks of neighbors with bounding boxes."""

    def __init__(self, positions: np.ndarray, triangles: np.ndarray) -> None:
        """positions: (V, 3) float64. triangles: (T, 3) int."""
        order = _sort_by_place(positions[triangles].mean(axis=1)[:, :2])
        block_count = -(-len(triangles) // BLOCK_TRIANGLES)
        order = order[np.minimum(np.arange(block_count * BLOCK_TRIANGLES), len(order) - 1)]
        self._coordinates, self._vertex_count = positions.T.ravel(), len(positions)
        self._triangles = triangles[order].reshape(block_count, BLOCK_TRIANGLES, 3).astype(np.int32)
        corners = positions[self._triangles].reshape(block_count, 3 * BLOCK_TRIANGLES, 3)
        self._low, self._high = corners.min(axis=1), corners.max(axis=1)

    def __len__(self) -> int:
        return len(self._low)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return sum(array.nbytes for array in (self._coordinates, self._triangles, self._low, self._high))

    def intersect(self, rays: Rays, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first triangles on rays.

        Args:
            limits: (N,) float64, multiples of the directions that must not be exceeded.

        Returns:
            Multiples of the directions (N,) float64, infinite where nothing is hit, and the triangles there (N,), which `normals` takes.
        """
        distances, triangles = np.full(len(rays), np.inf), np.full(len(rays), NO_TRIANGLE)
        size = max(MAX_BOX_TESTS // len(self._low), 1)
        for start in range(0, len(rays), size):
            part = rays.take(slice(start, start + size))
            near, far = part.enter_boxes(self._low[None], self._high[None])
            enters = (near <= far) & (far >= 0.0) & (near <= limits[start : start + size, None])
            rows, blocks = np.nonzero(enters)
            for first in range(0, len(rows), MAX_BLOCK_TESTS):
                chunk = slice(first, first + MAX_BLOCK_TESTS)
                self._test_blocks(rays, limits, rows[chunk] + start, blocks[chunk], distances, triangles)
        return distances, triangles

    def normals(self, triangles: np.ndarray) -> np.ndarray:
        """Return the normals (N, 3) float64, of any length, of triangles (N,) that `intersect` has found."""
        corners = self._coordinates.reshape(3, -1).T[self._triangles.reshape(-1, 3)[triangles]]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    def _test_blocks(
        self, rays: Rays, limits: np.ndarray, rows: np.ndarray, blocks: np.ndarray, distances: np.ndarray, triangles: np.ndarray
    ) -> None:
        """Test rays `rows` (P,) with all triangles of `blocks` (P,), and update the results of `intersect`."""
        found = self._measure(rays.take(rows), self._triangles[blocks])
        found[~((found >= 0.0) & (found <= limits[rows, None]))] = np.inf
        columns = found.argmin(axis=1)
        nearest = found[np.arange(len(rows)), columns]
        order = np.lexsort((nearest, rows))
        order = order[np.diff(rows[order], prepend=-1) > 0]  # the nearest one of each ray
        order = order[nearest[order] < distances[rows[order]]]
        distances[rows[order]] = nearest[order]
        triangles[rows[order]] = blocks[order] * BLOCK_TRIANGLES + columns[order]

    def _measure(self, rays: Rays, triangles: np.ndarray) -> np.ndarray:
        """Return where rays (P) hit triangles (P, B, 3), as multiples of directions (P, B), NaN where they do not."""
        axes = rays.axes[:, :, None, None]
        origins = np.take_along_axis(rays.origins, rays.axes, axis=1)[:, :, None, None]
        shears = rays.shears[:, :, None, None]
        x, y, z = (self._coordinates[axes[:, axis] * self._vertex_count + triangles] - origins[:, axis] for axis in range(3))
        x -= shears[:, 0] * z
        y -= shears[:, 1] * z
        (ax, bx, cx), (ay, by, cy) = np.moveaxis(x, -1, 0), np.moveaxis(y, -1, 0)
        weights = np.stack([cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax], axis=-1)
        sums = weights.sum(axis=-1)
        is_hit = ((weights >= 0.0).all(axis=-1) | (weights <= 0.0).all(axis=-1)) & (sums != 0.0)
        depths = (weights * z).sum(axis=-1) * shears[:, 2, :, 0]
        return np.divide(depths, sums, out=np.full(depths.shape, np.nan), where=is_hit)


def _sort_by_place(points: np.ndarray) -> np.ndarray:
    """Return the order (N,) of points (N, 2) along a curve on which neighbors are close."""
    low, high = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    places = (points - low) * (MAX_PLACE / np.maximum(high - low, MIN_EXTENT))
    return np.argsort(morton_keys(places.astype(np.int64)), kind="stable")
