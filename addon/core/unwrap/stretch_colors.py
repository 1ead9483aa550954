"""Colors for UV stretch: white without stretch, red where texels are stretched, blue where they are compressed."""

import numpy as np

from ..imaging.raster import fill_triangles

NEUTRAL, STRETCHED, COMPRESSED = np.array([0.93, 0.93, 0.90]), np.array([0.75, 0.10, 0.08]), np.array([0.10, 0.28, 0.70])
SATURATION_STRETCH = 2.0  # stretch, or its inverse, that gets the full color
BACKGROUND = 0.16


def stretch_colors(stretches: np.ndarray) -> np.ndarray:
    """Return colors (N, 3) float32, sRGB, of `stretches` (N,); 1 is no stretch."""
    t = np.clip(np.log(np.maximum(stretches, 1e-6)) / np.log(SATURATION_STRETCH), -1.0, 1.0)[:, None]
    return (NEUTRAL + np.abs(t) * (np.where(t > 0.0, STRETCHED, COMPRESSED) - NEUTRAL)).astype(np.float32)


def draw_stretch_image(corner_uvs: np.ndarray, stretches: np.ndarray, resolution: int) -> np.ndarray:
    """Return an image (resolution, resolution, 3), sRGB, of a UV map `corner_uvs` (T, 3, 2), colored by `stretches` (T,)."""
    return fill_triangles(np.asarray(corner_uvs, np.float64) * resolution, stretch_colors(stretches), (resolution, resolution), BACKGROUND)
