"""Colors for the last scales at which vertices are features: from blue for fine features to yellow for those of the coarsest scale."""

import numpy as np

from .scale_space.features import SCALES

RAMP = np.array([[0.20, 0.22, 0.55], [0.13, 0.45, 0.60], [0.15, 0.65, 0.45], [0.60, 0.80, 0.20], [1.00, 0.88, 0.12]])  # sRGB
OPACITY = 0.9


def color_scales(scales: np.ndarray, lowest: int) -> np.ndarray:
    """Return colors with opacity (N, 4) float32, sRGB, of last `scales` (N,); those below `lowest` are transparent."""
    fractions = np.clip(np.asarray(scales, np.float64) / (SCALES - 1), 0.0, 1.0)
    stops = np.linspace(0.0, 1.0, len(RAMP))
    colors = [np.interp(fractions, stops, RAMP[:, channel]) for channel in range(3)]
    return np.stack([*colors, np.where(np.asarray(scales) >= lowest, OPACITY, 0.0)], axis=1).astype(np.float32)
