"""Smooth normals for the corners of quads.

Cycles lights a normal-mapped surface only from the side that its smooth normal faces. A quad shows faces that deviate by up to 60 degrees
from it, so with its flat normal a whole quad would stay dark at a grazing angle where it should be lit. Corner normals that follow the
normal map, as well as a linear field can, make this test correct nearly everywhere.
"""

import numpy as np

from ...core.billboards.cloud import Level
from .level_maps import PbrMaps

MIN_COSINE = 0.2  # between a corner's normal and the quad's; with less a corner would face away
RIDGE = 1e-3  # Tikhonov regularization of the slopes, relative to the total weight: keeps the fit of one row of texels well posed


def compute_corner_normals(level: Level, maps: PbrMaps, quad: int, cutout: np.ndarray) -> np.ndarray:
    """Compute unit normals (C, 3) in world space at the points `cutout` (C, 2), in -1..1 of the half sizes of one `quad`.

    They are a linear least-squares fit to the normals of the quad's texels in `maps`, weighted by coverage. Where the texel normals
    disagree so much that their mean is short, as in foliage, the result is blended with the quad's own normal.
    """
    x, y, width, height = level.atlas.rectangles[quad]
    normals = maps.normal[y : y + height, x : x + width].reshape(-1, 3).astype(np.float64)
    weights = maps.color[y : y + height, x : x + width, 3].ravel().astype(np.float64)
    quad_normal = level.quads.frames[quad, 2]
    if weights.sum() <= 0.0:
        return np.tile(quad_normal, (len(cutout), 1))
    rows, columns = np.divmod(np.arange(width * height), width)
    half_texel = 0.5 * level.texel_size  # smaller quads have one texel, at their center
    scale = half_texel / np.maximum(level.quads.half_sizes[quad], half_texel)
    design = np.column_stack([(2 * columns + 1 - width) * scale[0], (2 * rows + 1 - height) * scale[1], np.ones(width * height)])
    ridge = RIDGE * weights.sum() * np.diag([1.0, 1.0, 0.0]) + 1e-9 * np.eye(3)
    weighted = design * weights[:, None]
    coefficients = np.linalg.solve(weighted.T @ design + ridge, weighted.T @ normals)
    fitted = np.column_stack([cutout, np.ones(len(cutout))]) @ coefficients
    agreement = min(float(np.linalg.norm(coefficients[2])), 1.0)
    return _limit_angle(fitted + (1.0 - agreement) * quad_normal, quad_normal)


def _limit_angle(directions: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Normalize `directions` (C, 3) and rotate those that deviate too far from `axis` (3,) towards it."""
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    unit = np.where(lengths > 1e-9, directions / np.maximum(lengths, 1e-9), axis)
    cosines = unit @ axis
    tangent = unit - cosines[:, None] * axis
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    limited = MIN_COSINE * axis + np.sqrt(1.0 - MIN_COSINE**2) * tangent
    return np.where(cosines[:, None] < MIN_COSINE, limited, unit)
