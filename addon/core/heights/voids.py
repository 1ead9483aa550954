"""Numbers that mean "unknown" although the file does not declare it, such as -9999.

Programs write them into files whose format, or whose author, has no place for the declaration. They lie far from all heights around them,
which no terrain does.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..messages import format_count

# Esri, Surfer and others; SRTM and DTED; Mapbox's Terrain-RGB where nothing is; the ends of 16 and 32 bits.
VOID_NUMBERS = (-999, -9999, -10_000, -32_767, -32_768, -99_999, -999_999, -9_999_999, -2_147_483_648, 32_767, 99_999)
MIN_GAP = 500.0  # between such a number and the nearest height, in the unit of the file


@dataclass(frozen=True)
class Void:
    """A height that means "unknown". number: how the file writes it. height: what the reader makes of it. count: how often it occurs."""

    number: float
    height: np.float32
    count: int


def find_voids(parts: Iterable[np.ndarray], candidates: dict[float, np.float32], scale: float) -> list[Void]:
    """Return the candidates that occur in heights (h, w) float32, and are far from all others.

    candidates: heights by numbers of the file. scale: heights per number.
    """
    numbers, heights = list(candidates), np.array(list(candidates.values()), np.float32)
    if not numbers:
        return []
    counts = np.zeros(len(heights), np.int64)
    below, above = heights[heights < 0].max(initial=-np.inf), heights[heights > 0].min(initial=np.inf)
    low, high = np.inf, -np.inf
    for part in parts:
        lowest, highest = _range(part)
        if not below < lowest <= highest < above:
            counts += [np.count_nonzero(part == height) for height in heights]
            lowest, highest = _range(part[~np.isin(part, heights)])
        low, high = min(low, lowest), max(high, highest)
    gap = MIN_GAP * abs(scale)
    voids = (Void(*void) for void in zip(numbers, heights, counts.tolist(), strict=True))
    return [void for void in voids if void.count and not low - gap <= float(void.height) <= high + gap]


def _range(heights: np.ndarray) -> tuple[float, float]:
    """Return the lowest and the highest of heights of any shape, infinity and minus infinity if none is known."""
    return float(np.fmin.reduce(heights, axis=None, initial=np.inf)), float(np.fmax.reduce(heights, axis=None, initial=-np.inf))


def mask_voids(heights: np.ndarray, voids: Iterable[Void]) -> np.ndarray:
    """Replace the heights (h, w) float32 that mean "unknown" by NaN, in place."""
    for void in voids:
        heights[heights == void.height] = np.nan
    return heights


def name_voids(path: object, voids: Iterable[Void]) -> tuple[str, ...]:
    """Return the sentences for the user about heights that are taken as holes."""
    return tuple(f'"{path}" has {format_count(void.count, "height")} of {void.number:.7g}, taken as unknown.' for void in voids)
