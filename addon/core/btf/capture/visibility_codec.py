"""Visibility of a light from texels, encoded in one byte each."""

import numpy as np

UNKNOWN = 255
FULLY_VISIBLE = UNKNOWN - 1


def encode_visibility(visible: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return the visible fraction (N,) uint8 of texels, 0 to FULLY_VISIBLE; UNKNOWN where nothing of a texel was seen.

    visible, hidden (N,): numbers of subsamples that a light sees, and that other surfaces hide from it.
    """
    total = visible + hidden
    return np.where(total > 0.0, np.rint((UNKNOWN - 1) * visible / np.maximum(total, 1.0)), UNKNOWN).astype(np.uint8)
