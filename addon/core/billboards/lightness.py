"""Levels that are worth having: each has clearly fewer triangles than the one before, and the finest fewer than its source."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from ..settings import describe
from .cloud import RECTANGLE, Level
from .settings import BillboardSettings

MAX_TRIANGLE_RATIO = 0.55  # Triangles of a level over those of the level before.
PROPOSAL_STEP = 2.0**0.5  # Factor between the errors of which one is proposed.
ERROR = next(item for item in describe(BillboardSettings) if item.name == "error")


def keep_lighter_levels(levels: Sequence[Level], longest_side: float) -> tuple[list[Level], list[str]]:
    """Return the levels with at most `MAX_TRIANGLE_RATIO` times the triangles of the kept level before, and a sentence for each other one.

    A level that is slightly too heavy is cut to simpler polygons.
    """
    kept, notes = [levels[0]], []
    for level in levels[1:]:
        count, before = level.triangle_count, kept[-1].triangle_count
        lighter = limit_triangles(level, int(MAX_TRIANGLE_RATIO * before))
        if lighter.triangle_count <= MAX_TRIANGLE_RATIO * before:
            kept.append(lighter)
            continue
        notes.append(
            f"The level with an error of {ERROR.format(level.error / longest_side)} is left out: it has {count:,} triangles, more than "
            f"{MAX_TRIANGLE_RATIO:g} times the {before:,} of the level before."
        )
    return kept, notes


def limit_triangles(level: Level, limit: int) -> Level:
    """Return `level` with at most `limit` triangles, if rectangles in place of polygons save enough, those with least area first."""
    excess = level.triangle_count - limit
    extra = np.array([max(len(cutout) - 4, 0) for cutout in level.cutouts])
    if not 0 < excess <= extra.sum():
        return level
    added = [(4.0 - _polygon_area(cutout)) * size.prod() for cutout, size in zip(level.cutouts, level.quads.half_sizes, strict=True)]
    order = np.argsort(np.where(extra > 0, np.array(added) / np.maximum(extra, 1), np.inf), kind="stable")
    cutouts = list(level.cutouts)
    for index in order[: int(np.searchsorted(np.cumsum(extra[order]), excess)) + 1]:
        cutouts[index] = RECTANGLE
    return replace(level, cutouts=cutouts)


def _polygon_area(polygon: np.ndarray) -> float:
    """Return the area of a `polygon` (C, 2), counter-clockwise."""
    following = np.roll(polygon, -1, axis=0)
    return 0.5 * float((polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]).sum())


def describe_weight(
    levels: Sequence[Level], longest_side: float, source_triangles: int, estimate: Callable[[float], float], name: str
) -> str:
    """Return a sentence for a cloud whose finest level has no fewer triangles than its source, with the error that would be lighter.

    estimate: triangles of a level with a given relative error.
    """
    count, error = levels[0].triangle_count, levels[0].error / longest_side
    lighter = [level.error / longest_side for level in levels if level.triangle_count < source_triangles]
    correction = count / max(estimate(error), 1.0)
    steps = int(math.log(max(ERROR.maximum / error, 1.0), PROPOSAL_STEP))
    candidates = [error * PROPOSAL_STEP ** (index + 1) for index in range(steps)]
    lighter += islice((candidate for candidate in candidates if correction * estimate(candidate) < source_triangles), 1)
    advice = f"an error of about {ERROR.format(float(f'{min(lighter):.2g}'))} would be" if lighter else "no error would make it"
    return f'The cloud of "{name}" has {count:,} triangles, its source {source_triangles:,}: {advice} lighter.'
