"""Origins near the viewer, so that positions relative to them are accurate in single precision."""

import numpy as np


def choose_origin(viewer: np.ndarray, step: float, max_distance: float) -> np.ndarray:
    """Return the position (3,) float64 that single-precision vertices around a viewer at (3,) are relative to.

    It is zero, except along axes on which the viewer is farther than `max_distance` from zero: there it is the multiple of `step` next to
    the viewer.
    """
    return np.where(np.abs(viewer) > max_distance, np.rint(viewer / step) * step, 0.0)
