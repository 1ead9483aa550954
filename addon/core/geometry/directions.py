"""Sets of unit directions: evenly distributed over the sphere, on octahedral maps or rings, or held out for measurements; and directions on
a square grid that a shader can look up, with bilinear taps."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .transforms import normalize, rotations_of_quaternions

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
BONN_RINGS = (1, 6, 12, 18, 20, 24)  # directions at 0, 15, ... 75 degrees from the pole
SUBCELLS = 16  # along each side of a cell, for the sum of solid angles


def fibonacci_sphere(count: int) -> np.ndarray:
    """Return (count, 3) float64 unit directions on a golden-angle spiral from +Z to -Z, each with about the same solid angle."""
    return golden_spiral(1.0 - (2.0 * np.arange(count) + 1.0) / count)


def golden_spiral(heights: np.ndarray, first_azimuth: float = 0.0) -> np.ndarray:
    """Return (N, 3) unit directions with z = `heights` (N,), each the golden angle around +Z from the one before."""
    radii = np.sqrt(1.0 - heights**2)
    azimuths = GOLDEN_ANGLE * np.arange(len(heights)) + first_azimuth
    return np.stack([radii * np.cos(azimuths), radii * np.sin(azimuths), heights], axis=1)


def from_octahedral(points: np.ndarray) -> np.ndarray:
    """Return unit directions (..., 3) for points (..., 2) in -1..1 of the octahedral map: +Z at the center, -Z in the four corners."""
    x, y = points[..., 0], points[..., 1]
    z = 1.0 - np.abs(x) - np.abs(y)
    folded = np.maximum(-z, 0.0)
    return normalize(np.stack([x - np.copysign(folded, x), y - np.copysign(folded, y), z], axis=-1))


def to_octahedral(directions: np.ndarray) -> np.ndarray:
    """Return points (..., 2) in -1..1 of the octahedral map for directions (..., 3) of any non-zero length. Inverts `from_octahedral`."""
    x, y, z = np.moveaxis(directions / np.abs(directions).sum(axis=-1, keepdims=True), -1, 0)
    below = z < 0.0
    folded_x = np.where(below, np.copysign(1.0 - np.abs(y), x), x)
    folded_y = np.where(below, np.copysign(1.0 - np.abs(x), y), y)
    return np.stack([folded_x, folded_y], axis=-1)


def from_hemi_octahedral(points: np.ndarray) -> np.ndarray:
    """Return unit directions (..., 3) with z >= 0 for points (..., 2) in -1..1 of the hemi-octahedral map, a square for the upper half."""
    x = 0.5 * (points[..., 0] + points[..., 1])
    y = 0.5 * (points[..., 0] - points[..., 1])
    z = np.maximum(1.0 - np.abs(x) - np.abs(y), 0.0)  # rounding would put some of the edge below the horizon
    return normalize(np.stack([x, y, z], axis=-1))


def to_hemi_octahedral(directions: np.ndarray) -> np.ndarray:
    """Return points (..., 2) in -1..1 of the hemi-octahedral map for directions (..., 3) with z >= 0. Inverts `from_hemi_octahedral`."""
    x, y, _ = np.moveaxis(directions / np.abs(directions).sum(axis=-1, keepdims=True), -1, 0)
    return np.stack([x + y, x - y], axis=-1)


def from_spherical(angles: np.ndarray) -> np.ndarray:
    """Return unit directions (..., 3) for angles (..., 2) in radians: polar angle from +Z, azimuth around +Z from +X."""
    polar, azimuth = angles[..., 0], angles[..., 1]
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)


def to_spherical(directions: np.ndarray) -> np.ndarray:
    """Return angles (..., 2) in radians for unit directions (..., 3): polar 0 to pi, azimuth 0 to 2 pi. Inverts `from_spherical`."""
    horizontal = np.hypot(directions[..., 0], directions[..., 1])
    azimuth = np.arctan2(directions[..., 1], directions[..., 0]) % (2.0 * np.pi)
    return np.stack([np.arctan2(horizontal, directions[..., 2]), np.where(horizontal > 1e-9, azimuth, 0.0)], axis=-1)


def bonn_directions() -> np.ndarray:
    """Return the (81, 3) unit directions above the horizon, on rings 15 degrees apart, of the measurements of the Bonn BTF database.

    (Sattler, Sarlette, Klein: Efficient and realistic visualization of cloth, 2003.)
    """
    polar_angles = [np.radians(15.0 * ring) for ring in range(len(BONN_RINGS))]
    azimuths = [2.0 * np.pi * np.arange(count) / count for count in BONN_RINGS]
    angles = [np.stack([np.full(len(ring), polar), ring], axis=-1) for polar, ring in zip(polar_angles, azimuths, strict=True)]
    return from_spherical(np.concatenate(angles))


def octahedral_grid(size: int) -> np.ndarray:
    """Return (size * size, 3) directions at the cell centers of an octahedral map, row by row from (-1, -1)."""
    return from_octahedral(_cell_centers(size))


def hemi_octahedral_grid(size: int) -> np.ndarray:
    """Return (size * size, 3) directions with z > 0 at the cell centers of a hemi-octahedral map, row by row from (-1, -1)."""
    return from_hemi_octahedral(_cell_centers(size))


def held_out_views(count: int = 12, seed: int = 0) -> np.ndarray:
    """Return (count, 3) unit directions for measurements: distributed over the whole sphere and away from the coordinate axes.

    Axis-aligned views favor or penalize objects that are aligned to the axes themselves. Of 64 random rotations of one even set, the one
    is chosen whose directions keep farthest from the six half axes.
    """
    quaternions = np.random.default_rng(seed).normal(size=(64, 4))  # Normalized, they are uniformly distributed rotations.
    candidates = fibonacci_sphere(count) @ rotations_of_quaternions(normalize(quaternions))
    max_axis_cosines = np.abs(candidates).max(axis=(1, 2))
    return candidates[np.argmin(max_axis_cosines)]


def _cell_centers(size: int) -> np.ndarray:
    centers = (2.0 * np.arange(size) + 1.0) / size - 1.0
    return np.stack(np.meshgrid(centers, centers), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class DirectionGrid:
    """size x size directions at the cell centers of an octahedral map, or of a hemi-octahedral one (`upper`: z > 0 only).

    Index i * size + j is row i (y), column j (x) of the map, starting at (-1, -1).
    """

    size: int
    upper: bool = False

    def __len__(self) -> int:
        return self.size**2

    @cached_property
    def directions(self) -> np.ndarray:
        """(N, 3) float64 unit vectors."""
        return hemi_octahedral_grid(self.size) if self.upper else octahedral_grid(self.size)

    @cached_property
    def solid_angles(self) -> np.ndarray:
        """(N,) steradians of every cell; they sum to 4 pi, or to 2 pi for the upper half.

        An area dx dy of the octahedron |x| + |y| + |z| = 1 at the point p subtends dx dy / |p|^3.
        """
        count = self.size * SUBCELLS
        centers = (2.0 * np.arange(count) + 1.0) / count - 1.0
        points = np.stack(np.meshgrid(centers, centers), axis=-1)
        directions = from_hemi_octahedral(points) if self.upper else from_octahedral(points)
        per_area = np.abs(directions).sum(axis=-1) ** 3 * (0.5 if self.upper else 1.0)
        cells = per_area.reshape(self.size, SUBCELLS, self.size, SUBCELLS).sum(axis=(1, 3)).ravel()
        return cells * (2.0 if self.upper else 4.0) * np.pi / cells.sum()

    def to_map(self, directions: np.ndarray) -> np.ndarray:
        """Return map positions (..., 2) in -1..1. On the upper half, directions below the horizon are moved up to it."""
        if not self.upper:
            return to_octahedral(directions)
        raised = np.concatenate([directions[..., :2], np.maximum(directions[..., 2:], 0.0)], axis=-1)
        points_down = np.abs(raised).sum(axis=-1, keepdims=True) == 0.0
        return to_hemi_octahedral(np.where(points_down, [1.0, 0.0, 0.0], raised))

    def taps(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the four grid directions around each of `directions` (M, 3): indices (M, 4) int32 and bilinear weights (M, 4) that sum
        to 1."""
        cells = 0.5 * (self.to_map(directions) + 1.0) * self.size - 0.5
        low = np.floor(cells).astype(np.int64)
        t = cells - low
        columns = low[:, :1] + [0, 1, 0, 1]
        rows = low[:, 1:] + [0, 0, 1, 1]
        x, y = t[:, :1], t[:, 1:]
        weights = np.concatenate([(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y], axis=1)
        return self.indices(rows, columns), weights

    def interpolate(self, values: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Interpolate `values` (N, ...) of the grid at `directions` (M, 3): (M, ...) float32."""
        indices, weights = self.taps(directions)
        return np.einsum("mt,mt...->m...", weights, values[indices]).astype(np.float32)

    def indices(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the direction indices (int32) of map cells. Cells may lie one cell outside, where the map continues across its fold.

        The upper half has no fold: its edge is the horizon, and cells outside are clamped to it.
        """
        last = self.size - 1
        if self.upper:
            return (np.clip(rows, 0, last) * self.size + np.clip(columns, 0, last)).astype(np.int32)
        outside = (columns < 0) | (columns > last)
        rows, columns = np.where(outside, last - rows, rows), np.clip(columns, 0, last)
        outside = (rows < 0) | (rows > last)
        columns, rows = np.where(outside, last - columns, columns), np.clip(rows, 0, last)
        return (rows * self.size + columns).astype(np.int32)

    def pad(self, values: np.ndarray) -> np.ndarray:
        """Arrange `values` (N, ...) as a tile (size + 2, size + 2, ...): the map with a padding of one cell, so that a bilinear lookup
        between cell centers is correct up to the edge."""
        rows, columns = np.meshgrid(np.arange(-1, self.size + 1), np.arange(-1, self.size + 1), indexing="ij")
        return values[self.indices(rows, columns)]
