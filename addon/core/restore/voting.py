"""Completion of an image by overlapping patches, from coarse to fine: patches over the hole are matched with known ones, and each pixel
takes the mean of the matches that cover it.

After Wexler, Shechtman and Irani, "Space-Time Completion of Video", 2007, with the search of Barnes et al., "PatchMatch: A Randomized
Correspondence Algorithm for Structural Image Editing", 2009, in all patches at once.
"""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from ..imaging.pyramids import reduce_image, reduce_weighted
from ..jobs.chunks import slices
from ..jobs.progress import Progress, Steps, subprogress
from .levels import RADIUS, Page, square_steps

DIMENSIONS = 24  # numbers that describe a patch, by principal component analysis
SAMPLES = 4_000  # patches for the analysis
CHUNK = 20_000  # patches that are described at once
COARSEST_DEPTH = 4.0  # pixels of the hole at the coarsest level
MIN_SIDE = 24  # pixels of the coarsest level
COARSEST_ROUNDS, ROUNDS = 12, 3  # searches and votes of the coarsest level, half as many of each finer one, and of the finest
SEARCHES = 3  # per round
JUMPS = 4, 2, 1  # pixels between patches that try the continuation of each other's matches
CONFIDENCE = 1.3  # weight of a patch, relative to one a pixel deeper in the hole
PERCENTILE, MIN_DEVIATION = 75.0, 0.02  # Matches with this rank of the differences between patches have the weight exp(-0.5).
MIN_KNOWN = 0.5  # weight of the known pixels that make one of the next coarser level known
MIN_WEIGHT = 1e-9
PADDING = 32  # pixels beyond borders that are neighbors of the opposite ones


class Layer(NamedTuple):
    """A level of the pyramid: image (H, W, C) float32, hole and usable (H, W) bool."""

    image: np.ndarray
    hole: np.ndarray
    usable: np.ndarray


def complete(image: np.ndarray, page: Page, seed: int) -> Steps[np.ndarray]:
    """Return `image` (H, W, C) float32, in whose missing pixels is a first estimate, with the hole of `page` completed from usable pixels.

    Pixels next to the hole change, too: they are what patches make of them, so that differences between neighbors continue. Where no patch
    reaches, the estimate stays.
    """
    padding = [(PADDING if wraps else 0,) * 2 for wraps in page.wrap]
    hole, known, usable = (np.pad(values, padding, mode="wrap") for values in (page.hole, page.known, page.usable))
    layers = [Layer(np.pad(image, [*padding, (0, 0)], mode="wrap"), hole, usable)]
    while distance_transform_edt(layers[-1].hole).max() > COARSEST_DEPTH and min(layers[-1].hole.shape) >= 2 * MIN_SIDE:
        coarse, weight = reduce_weighted(layers[-1].image, known.astype(np.float32))
        known = weight >= MIN_KNOWN
        coarse = np.where(known[..., None], coarse, reduce_image(layers[-1].image))
        layers.append(Layer(coarse, ~known, known & (reduce_image(layers[-1].usable.astype(np.float32)) >= MIN_KNOWN)))
    generator, matches = np.random.default_rng(seed), None
    for number, layer in enumerate(reversed(layers)):
        rounds, left = max(ROUNDS, COARSEST_ROUNDS >> number), 0.25 ** (len(layers) - 1 - number)  # Each layer has four times the pixels.
        steps = _complete_layer(layer, matches, rounds, generator)
        completed, matches = yield from subprogress(steps, 0.25 * left if number else 0.0, left)
    inner = tuple(slice(before, side - after) for (before, after), side in zip(padding, completed.shape, strict=False))
    return completed[inner]


def _complete_layer(
    layer: Layer, coarse: np.ndarray | None, rounds: int, generator: np.random.Generator
) -> Steps[tuple[np.ndarray, np.ndarray]]:
    """Return the completed image (H, W, C) and the matches (H, W) of its patches, from those of the next coarser level."""
    height, width = layer.hole.shape
    image, side = layer.image.copy(), 2 * RADIUS + 1
    is_source, is_target = minimum_filter(layer.usable & ~layer.hole, side, mode="constant"), np.zeros_like(layer.hole)
    inner = np.s_[RADIUS : height - RADIUS, RADIUS : width - RADIUS]
    is_target[inner] = maximum_filter(layer.hole, side, mode="constant")[inner]
    matches = np.full(layer.hole.shape, -1)
    if not is_source.any() or not is_target.any():
        return image, matches
    patches = _Patches(image, is_source, np.flatnonzero(is_target), generator)
    if coarse is not None:
        patches.start(coarse)
    depth = distance_transform_edt(layer.hole)[is_target]
    for number in range(rounds):
        yield Progress(number / rounds, "Completing objects")
        patches.describe_targets()
        if number or coarse is None:  # Coarse matches vote first: the image has no details yet.
            for _ in range(SEARCHES):
                patches.propagate()
                patches.try_random()
        voted = patches.vote(CONFIDENCE**-depth)
        image[layer.hole] = voted[layer.hole]
    matches[is_target] = patches.matches
    return voted, matches


class _Patches:
    """The patches of an `image` (H, W, C), which voting changes, at flat `targets` (P,), and their matches.

    Attributes:
        matches: (P,) flat centers of patches.
    """

    def __init__(self, image: np.ndarray, is_source: np.ndarray, targets: np.ndarray, generator: np.random.Generator) -> None:
        self._image, self._is_source, self._targets, self._generator = image, is_source.ravel(), targets, generator
        self._shape = is_source.shape
        self._sources = np.flatnonzero(is_source)
        sample = self._read(generator.choice(self._sources, min(SAMPLES, len(self._sources)), replace=False))
        sample -= sample.mean(axis=0)
        self._basis = np.ascontiguousarray(np.linalg.eigh(sample.T @ sample)[1][:, ::-1][:, :DIMENSIONS])
        self._features = np.zeros((image[..., 0].size, self._basis.shape[1]), np.float32)
        for part in slices(len(self._sources), CHUNK):
            self._features[self._sources[part]] = self._read(self._sources[part]) @ self._basis
        self._numbers = np.full(len(self._features), -1)
        self._numbers[targets] = np.arange(len(targets))
        self._rows, self._columns = np.divmod(targets, self._shape[1])
        self.matches = generator.choice(self._sources, len(targets))
        self._wanted = np.zeros((len(targets), self._basis.shape[1]), np.float32)
        self._costs = np.zeros(len(targets), np.float32)

    def start(self, coarse: np.ndarray) -> None:
        """Take the matches of a level of half the size, where they lead to a source."""
        given = coarse[np.minimum(self._rows // 2, coarse.shape[0] - 1), np.minimum(self._columns // 2, coarse.shape[1] - 1)]
        rows, columns = np.divmod(given, coarse.shape[1])
        at, sources = self._within(np.flatnonzero(given >= 0), 2 * rows + self._rows % 2, 2 * columns + self._columns % 2)
        self.matches[at] = sources

    def describe_targets(self) -> None:
        """Describe the patches as they are in the image now."""
        for part in slices(len(self._targets), CHUNK):
            self._wanted[part] = self._read(self._targets[part]) @ self._basis
        self._costs = np.square(self._wanted - self._features[self.matches]).sum(axis=1)

    def propagate(self) -> None:
        """Try the continuation of the matches of patches nearby."""
        for jump in JUMPS:
            for step in ((jump, 0), (-jump, 0), (0, jump), (0, -jump)):
                rows, columns = self._rows + step[0], self._columns + step[1]
                at = np.flatnonzero(self._exist(rows, columns))
                others = self._numbers[rows[at] * self._shape[1] + columns[at]]
                at, others = at[others >= 0], others[others >= 0]
                rows[at], columns[at] = np.divmod(self.matches[others], self._shape[1])
                self._try(*self._within(at, rows - step[0], columns - step[1]))

    def try_random(self) -> None:
        """Try patches at random around the matches, nearer and nearer."""
        reach = max(self._shape)
        while reach:
            rows, columns = np.divmod(self.matches, self._shape[1])
            jitter = self._generator.integers(-reach, reach + 1, (2, len(rows)))
            self._try(*self._within(np.arange(len(rows)), rows + jitter[0], columns + jitter[1]))
            reach //= 2

    def vote(self, confidence: np.ndarray) -> np.ndarray:
        """Return the image (H, W, C) with means of the matches where targets reach, weighted by their similarity and `confidence` (P,)."""
        variance = max(float(np.percentile(self._costs, PERCENTILE)), MIN_DEVIATION**2)
        weights = confidence * np.exp(-0.5 * self._costs / variance) + MIN_WEIGHT
        flat = self._image.reshape(-1, self._image.shape[2])
        sums = np.zeros((len(flat), flat.shape[1] + 1))
        for row, column in square_steps(RADIUS):
            offset = row * self._shape[1] + column
            values = np.pad(flat[self.matches + offset], ((0, 0), (0, 1)), constant_values=1.0)
            sums[self._targets + offset] += weights[:, None] * values
        reached = sums[:, -1] > 0.0
        voted = flat.copy()
        voted[reached] = sums[reached, :-1] / sums[reached, -1:]
        return voted.reshape(self._image.shape)

    def _read(self, centers: np.ndarray) -> np.ndarray:
        """Return the patches (N, K) float32 around flat `centers` (N,)."""
        rows, columns = np.divmod(centers, self._shape[1])
        windows = sliding_window_view(self._image, (2 * RADIUS + 1, 2 * RADIUS + 1), axis=(0, 1))
        return windows[rows - RADIUS, columns - RADIUS].reshape(len(centers), -1)

    def _within(self, at: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return those of the indices `at` (N,) whose `rows` and `columns` (P,) are a source, and these sources, flat."""
        rows, columns = rows[at], columns[at]
        exists = self._exist(rows, columns)
        at, sources = at[exists], (rows * self._shape[1] + columns)[exists]
        is_source = self._is_source[sources]
        return at[is_source], sources[is_source]

    def _exist(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return whether pixels at `rows` and `columns` (N,) are in the image."""
        return (rows >= 0) & (rows < self._shape[0]) & (columns >= 0) & (columns < self._shape[1])

    def _try(self, at: np.ndarray, sources: np.ndarray) -> None:
        """Take those of the `sources` (N,) that are more similar to the patches `at` (N,) than their matches."""
        costs = np.square(self._wanted[at] - self._features[sources]).sum(axis=1)
        is_better = costs < self._costs[at]
        self.matches[at[is_better]], self._costs[at[is_better]] = sources[is_better], costs[is_better]
