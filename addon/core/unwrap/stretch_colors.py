"""Stretch as colours: white where lengths are as they should be, red where texels are stretched out, blue where they are crowded."""

import numpy as np

from ..raster import painted

EVEN, STRETCHED, CROWDED = np.array([0.93, 0.93, 0.90]), np.array([0.75, 0.10, 0.08]), np.array([0.10, 0.28, 0.70])
FULL = 2.0  # times as long as it should be, or as short: full colour
PAPER = 0.16


def stretch_colors(stretches: np.ndarray) -> np.ndarray:
    """Colours (N, 3) float32, sRGB, of `stretches` (N,), 1 for none."""
    share = np.clip(np.log(np.maximum(stretches, 1e-6)) / np.log(FULL), -1.0, 1.0)[:, None]
    return (EVEN + np.abs(share) * (np.where(share > 0.0, STRETCHED, CROWDED) - EVEN)).astype(np.float32)


def stretch_picture(corners: np.ndarray, stretches: np.ndarray, side: int) -> np.ndarray:
    """A picture (side, side, 3), sRGB, of a UV map with `corners` (T, 3, 2), its triangles coloured by `stretches` (T,)."""
    return painted(np.asarray(corners, np.float64) * side, stretch_colors(stretches), (side, side), PAPER)
