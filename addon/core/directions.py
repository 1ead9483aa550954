"""Sets of unit directions: spread evenly over the sphere, laid out on octahedral maps or rings, or held out for measuring."""

import numpy as np

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
BONN_RINGS = (1, 6, 12, 18, 20, 24)  # directions at 0, 15, ... 75 degrees from the pole


def fibonacci_sphere(count: int) -> np.ndarray:
    """(count, 3) float64 unit directions on a golden-angle spiral from +Z to -Z, each for about the same solid angle."""
    steps = np.arange(count)
    heights = 1.0 - (2.0 * steps + 1.0) / count
    radii = np.sqrt(1.0 - heights**2)
    turns = GOLDEN_ANGLE * steps
    return np.stack([radii * np.cos(turns), radii * np.sin(turns), heights], axis=1)


def from_octahedral(points: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) for places (..., 2) in -1..1 of the octahedral map: +Z in the middle, -Z in the four corners."""
    x, y = points[..., 0], points[..., 1]
    z = 1.0 - np.abs(x) - np.abs(y)
    folded = np.maximum(-z, 0.0)
    return _normalized(np.stack([x - np.copysign(folded, x), y - np.copysign(folded, y), z], axis=-1))


def to_octahedral(directions: np.ndarray) -> np.ndarray:
    """Places (..., 2) in -1..1 on the octahedral map for directions (..., 3) of any length but zero. Inverse of `from_octahedral`."""
    x, y, z = np.moveaxis(directions / np.abs(directions).sum(axis=-1, keepdims=True), -1, 0)
    below = z < 0.0
    folded_x = np.where(below, np.copysign(1.0 - np.abs(y), x), x)
    folded_y = np.where(below, np.copysign(1.0 - np.abs(x), y), y)
    return np.stack([folded_x, folded_y], axis=-1)


def from_hemi_octahedral(points: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) with z >= 0 for places (..., 2) in -1..1 of the hemi-octahedral map: the whole square is the upper half."""
    x = 0.5 * (points[..., 0] + points[..., 1])
    y = 0.5 * (points[..., 0] - points[..., 1])
    z = np.maximum(1.0 - np.abs(x) - np.abs(y), 0.0)  # rounding would put some of the rim below the horizon
    return _normalized(np.stack([x, y, z], axis=-1))


def to_hemi_octahedral(directions: np.ndarray) -> np.ndarray:
    """Places (..., 2) in -1..1 on the hemi-octahedral map for directions (..., 3) with z >= 0. Inverse of `from_hemi_octahedral`."""
    x, y, _ = np.moveaxis(directions / np.abs(directions).sum(axis=-1, keepdims=True), -1, 0)
    return np.stack([x + y, x - y], axis=-1)


def from_spherical(angles: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) for angles (..., 2) in radians: from +Z down, and around +Z from +X on."""
    polar, turn = angles[..., 0], angles[..., 1]
    return np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1)


def to_spherical(directions: np.ndarray) -> np.ndarray:
    """Angles (..., 2) in radians for unit directions (..., 3): 0 to pi from +Z down, 0 to 2 pi around it. Inverse of `from_spherical`."""
    across = np.hypot(directions[..., 0], directions[..., 1])
    turn = np.arctan2(directions[..., 1], directions[..., 0]) % (2.0 * np.pi)
    return np.stack([np.arctan2(across, directions[..., 2]), np.where(across > 1e-9, turn, 0.0)], axis=-1)


def bonn_directions() -> np.ndarray:
    """(81, 3) unit directions above the horizon: the rings, 15 degrees apart, that textures of the Bonn database were measured from.

    (Sattler, Sarlette, Klein: Efficient and realistic visualization of cloth, 2003.)
    """
    rings = [np.radians(15.0 * ring) for ring in range(len(BONN_RINGS))]
    turns = [2.0 * np.pi * np.arange(count) / count for count in BONN_RINGS]
    angles = [np.stack([np.full(len(turn), polar), turn], axis=-1) for polar, turn in zip(rings, turns, strict=True)]
    return from_spherical(np.concatenate(angles))


def octahedral_grid(size: int) -> np.ndarray:
    """(size * size, 3) directions at the cell centres of an octahedral map, row by row from (-1, -1) on."""
    return from_octahedral(_cell_centres(size))


def hemi_octahedral_grid(size: int) -> np.ndarray:
    """(size * size, 3) directions with z > 0 at the cell centres of a hemi-octahedral map, row by row from (-1, -1) on."""
    return from_hemi_octahedral(_cell_centres(size))


def held_out_views(count: int = 12, seed: int = 0) -> np.ndarray:
    """(count, 3) unit directions for measuring: spread over the whole sphere and away from the coordinate axes.

    Axis-aligned views flatter or hurt what is itself aligned to the axes. Of 64 random turns of one even set, the turn is taken whose
    directions keep farthest from the six half axes.
    """
    turns = _random_rotations(64, np.random.default_rng(seed))
    candidates = fibonacci_sphere(count) @ turns
    nearness_to_axes = np.abs(candidates).max(axis=(1, 2))
    return candidates[np.argmin(nearness_to_axes)]


def _normalized(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _cell_centres(size: int) -> np.ndarray:
    centres = (2.0 * np.arange(size) + 1.0) / size - 1.0
    return np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)


def _random_rotations(count: int, random: np.random.Generator) -> np.ndarray:
    """(count, 3, 3) rotation matrices, uniform over all rotations: unit quaternions from normally distributed components."""
    w, x, y, z = _normalized(random.normal(size=(count, 4))).T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
