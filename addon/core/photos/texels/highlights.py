"""Highlights move with the camera: where several photographs show a place, those in which it is much brighter than in the darker ones lose
weight.

Smoothed brightness decides, so that whole highlights lose weight instead of single texels.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter

from ...files.scratch import Scratch
from ...imaging.colors import LUMINANCE
from ...imaging.images import sample_bilinear
from ..photographs.color_correction import ColorCorrection
from ..photographs.photograph import Photograph
from .face_visibility import SeenTexels

STEP = 4  # pixels of a photograph per sample of its brightness
SMOOTHING = 1.5  # standard deviation in samples
QUANTILE = 0.25  # Photographs of a place are compared with this quantile of their brightness.
TOLERANCE = 0.03  # A photograph that is so much brighter, encoded, loses half of its weight.
MIN_PHOTOGRAPHS = 3  # that show a place: of two, either might be right


class HighlightDetector:
    """Compares the brightness of places in photographs."""

    def __init__(self, photographs: Sequence[Photograph], corrections: Sequence[ColorCorrection], scratch: Scratch) -> None:
        """Measure the brightness of all photographs after their color `corrections`; `scratch` keeps what belongs to a photograph in its
        group."""
        self._maps = [
            scratch.keep(_measure_brightness(photograph, correction), index)
            for index, (photograph, correction) in enumerate(zip(photographs, corrections, strict=True))
        ]

    def rate(self, seen: Sequence[SeenTexels], count: int) -> list[np.ndarray]:
        """Return factors for the weights of what each photograph shows of `count` texels, 1 unless it is brighter than others."""
        brightness = np.full((len(seen), count), np.inf, np.float32)
        for row, texels, values in zip(brightness, seen, self._maps, strict=True):
            row[texels.indices] = sample_bilinear(values, texels.positions / np.float32(STEP))[:, 0]
        ordered = np.sort(brightness, axis=0)
        counts = np.isfinite(ordered).sum(axis=0)
        places = np.float32(QUANTILE) * np.maximum(counts - 1, 0)
        low = np.floor(places).astype(np.int64)
        columns = np.arange(count)
        lower, upper = ordered[low, columns], ordered[np.minimum(low + 1, np.maximum(counts - 1, 0)), columns]
        with np.errstate(invalid="ignore"):
            dark = lower + (places - low) * (upper - lower)
            excess = np.maximum(brightness - dark, 0.0) / np.float32(TOLERANCE)
        return [
            np.where(counts[texels.indices] >= MIN_PHOTOGRAPHS, 1.0 / (1.0 + np.square(row[texels.indices])), 1.0).astype(np.float32)
            for row, texels in zip(excess, seen, strict=True)
        ]


def _measure_brightness(photograph: Photograph, correction: ColorCorrection) -> np.ndarray:
    """Return the encoded brightness (h, w, 1) float32 of every STEP-th pixel, smoothed."""
    height, width = photograph.pixels.shape[:2]
    rows, columns = np.arange(0, height, STEP), np.arange(0, width, STEP)
    blocks = np.add.reduceat(np.add.reduceat(photograph.pixels.astype(np.float32), rows, axis=0), columns, axis=1)
    areas = np.diff(np.append(rows, height))[:, None] * np.diff(np.append(columns, width))[None, :]
    means = blocks / (areas[..., None] * np.float32(photograph.white)).astype(np.float32)
    positions = np.stack(np.broadcast_arrays(columns[None, :], rows[:, None]), axis=-1).reshape(-1, 2) + np.float32(0.5 * STEP)
    corrected = correction.apply(means.reshape(-1, 3), positions.astype(np.float32)).reshape(means.shape)
    return gaussian_filter(corrected @ LUMINANCE, SMOOTHING, mode="nearest")[..., None].astype(np.float32)
