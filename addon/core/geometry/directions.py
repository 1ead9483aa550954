"""Sets of unit directions: evenly distributed over the sphere, on octahedral maps or rings, or held out for measurements."""

import numpy as np

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
BONN_RINGS = (1, 6, 12, 18, 20, 24)  # directions at 0, 15, ... 75 degrees from the pole


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
    return _normalize(np.stack([x - np.copysign(folded, x), y - np.copysign(folded, y), z], axis=-1))


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
    return _normalize(np.stack([x, y, z], axis=-1))


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
    rotations = _random_rotations(64, np.random.default_rng(seed))
    candidates = fibonacci_sphere(count) @ rotations
    max_axis_cosines = np.abs(candidates).max(axis=(1, 2))
    return candidates[np.argmin(max_axis_cosines)]


def _normalize(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _cell_centers(size: int) -> np.ndarray:
    centers = (2.0 * np.arange(size) + 1.0) / size - 1.0
    return np.stack(np.meshgrid(centers, centers), axis=-1).reshape(-1, 2)


def _random_rotations(count: int, random: np.random.Generator) -> np.ndarray:
    """Return (count, 3, 3) uniformly distributed rotation matrices, from unit quaternions with normally distributed components."""
    w, x, y, z = _normalize(random.normal(size=(count, 4))).T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
