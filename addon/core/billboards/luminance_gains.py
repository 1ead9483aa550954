"""Gains of texels that give a level the luminance, or the coverage, of its source.

A quad shows all leaves within one error of its plane, so these no longer shade each other, and a crown would get too bright. The ratio of
both images where a texel is seen, averaged over many views, corrects that like a baked ambient occlusion map.
"""

import numpy as np
from scipy.ndimage import find_objects, gaussian_filter

BLUR = 6.0  # texels
PRIOR = 100.0  # Observations that the mean of a quad, and that of the level, count as.
TOLERANCE = 0.02  # Deviations of the luminance that are noise.
MIN_GAIN, MAX_GAIN = 0.2, 1.5


def compute_gains(texels: np.ndarray, wanted: np.ndarray, shown: np.ndarray, quad_map: np.ndarray) -> np.ndarray:
    """Return the factor (H, W) float32 of every texel; 1 where the luminance is right but for noise.

    Args:
        texels: (N,) row-major indices of the texels that N pixels show, from any views.
        wanted: (N,) luminance or coverage of the source in these pixels.
        shown: (N,) that of the level.
        quad_map: (H, W) int32 quad of each texel, -1 for none.
    """
    size = quad_map.size
    count, wanted, shown = (np.bincount(texels, weights, size) for weights in (None, wanted, shown))
    if not shown.sum() > 0.0:
        return np.ones(quad_map.shape, np.float32)
    mean = wanted.sum() / shown.sum()
    per_observation = shown.sum() / count.sum()
    quads = quad_map.ravel() + 1
    prior = PRIOR * per_observation
    of_quads = (np.bincount(quads, wanted) + prior * mean) / (np.bincount(quads, shown) + prior)
    gains = np.ones(quad_map.shape)
    spread = 2.0 * np.pi * BLUR**2  # A blurred sum counts the observations around a texel.
    for quad, cell in enumerate(find_objects(quad_map + 1)):
        if cell is None:
            continue
        is_inside = quad_map[cell] == quad
        wanted_around, shown_around = (
            spread * gaussian_filter(np.where(is_inside, values.reshape(quad_map.shape)[cell], 0.0), BLUR, mode="constant")
            for values in (wanted, shown)
        )
        gain = (wanted_around + prior * of_quads[quad + 1]) / (shown_around + prior)
        gains[cell] = np.where(is_inside, gain, gains[cell])
    gains *= wanted.sum() / (gains.ravel() * shown).sum()
    deviation = np.clip(gains, MIN_GAIN, MAX_GAIN) - 1.0
    significance = np.clip(np.abs(deviation) / TOLERANCE - 1.0, 0.0, 1.0)
    return (1.0 + significance * deviation).astype(np.float32)
