"""Smooth normals for the corners of quads.

Cycles lights a normal-mapped surface only from the side that its smooth normal faces. A quad stands for faces that lean up to 60 degrees
from it, so with its flat normal whole quads would stay dark that should be lit at a grazing angle. Corner normals that follow the normal
map as well as a linear field can make that test right nearly everywhere.
"""

import numpy as np

from ..core.billboards.cloud import Level
from .textures import Maps

STEEPEST = 0.2  # least cosine between a corner's normal and the quad's: beyond it a corner would face away


def corner_normals(level: Level, maps: Maps, quad: int, cutout: np.ndarray) -> np.ndarray:
    """Unit normals (C, 3) in world space at the points `cutout` (C, 2), in -1..1 of the half sizes of one `quad`.

    The linear field that fits the normals of the quad's texels in `maps` best, weighted by coverage. Where they disagree so much that
    their mean is short, as in foliage, it leans back to the quad's own normal.
    """
    x, y, width, height = level.atlas.rectangles[quad]
    normals = maps.normal[y : y + height, x : x + width].reshape(-1, 3).astype(np.float64)
    weights = maps.colour[y : y + height, x : x + width, 3].ravel().astype(np.float64)
    own = level.quads.frames[quad, 2]
    if weights.sum() <= 0.0:
        return np.tile(own, (len(cutout), 1))
    rows, columns = np.divmod(np.arange(width * height), width)
    scale = 0.5 * level.texel / np.maximum(level.quads.half_sizes[quad], 1e-300)
    places = np.column_stack([(2 * columns + 1 - width) * scale[0], (2 * rows + 1 - height) * scale[1], np.ones(width * height)])
    # A little of a constant keeps the fit of one texel or one row of texels well posed.
    ridge = 1e-3 * weights.sum() * np.diag([1.0, 1.0, 0.0]) + 1e-9 * np.eye(3)
    weighted = places * weights[:, None]
    field = np.linalg.solve(weighted.T @ places + ridge, weighted.T @ normals)
    fitted = np.column_stack([cutout, np.ones(len(cutout))]) @ field
    agreement = min(float(np.linalg.norm(field[2])), 1.0)
    return _not_too_steep(fitted + (1.0 - agreement) * own, own)


def _not_too_steep(directions: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Unit vectors (C, 3) of `directions`, turned towards `own` (3,) where they lean too far from it."""
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    unit = np.where(lengths > 1e-9, directions / np.maximum(lengths, 1e-9), own)
    along = unit @ own
    flat = unit - along[:, None] * own
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    limited = STEEPEST * own + np.sqrt(1.0 - STEEPEST**2) * flat
    return np.where(along[:, None] < STEEPEST, limited, unit)
