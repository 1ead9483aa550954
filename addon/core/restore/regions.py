"""Texture synthesis by copies of whole regions of the source, with seams where they show least.

Several attempts are made for each hole, some of them by copies alone. Those are kept whose patches are, all holes together, distributed
most like the patches around the holes, by sliced Wasserstein distances of random projections of the patches (Rabin et al., "Wasserstein
Barycenter and Its Application to Texture Mixing", 2011), computed from histograms, which can be added.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt

from ..jobs.progress import Progress, Steps
from .guidance import Guide
from .labeling import Candidate, Labeling, measure_contrast
from .levels import RADIUS, Level, square_steps
from .shifts import Surroundings, find_shifts

BAND = 64  # pixels from the boundary that are filled at once
DEEP = 1.5  # bands; holes that are not deeper are filled at once
MIN_ATTEMPTS, MAX_ATTEMPTS = 2, 6  # per hole
ALL_ATTEMPTS = 12  # for all holes together, if MIN_ATTEMPTS allows it
NEARBY, MIN_NEARBY = 0.5, 16  # distance of the patches to resemble, relative to the root of the hole's area, and in pixels
MAX_FREE_COST = 1.3  # Cost of copies alone by the guide, relative to the lowest with fills. Objects are above 1.4.
ROUNDS = 3  # in which attempts are chosen, one hole after the other
PROJECTIONS, BINS = 32, 96  # random directions in which patches are compared, and bins of their histograms
MAX_PATCHES = 20_000


class PatchStatistics:
    """Histograms of random projections of the 5 x 5 patches of a level, within the range of its valid patches."""

    def __init__(self, level: Level, generator: np.random.Generator) -> None:
        """Choose the projections; `level` must have a valid pixel."""
        self._level = level
        vectors = generator.standard_normal(((2 * RADIUS + 1) ** 2 * level.texture.shape[1], PROJECTIONS), np.float32)
        self._vectors = vectors / np.linalg.norm(vectors, axis=0)
        values = self._project(np.flatnonzero(level.valid), generator)
        self._lowest = values.min(axis=0)
        self._width = np.maximum((values.max(axis=0) - self._lowest) / BINS, 1e-9)

    def histograms(self, pixels: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Return the fractions (PROJECTIONS, BINS) of the patches around `pixels` (P,), or around a random sample of them."""
        if not len(pixels):
            return np.zeros((PROJECTIONS, BINS))
        values = self._project(pixels, generator)
        bins = np.clip((values - self._lowest) / self._width, 0, BINS - 1).astype(np.int64) + BINS * np.arange(PROJECTIONS)
        return np.bincount(bins.ravel(), minlength=PROJECTIONS * BINS).reshape(PROJECTIONS, BINS) / len(values)

    def distance(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the mean first Wasserstein distance between histograms (PROJECTIONS, BINS), times their sums, which must be equal."""
        return float((np.abs(np.cumsum(first - second, axis=1)).sum(axis=1) * self._width).mean())

    def _project(self, pixels: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        if len(pixels) > MAX_PATCHES:
            pixels = generator.choice(pixels, MAX_PATCHES, replace=False)
        neighbors, _ = self._level.neighbors(pixels, square_steps(RADIUS))
        return self._level.texture[neighbors].reshape(len(pixels), -1) @ self._vectors


class _Choice(NamedTuple):
    """The attempts for the pixels (P,) of one page, and the histograms of the patches of each, times P."""

    pixels: np.ndarray
    attempts: list[Labeling]
    histograms: list[np.ndarray]


def copy_regions(level: Level, guide: Guide, seed: int) -> Steps[None]:
    """Fill the holes of `level` in place, band by band, as far as shifts reach a source."""
    total = np.count_nonzero(level.hole)
    done, before = 0, -1
    while before < done < total:
        before = done
        yield from _fill_bands(level, guide, np.random.default_rng([seed, done]), done, total)
        done = np.count_nonzero(level.hole & level.filled)


def _fill_bands(level: Level, guide: Guide, generator: np.random.Generator, done: int, total: int) -> Steps[None]:
    """Fill the next band of each hole. `done` of `total` pixels are filled already."""
    statistics, contrast = PatchStatistics(level, generator), measure_contrast(level)
    pages = [page for page in range(len(level.tops)) if (level.hole & ~level.filled)[level.pixels(page)].any()]
    attempt_count = int(np.clip(round(ALL_ATTEMPTS / len(pages)), MIN_ATTEMPTS, MAX_ATTEMPTS))
    choices: list[_Choice] = []
    target = np.zeros(())
    for page in pages:
        fills = guide.fills[page]
        if guide.are_shallow[page]:
            inside = level.pixels(page)
            pixels, candidates, fills = inside[level.hole[inside]], [[]], fills[-1:]
        else:
            pixels, candidates = _find_candidates(level, page, attempt_count, generator)
        if not len(pixels):
            continue
        choice = _Choice(pixels, [], [])
        added = [Candidate(np.arange(len(pixels)), (pixels + offset).astype(np.int32)) for offset in fills]
        for labeling in make_attempts(level, contrast, guide, pixels, candidates, added):
            level.copy(pixels, labeling.sources)
            choice.attempts.append(labeling)
            choice.histograms.append(len(pixels) * statistics.histograms(pixels, generator))
            done += len(pixels) / len(candidates)
            yield Progress(min(done / total, 1.0), "Copying texture")
        target = target + len(pixels) * statistics.histograms(_find_nearby(level, page, pixels), generator)
        choices.append(choice)
    for choice, number in zip(choices, _choose([choice.histograms for choice in choices], target, statistics), strict=True):
        choice.attempts[number].optimize_seams()
        level.copy(choice.pixels, choice.attempts[number].sources)
    for choice in choices:
        level.filled[choice.pixels] = True


def make_attempts(
    level: Level, contrast: np.ndarray, guide: Guide, pixels: np.ndarray, candidates: list[list[Candidate]], fills: list[Candidate]
) -> Iterator[Labeling]:
    """Yield a labeling of the `pixels` (P,) of one page for each list of `candidates`; `contrast` (H * W,) is that of the texture.

    Texture needs neither guide nor fills, so every other attempt is free of them, until a free one costs too much by the guide.
    """
    lowest, may_be_free = np.inf, True
    for number, copies in enumerate(candidates):
        if copies and number % 2 and may_be_free:
            labeling = Labeling(level, contrast, None, pixels, copies)
            labeling.optimize_blocks()
            may_be_free = labeling.cost(guide) <= MAX_FREE_COST * lowest
            if may_be_free:
                yield labeling
                continue
        labeling = Labeling(level, contrast, guide, pixels, copies + fills)
        labeling.optimize_blocks()
        lowest = min(lowest, labeling.cost(guide))
        yield labeling


def _find_nearby(level: Level, page: int, pixels: np.ndarray) -> np.ndarray:
    """Return the pixels of a page that may be copied and are near `pixels` (P,), whose texture they shall resemble."""
    all_pixels = level.pixels(page)
    is_far = ~np.isin(all_pixels, pixels).reshape(level.sizes[page])
    reach = max(MIN_NEARBY, NEARBY * np.sqrt(len(pixels)))
    nearby = all_pixels[(distance_transform_edt(is_far) <= reach).ravel() & level.valid[all_pixels]]
    return nearby if len(nearby) >= len(pixels) else all_pixels[level.valid[all_pixels]]


def _find_candidates(
    level: Level, page: int, attempt_count: int, generator: np.random.Generator
) -> tuple[np.ndarray, list[list[Candidate]]]:
    """Return the pixels (P,) of the next band of a page that have a source in every attempt, and the candidates of each attempt."""
    window = _surroundings(level, page)
    rows, columns = np.nonzero(window.hole)
    pixels = (rows + level.tops[page]) * level.shape[1] + columns
    numbers = np.full(window.hole.shape, -1, np.int32)
    numbers[rows, columns] = np.arange(len(pixels))
    has_source, attempts = np.ones(len(pixels), bool), []
    for shifts in find_shifts(window, attempt_count, generator):
        is_covered, candidates = np.zeros(len(pixels), bool), []
        for step, area in shifts:
            members = numbers[area.index]
            members = members[members >= 0]
            sources, exists = (values[:, 0] for values in level.neighbors(pixels[members], np.array([step])))
            usable = exists & level.valid[sources]
            candidates.append(Candidate(members[usable], sources[usable].astype(np.int32)))
            is_covered[members[usable]] = True
        attempts.append(candidates)
        has_source &= is_covered
    remaining = np.cumsum(has_source, dtype=np.int32) - 1
    for candidates in attempts:
        for index, (members, sources) in enumerate(candidates):
            kept = has_source[members]
            candidates[index] = Candidate(remaining[members[kept]], sources[kept])
    return pixels[has_source], attempts


def _surroundings(level: Level, page: int) -> Surroundings:
    """Return the next band of the hole of a page and what surrounds it."""
    pixels, size = level.pixels(page), level.sizes[page]
    hole, filled, valid = (values[pixels].reshape(size) for values in (level.hole & ~level.filled, level.filled, level.valid))
    depth = distance_transform_edt(~filled)
    if depth[hole].max() > DEEP * BAND:
        hole &= depth <= BAND
    return Surroundings(level.page(page), hole, filled, valid, tuple(level.wraps[page]))


def _choose(found: list[list[np.ndarray]], target: np.ndarray, statistics: PatchStatistics) -> list[int]:
    """Return which attempt to use for each hole, given the histograms of all attempts, so that their sum is near the `target`."""
    chosen = [0] * len(found)
    for index, histograms in enumerate(found):
        chosen[index] = int(np.argmin([statistics.distance(each / each[0].sum(), target / target[0].sum()) for each in histograms]))
    total = sum(histograms[number] for histograms, number in zip(found, chosen, strict=True))
    for _ in range(ROUNDS):
        for index, histograms in enumerate(found):
            others = total - histograms[chosen[index]]
            chosen[index] = int(np.argmin([statistics.distance(others + each, target) for each in histograms]))
            total = others + histograms[chosen[index]]
    return chosen
