"""Texture synthesis in the hole of a window, from coarse to fine levels (Textures Revisited, section 5.4).

Every pixel of the hole becomes a copy of a source pixel. Candidates are the best matches of the neighborhood (Wei and Levoy, 2000) and the
continuations of the copies at its neighbors (Ashikhmin, 2001); which of both wins is decided as in Image Analogies (Hertzmann et al.,
2001). Then sweeps over the hole replace sources whose whole neighborhood fits worse than that of a neighbor's continuation.
"""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import distance_transform_cdt

from ..jobs.progress import Progress, Steps
from .levels import Level
from .neighborhoods import CAUSAL_STEPS, FULL_STEPS, SearchTrees, compare
from .settings import RestoreSettings

MATCHES = 2  # best matches that are compared per pixel
MIN_KNOWN = 10  # A causal kernel fits if so many of its 12 pixels are known.
CLASSES = 3  # per axis: pixels of one batch are this far apart, so that they do not ignore each other
COHERENCE_FALLOFF = 0.5  # factor of the preference for coherence, per coarser level
SWEEPS = 2  # per level
ADJACENT = np.array([step for step in FULL_STEPS if np.abs(step).max() == 1])


def synthesize(levels: list[Level], settings: RestoreSettings) -> Steps[None]:
    """Fill the holes of `levels`, from fine to coarse as `build_levels` returns them, in place."""
    pixels = [np.flatnonzero(level.hole) for level in levels]
    total, done = sum(len(each) for each in pixels), 0
    for index in range(len(levels) - 1, -1, -1):
        level, coarse = levels[index], levels[index + 1] if index + 1 < len(levels) else None
        if coarse is not None:
            _guess_from_coarse(level, coarse, pixels[index])
        trees = SearchTrees(levels, index, settings.seed)
        coherence = 1.0 + settings.coherence * COHERENCE_FALLOFF**index
        for batch, orientations in _schedule(level, pixels[index], settings.order):
            _fill_batch(level, coarse, trees, batch, orientations, coherence)
            done += len(batch)
            yield Progress(done / max(total, 1), "Synthesizing texture")
        for _ in range(SWEEPS):
            _sweep(level, coarse, pixels[index])


def _guess_from_coarse(level: Level, coarse: Level, pixels: np.ndarray) -> None:
    """Give the pixels of the hole the texture at the position in the source that their parent's source implies."""
    guess = _finer(level, coarse, pixels)
    is_valid = level.valid[guess]
    level.source[pixels[is_valid]] = guess[is_valid]
    level.texture[pixels[is_valid]] = level.texture[guess[is_valid]]


def _finer(level: Level, coarse: Level, pixels: np.ndarray) -> np.ndarray:
    """Return for each of `pixels` the pixel at the same place within the source of its parent."""
    y, x = np.divmod(pixels, level.shape[1])
    source_y, source_x = np.divmod(np.maximum(coarse.source[level.parents(pixels)], 0), coarse.shape[1])
    return (2 * source_y + y % 2) * level.shape[1] + 2 * source_x + x % 2


def _schedule(level: Level, pixels: np.ndarray, order: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield batches of pixels to fill, with the orientation of the kernel of each."""
    if order == "shrinking":
        yield from _schedule_rings(level, pixels)
        return
    y, x = np.divmod(pixels, level.shape[1])
    orientation = np.zeros(len(pixels), np.int64)
    if order == "scanline":
        keys = x + 3 * y  # the kernel of a pixel only reaches pixels with smaller keys: the result is that of one pixel after another
    else:
        mirrored = y % 2 == 1
        orientation[mirrored] = 4
        keys = y * level.shape[1] + np.where(mirrored, level.shape[1] - 1 - x, x)
    ranks = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[ranks], prepend=-1))
    for group in np.split(ranks, starts[1:]):
        yield pixels[group], orientation[group]


def _schedule_rings(level: Level, pixels: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield rings by Manhattan distance from the boundary, in classes of pixels that are CLASSES apart. Pixels that no kernel fits wait."""
    rings = distance_transform_cdt(~level.filled.reshape(level.shape), metric="taxicab").ravel()[pixels]
    classes = _classify(level, pixels)
    waiting = np.zeros(0, np.int64)
    for ring in range(1, int(rings.max(initial=0)) + 1):
        members = np.concatenate([waiting, np.flatnonzero(rings == ring)])
        waiting = yield from _fill_classes(level, pixels, classes, members, MIN_KNOWN)
    required = MIN_KNOWN
    while len(waiting):
        remaining = yield from _fill_classes(level, pixels, classes, waiting, required)
        required -= len(remaining) == len(waiting)
        waiting = remaining


def _fill_classes(level: Level, pixels: np.ndarray, classes: np.ndarray, members: np.ndarray, required: int):
    """Yield the batches of `members` (indices of `pixels`) that have a kernel with `required` known pixels; return the others."""
    waiting = []
    for number in range(CLASSES * CLASSES):
        batch = members[classes[members] == number]
        if not len(batch):
            continue
        known = _count_known(level, pixels[batch])
        fits = known.max(axis=1) >= required
        waiting.append(batch[~fits])
        if fits.any():
            yield pixels[batch[fits]], known[fits].argmax(axis=1)
    return np.concatenate(waiting) if waiting else members[:0]


def _classify(level: Level, pixels: np.ndarray) -> np.ndarray:
    """Return the class (P,) of each of `pixels`; those of one class are at least CLASSES apart along rows or columns."""
    y, x = np.divmod(pixels, level.shape[1])
    return (y % CLASSES) * CLASSES + x % CLASSES


def _count_known(level: Level, pixels: np.ndarray) -> np.ndarray:
    """Return the number of filled pixels in the causal kernel of `pixels` (P,) in each orientation (P, 8)."""
    neighbors, exists = level.neighbors(pixels, CAUSAL_STEPS.reshape(-1, 2))
    return (exists & level.filled[neighbors]).reshape(len(pixels), len(CAUSAL_STEPS), -1).sum(axis=2)


def _fill_batch(
    level: Level, coarse: Level | None, trees: SearchTrees, batch: np.ndarray, orientations: np.ndarray, coherence: float
) -> None:
    """Fill the pixels `batch` (B,), whose causal kernels have these `orientations` (B,)."""
    rows = np.arange(len(batch))
    continuations = np.concatenate([_continuations(level, batch), level.source[batch][:, None]], axis=1)
    distances = compare(level, coarse, batch, continuations)
    nearest = distances.argmin(axis=1)
    chosen, distance = continuations[rows, nearest], distances[rows, nearest]
    searched = np.flatnonzero(distance > trees.negligible)  # hardly any match is better than a nearly perfect continuation
    if len(searched):
        matches = trees.find(batch[searched], orientations[searched], MATCHES)
        distances = compare(level, coarse, batch[searched], matches)
        nearest = distances.argmin(axis=1)
        wins = distance[searched] > coherence * distances[np.arange(len(searched)), nearest]
        chosen[searched[wins]] = matches[np.flatnonzero(wins), nearest[wins]]
    _copy(level, batch, chosen)


def _continuations(level: Level, pixels: np.ndarray) -> np.ndarray:
    """Return the pixels (P, 8) that continue the copies at the eight neighbors of `pixels`, -1 where nothing was copied."""
    neighbors, exists = level.neighbors(pixels, ADJACENT)
    sources = level.source[neighbors]
    is_copy = exists & (sources >= 0) & level.filled[neighbors]
    return np.where(is_copy, sources - level.offset(ADJACENT), -1)


def _copy(level: Level, pixels: np.ndarray, sources: np.ndarray) -> None:
    level.copy(pixels, sources)
    level.filled[pixels] = True


def _sweep(level: Level, coarse: Level | None, pixels: np.ndarray) -> None:
    """Let every pixel of the hole take the best of its source and the continuations of its neighbors, compared by whole neighborhoods."""
    classes = _classify(level, pixels)
    for number in range(CLASSES * CLASSES):
        batch = pixels[classes == number]
        if len(batch):
            candidates = np.concatenate([level.source[batch][:, None], _continuations(level, batch)], axis=1)
            best = compare(level, coarse, batch, candidates).argmin(axis=1)
            _copy(level, batch, candidates[np.arange(len(batch)), best])
