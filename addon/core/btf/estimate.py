"""Estimate of the time and memory of a bake."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .capture.observations import ID_BUFFER_SCALE
from .settings import BtfSettings

# Seconds on one core of 2020s server hardware, measured on a tree with alpha-mapped leaves. Other sources differ by some factor, which the
# first bake measures. Fitting, factorizing and refining use all cores; the constants are for two.
SECONDS_PER_RENDER = 0.008  # Independent of its size.
SECONDS_PER_PIXEL, SECONDS_PER_SAMPLE = 1.0e-6, 3.3e-6  # Per pixel of a render, and per sample of a pixel.
SECONDS_PER_ID_PIXEL = 14e-6  # Per pixel of a view, for its ID buffer.
SECONDS_PER_OBSERVED_TEXEL = 4e-6  # To look up one texel in one view.
SECONDS_PER_SHADOW_TEXEL = 1.2e-6  # To look up one texel from one light, and to find its shadow boundary.
SECONDS_PER_FITTED_ENTRY = 2e-8  # Per matrix entry, to fit and subtract the lobes.
SECONDS_PER_FACTOR_ENTRY = 1e-9  # Per matrix entry and component.
SECONDS_PER_REFINED_TEXEL = 10e-6  # Per texel and reference image, over all iterations.
LOBE_VALUES = 9  # Per texel.
WORKER_START_SECONDS = 3.0


@dataclass(frozen=True)
class LevelExtent:
    """Size of a level to bake: number of texels, and side length in pixels of a render that shows all of it."""

    texels: int
    resolution: int


@dataclass(frozen=True)
class BakeEstimate:
    """renders: number of Cycles renders over all levels. seconds: wall time. raw_bytes, final_bytes: as half floats, before and after
    compression."""

    renders: int
    seconds: float
    raw_bytes: int
    final_bytes: int


def image_resolution(radius: float, pixel_size: float) -> int:
    """Return the side length in pixels of a square image that contains a sphere of `radius` around its center; `pixel_size` is a length."""
    return math.ceil(2.0 * radius / pixel_size) + 2


def estimate_bake(levels: Sequence[LevelExtent], settings: BtfSettings, workers: int, pace: float = 1.0) -> BakeEstimate:
    """Estimate the cost of baking `levels` with that many simultaneous `workers`, each on its own core.

    pace: measured duration of an earlier bake, relative to its estimate.

    The time is a sum over renders, ID buffers, lookups and compression: known counts times constants that were measured once.
    """
    images_per_view = settings.images_per_view
    samples_per_view = settings.silhouette_samples + settings.normal_samples
    if settings.bakes_emission:
        samples_per_view = images_per_view * settings.samples
    capture_seconds = compress_seconds = raw_bytes = final_bytes = 0.0
    for level in levels:
        pixels, entries = level.resolution**2, level.texels * settings.view_count * 3 * images_per_view
        components = settings.alpha_components + (settings.components if settings.bakes_emission else 0)
        seconds_per_view = (
            images_per_view * (SECONDS_PER_RENDER + pixels * SECONDS_PER_PIXEL)
            + pixels * samples_per_view * SECONDS_PER_SAMPLE
            + pixels * SECONDS_PER_ID_PIXEL
            + level.texels * SECONDS_PER_OBSERVED_TEXEL
        )
        seconds_per_shadow = (
            SECONDS_PER_RENDER + pixels * SECONDS_PER_ID_PIXEL / ID_BUFFER_SCALE**2 + level.texels * SECONDS_PER_SHADOW_TEXEL
        )
        capture_seconds += settings.view_count * seconds_per_view + settings.shadow_count * seconds_per_shadow
        if settings.bakes_emission:
            compress_seconds += entries * (SECONDS_PER_FITTED_ENTRY + SECONDS_PER_FACTOR_ENTRY * components)
        if settings.refine:
            compress_seconds += level.texels * settings.view_count * SECONDS_PER_REFINED_TEXEL
        raw_bytes += 2 * entries
        table_values, texel_values = settings.view_count * settings.alpha_components, 0
        if settings.bakes_emission:
            table_values += settings.view_count * 3 * images_per_view * settings.components
            texel_values = 3 + LOBE_VALUES
        if settings.shadow_count:
            components += settings.shadow_components
            table_values += settings.shadow_count * settings.shadow_components
        final_bytes += 2 * (level.texels * (texel_values + components) + table_values)
    seconds = pace * (WORKER_START_SECONDS + capture_seconds / workers + compress_seconds)
    return BakeEstimate(settings.view_count * images_per_view * len(levels), seconds, int(raw_bytes), int(final_bytes))
