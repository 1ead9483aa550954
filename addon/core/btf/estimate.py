"""What a bake will take, before it begins."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .settings import BtfSettings
from .texels import FINER

# Seconds of one core of 2020s server hardware, measured on a tree of alpha-mapped leaves; other originals differ by some factor, which the
# first bake tells. What is fitted, factored and refined is done by all cores; there were two.
RENDER = 0.008  # a render, however small
PIXEL, SAMPLE = 1.0e-6, 3.3e-6  # a pixel of it, and each sample of a pixel
NUMBERED_PIXEL = 14e-6  # a pixel of a view's picture of faces
SIGHTED_TEXEL = 4e-6  # a texel that looks itself up in a view
SHADOWED_TEXEL = 1.2e-6  # a texel that looks itself up from a sun, and whose edge of shadow is found
FITTED = 2e-8  # an entry of the matrix, whose lobes are fitted and taken out
FACTORED = 1e-9  # an entry and component of its factors
REFINED_TEXEL = 10e-6  # a texel in a photograph, in all steps
LOBES = 9  # numbers of a texel
START = 3.0  # a worker process


@dataclass(frozen=True)
class LevelExtent:
    """A level to be baked: its texels, and the pixels along a side of the pictures that hold all of it."""

    texels: int
    side: int


@dataclass(frozen=True)
class BakeEstimate:
    """renders: of Cycles, over all levels. seconds: wall time. raw_bytes, final_bytes: half floats before and after compression."""

    renders: int
    seconds: float
    raw_bytes: int
    final_bytes: int


def side_of(reach: float, pixel: float) -> int:
    """Pixels along a side of a picture that holds everything within `reach` of its middle, from every side, `pixel` (a length) a pixel."""
    return math.ceil(2.0 * reach / pixel) + 2


def estimate(levels: Sequence[LevelExtent], settings: BtfSettings, workers: int, pace: float = 1.0) -> BakeEstimate:
    """What baking `levels` takes with so many `workers` at a time, each on a core of its own.

    pace: how many times as long as this function says a bake before took.

    The time is the sum over renders, pictures of faces, look-ups and compression of numbers known before times constants measured once.
    """
    lights = settings.lights + 1
    captured = compressed = raw = final = 0.0
    for level in levels:
        pixels, entries = level.side**2, level.texels * settings.views * 3 * lights
        components = settings.components + settings.alpha_components
        view = lights * (RENDER + pixels * (PIXEL + SAMPLE * settings.samples)) + pixels * NUMBERED_PIXEL + level.texels * SIGHTED_TEXEL
        shadow = RENDER + pixels * NUMBERED_PIXEL / FINER**2 + level.texels * SHADOWED_TEXEL
        captured += settings.views * view + settings.shadows * shadow
        compressed += entries * (FITTED + FACTORED * components)
        if settings.refine:
            compressed += level.texels * settings.views * REFINED_TEXEL
        raw += 2 * entries
        tables = settings.views * (3 * lights * settings.components + settings.alpha_components)
        if settings.shadows:
            components += settings.shadow_components
            tables += settings.shadows * settings.shadow_components
        final += 2 * (level.texels * (3 + LOBES + components) + tables)
    seconds = pace * (START + captured / workers + compressed)
    return BakeEstimate(settings.views * lights * len(levels), seconds, int(raw), int(final))
