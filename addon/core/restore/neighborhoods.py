"""Neighborhoods of pixels to fill and to copy: their comparison, causal kernels in eight orientations (Textures Revisited, Figure 14), and
search trees."""

import numpy as np
from scipy.spatial import cKDTree

from .levels import RADIUS, Level, square_steps

MIN_SAMPLES, MAX_SAMPLES = 12_000, 40_000  # neighborhoods per search tree: about as many as there are pixels to fill
MAX_DIMENSIONS = 16  # numbers that describe a neighborhood, by principal component analysis
TREE_EPS = 0.5  # an approximate match may be this much farther away than the nearest one
COARSE_WEIGHT = 1.5  # weight of the mean squared difference at the next coarser level, relative to the level itself
MIN_THREADED = 256  # searches at once that are worth starting threads
NEGLIGIBLE = 8e-3  # mean squared differences, relative to the variance of the texture
UPPER_WEIGHT = 0.1  # the same for each level above
MAX_ELEMENTS = 4_000_000  # compared at once, so that memory stays bounded
COARSE_STEPS = square_steps(1)
FULL_STEPS = np.array([step for step in square_steps(RADIUS) if step.any()])


def _orient(steps: np.ndarray) -> np.ndarray:
    """Return `steps` (K, 2) in all eight orientations (8, K, 2): four turns by a right angle, each also mirrored."""
    orientations = []
    for mirrored in (steps, steps * [1, -1]):
        for _ in range(4):
            orientations.append(mirrored)
            mirrored = np.stack([mirrored[:, 1], -mirrored[:, 0]], axis=1)
    return np.array(orientations)


CAUSAL_STEPS = _orient(np.array([step for step in square_steps(RADIUS) if step[0] < 0 or (step[0] == 0 and step[1] < 0)]))  # (8, 12, 2)


class SearchTrees:
    """Search trees over the valid neighborhoods of a level, one per orientation of the causal kernel, built when first used.

    A neighborhood holds the pixels of the causal kernel, 3 x 3 pixels one level above, and one pixel of each level above that. Every part
    is weighted by its number of pixels.
    """

    def __init__(self, levels: list[Level], index: int, seed: int) -> None:
        """Prepare the trees of `levels[index]`; raises no error if the level has no valid pixel, but cannot be searched then."""
        self._levels, self._index = levels, index
        count = min(max(int(levels[index].hole.sum()), MIN_SAMPLES), MAX_SAMPLES)
        self._samples = _sample(np.flatnonzero(levels[index].valid), count, np.random.default_rng([seed, index]))
        self.negligible = NEGLIGIBLE * float(levels[index].texture[self._samples].var(axis=0).sum())
        self._trees: dict[int, tuple[cKDTree, np.ndarray, np.ndarray]] = {}

    def find(self, pixels: np.ndarray, orientations: np.ndarray, count: int) -> np.ndarray:
        """Return the sources (P, K) with the most similar neighborhoods for `pixels` (P,) of the first page, best first, by kernels of the
        given `orientations` (P,)."""
        level = self._levels[self._index]
        count = min(count, len(self._samples))
        neighbors, _ = level.neighbors(pixels, CAUSAL_STEPS[orientations])
        features = self._features(pixels, neighbors, is_source=False)
        found = np.empty((len(pixels), count), np.int64)
        for orientation in np.unique(orientations):
            tree, mean, basis = self._tree(int(orientation))
            chosen = orientations == orientation
            workers = -1 if np.count_nonzero(chosen) > MIN_THREADED else 1
            found[chosen] = tree.query((features[chosen] - mean) @ basis, k=list(range(1, count + 1)), eps=TREE_EPS, workers=workers)[1]
        return self._samples[found]

    def _tree(self, orientation: int) -> tuple[cKDTree, np.ndarray, np.ndarray]:
        if orientation not in self._trees:
            level = self._levels[self._index]
            neighbors = self._samples[:, None] + level.offset(CAUSAL_STEPS[orientation])
            features = self._features(self._samples, neighbors, is_source=True)
            mean = features.mean(axis=0)
            features -= mean
            _, vectors = np.linalg.eigh(features.T @ features)
            basis = np.ascontiguousarray(vectors[:, ::-1][:, :MAX_DIMENSIONS])
            self._trees[orientation] = (cKDTree(features @ basis, balanced_tree=False, compact_nodes=False), mean, basis)
        return self._trees[orientation]

    def _features(self, pixels: np.ndarray, neighbors: np.ndarray, is_source: bool) -> np.ndarray:
        """Return the weighted neighborhoods (P, F) of `pixels` with these causal `neighbors` (P, 12)."""
        level = self._levels[self._index]
        parts = [(level.texture[neighbors], 1.0)]
        for levels_up, coarse in enumerate(self._levels[self._index + 1 :], start=1):
            above = level.parents(pixels, levels_up)
            if levels_up > 1:
                parts.append((coarse.texture[above][:, None], UPPER_WEIGHT))
            elif is_source:
                parts.append((coarse.texture[above[:, None] + coarse.offset(COARSE_STEPS)], COARSE_WEIGHT))
            else:
                parts.append((coarse.texture[coarse.neighbors(above, COARSE_STEPS)[0]], COARSE_WEIGHT))
        weighted = [(part * np.float32(np.sqrt(weight / part.shape[1]))).reshape(len(pixels), -1) for part, weight in parts]
        return np.concatenate(weighted, axis=1)


def _sample(pixels: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Return `count` of `pixels`, one at random of each of as many equal parts, or all if there are fewer."""
    if len(pixels) <= count:
        return pixels
    starts = np.linspace(0, len(pixels), count + 1)
    return pixels[np.minimum((starts[:-1] + generator.random(count) * np.diff(starts)).astype(np.int64), len(pixels) - 1)]


def compare(level: Level, coarse: Level | None, pixels: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Return the mean squared differences (P, K) between the neighborhoods of `pixels` (P,) and of their `candidates` (P, K).

    Only filled pixels of the 5 x 5 neighborhood count, and 3 x 3 pixels of `coarse`. Candidates that are negative or not valid get
    infinity.
    """
    channels = level.texture.shape[1]
    chunk = max(1, MAX_ELEMENTS // (candidates.shape[1] * len(FULL_STEPS) * channels))
    parts = [
        _compare(level, coarse, pixels[start : start + chunk], candidates[start : start + chunk]) for start in range(0, len(pixels), chunk)
    ]
    return np.concatenate(parts) if parts else np.zeros(candidates.shape, np.float32)


def _compare(level: Level, coarse: Level | None, pixels: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    is_valid = (candidates >= 0) & level.valid[candidates]
    sources = np.where(is_valid, candidates, np.argmax(level.valid))  # any valid pixel, for indexing
    neighbors, exists = level.neighbors(pixels, FULL_STEPS)
    weights = (exists & level.filled[neighbors]).astype(np.float32)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
    difference = level.texture[sources[:, :, None] + level.offset(FULL_STEPS)] - level.texture[neighbors][:, None]
    distance = np.einsum("pknc,pknc,pn->pk", difference, difference, weights)
    if coarse is not None:
        above = coarse.texture[coarse.neighbors(level.parents(pixels), COARSE_STEPS)[0]][:, None]
        difference = coarse.texture[level.parents(sources)[:, :, None] + coarse.offset(COARSE_STEPS)] - above
        distance += COARSE_WEIGHT / len(COARSE_STEPS) * np.einsum("pknc,pknc->pk", difference, difference)
    return np.where(is_valid, distance, np.inf)
