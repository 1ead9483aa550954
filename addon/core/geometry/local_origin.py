"""Coordinates far from the origin, such as those of maps: Blender keeps them in single precision, which is too coarse there."""

import numpy as np

MAX_SPACING = 1e-5  # between neighboring numbers of single precision, relative to the extent: a tenth of a texel of large textures


def find_local_origin(points: np.ndarray) -> np.ndarray | None:
    """Return a position (3,) near `points` (N, 3), with few digits, in relation to which single precision is exact enough for them; None if
    it is so already, or they have no extent."""
    finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    if not len(finite):
        return None
    low, high = finite.min(axis=0), finite.max(axis=0)
    extent = float(np.linalg.norm(high - low))
    farthest = float(max(np.abs(low).max(), np.abs(high).max()))
    if extent == 0.0 or np.spacing(np.float32(farthest)) <= MAX_SPACING * extent:
        return None
    step = 10.0 ** np.ceil(np.log10(extent))
    return np.round(0.5 * (low + high) / step) * step


def describe_coarseness(points: np.ndarray, subject: str = "The mesh", exported: str = "mesh and cameras") -> str:
    """Return a sentence about a `subject` with `points` (N, 3) that is too far from the origin, empty if it is not.

    exported: what should be exported otherwise.
    """
    if find_local_origin(points) is None:
        return ""
    step = np.spacing(np.float32(np.abs(points[np.isfinite(points).all(axis=1)]).max()))
    return (
        f"{subject} is so far from the origin that Blender has rounded its coordinates to multiples of {step:.2g}; use an .obj file, or "
        f"a .ply file with double precision, which Farfield moves to the origin, or export {exported} with local coordinates."
    )


def describe_move(origin: np.ndarray, subject: str = "Mesh and cameras") -> str:
    """Return a sentence about a `subject` that was moved from `origin` (3,) to the origin."""
    x, y, z = (f"{-value:,.10g}" if value else "0" for value in origin)
    return f"{subject} were moved by ({x}; {y}; {z}), since their coordinates are too large for single precision."
