"""Which candidates become the levels of an object, and when each shows.

A level shows where a pixel is larger than its pixel size. The original has the pixel size 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MAX_COST_RATIO = 0.75  # Of a level to the level before; one that saves less is not worth a switch.
MAX_VANISHING_AREA = 0.05  # Of parts that vanish, relative to that of all bounding boxes.
TRANSPARENT_COST = 16  # Of a triangle that an opacity map cuts out, in opaque ones: rays go on behind it.
# An object is light enough by what shows it where it is this small in an image, in pixels: if all its places together have few triangles,
# or not many and at most this fraction of the original ones. Perceptual levels take minutes, and Cycles takes more memory and time for the
# images and transparent quads of a cloud than for such a mesh.
SMALL_PIXELS, FEW_TRIANGLES, MANY_TRIANGLES, LIGHT_FRACTION = 32.0, 20_000, 100_000, 0.25


@dataclass(frozen=True)
class LevelCandidate:
    """What may become a level.

    Attributes:
        triangles: their number.
        pixel_size: of the pixels above which it looks like the original, a length in units of the object.
        transparent: number of triangles that opacity maps cut out.
    """

    triangles: int
    pixel_size: float
    transparent: int = 0

    @property
    def cost(self) -> int:
        """What a render pays for it, in opaque triangles."""
        return self.triangles + (TRANSPARENT_COST - 1) * self.transparent


def choose_levels(candidates: Sequence[LevelCandidate]) -> list[int]:
    """Return the indices of the candidates that become levels, finest first.

    The first level is the original, the candidate with the pixel size 0. Each further one costs at most `MAX_COST_RATIO`
    times as much as the level before.
    """
    chosen: list[int] = []
    for index in sorted(range(len(candidates)), key=lambda index: (candidates[index].pixel_size, candidates[index].cost)):
        candidate = candidates[index]
        if not chosen or candidate.cost <= MAX_COST_RATIO * candidates[chosen[-1]].cost:
            chosen.append(index)
    return chosen


def combine_levels(parts: Sequence[Sequence[LevelCandidate]]) -> list[tuple[LevelCandidate, tuple[int, ...]]]:
    """Return candidates for several objects that switch together, and the index of the level of each object in them.

    parts: the candidates of each object in the same unit, finest first, of which the first is the original.
    """
    combined = []
    for pixel_size in sorted({level.pixel_size for levels in parts for level in levels}):
        indices = tuple(max(index for index, level in enumerate(levels) if level.pixel_size <= pixel_size) for levels in parts)
        shown = [levels[index] for levels, index in zip(parts, indices, strict=True)]
        triangles, transparent = sum(level.triangles for level in shown), sum(level.transparent for level in shown)
        combined.append((LevelCandidate(triangles, pixel_size, transparent), indices))
    return combined


def choose_vanishing(sizes: np.ndarray) -> np.ndarray:
    """Return which parts of an object may vanish where they are smaller than a pixel: the smallest ones, as many as have together
    `MAX_VANISHING_AREA` times the area of all.

    sizes: (N, 3), sides of their bounding boxes.
    """
    areas = (sizes * np.roll(sizes, 1, axis=1)).sum(axis=1)
    order = np.argsort(np.linalg.norm(sizes, axis=1), kind="stable")
    chosen = np.zeros(len(sizes), bool)
    chosen[order] = np.cumsum(areas[order]) <= MAX_VANISHING_AREA * areas.sum()
    return chosen


def is_light(candidates: Sequence[LevelCandidate], side: float, places: int) -> bool:
    """Return whether the levels of an object, the first of which is the original, have so few triangles at all its places that more
    levels or a billboard cloud do not pay.

    side: the longest one of the object, in the same unit as the pixel sizes.
    """
    shown = min(level.triangles for level in candidates if level.pixel_size <= side / SMALL_PIXELS)
    limit = MANY_TRIANGLES if shown <= LIGHT_FRACTION * candidates[0].triangles else FEW_TRIANGLES
    return places * shown <= limit
