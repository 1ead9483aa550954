"""The choice of a shift for each pixel of a hole, so that seams between the regions with equal shifts show least.

Minimizes the sum of differences along seams, relative to the contrast of the texture there (Kwatra et al., "Graphcut Textures", 2003,
equation 4, with contrast in place of gradients), by expansion moves (Boykov, Veksler and Zabih, "Fast Approximate Energy Minimization via
Graph Cuts", 2001): first of blocks of pixels, then of pixels near the seams.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from ..imaging.graph_cuts import minimize_binary
from .guidance import Guide
from .levels import SIDES, Level

BOUNDARY_WEIGHT = 2.0  # weight of differences across the boundary of the hole
RESOLUTION = 2000.0  # integer capacity of the deviation of the texture
BLOCK = 4  # pixels per side
BLOCK_CYCLES = 2  # over all shifts
NEAR_SEAM = 3  # pixels
CONTRAST_SIZE = 5  # pixels
MIN_CONTRAST = 0.3  # added to contrasts, relative to their mean


def measure_contrast(level: Level) -> np.ndarray:
    """Return the contrast (H * W,) float32 of the texture around each pixel of `level`: the mean difference between neighbors, relative to
    that of all valid pixels. Seams in smooth parts would cost nothing without it, and draw all copies there."""
    texture = level.texture.reshape(*level.shape, -1)
    total = np.zeros(level.shape, np.float32)
    for first, second in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        differences = np.sqrt(np.square(texture[first] - texture[second]).sum(axis=2))
        total[first] += differences
        total[second] += differences
    smooth = uniform_filter(total, CONTRAST_SIZE).ravel()
    return (smooth / max(float(smooth[level.valid].mean()), 1e-9) + MIN_CONTRAST) / (1.0 + MIN_CONTRAST)


class Candidate(NamedTuple):
    """A shift: the pixels (M,) of the hole, as indices, that may use it, and the source (M,) of each."""

    members: np.ndarray
    sources: np.ndarray


class Labeling:
    """The sources of the pixels of one hole.

    sources: (P,) int64, the source of each pixel.
    """

    def __init__(self, level: Level, contrast: np.ndarray, guide: Guide | None, pixels: np.ndarray, candidates: list[Candidate]) -> None:
        """Start with the first candidate for each of the `pixels` (P,) of `level`; `contrast` (H * W,) is that of its texture. Without a
        guide, only seams cost."""
        self._level, self._contrast, self._guide, self._pixels, self._candidates = level, contrast, guide, pixels, candidates
        self.sources = np.full(len(pixels), -1)
        for members, targets in reversed(candidates):
            self.sources[members] = targets
        self._deviation = max(float(np.sqrt(level.texture[level.valid].var(axis=0).sum())), 1e-6)
        self._scale = RESOLUTION / self._deviation
        self._costs = self._guide_costs(guide, pixels, self.sources)
        numbers = np.full(level.hole.size, -1, np.int32)
        numbers[pixels] = np.arange(len(pixels))
        neighbors, exists = level.neighbors(pixels, SIDES)
        self._neighbors = np.where(exists, numbers[neighbors], np.int32(-1))  # (P, 4) indices of pixels
        self._known = np.where(exists & level.filled[neighbors], neighbors, -1).astype(np.int32)  # (P, 4) pixels of the level
        self._offsets = level.offset(SIDES)

    def optimize_blocks(self) -> None:
        """Choose sources for blocks of pixels."""
        y, x = np.divmod(self._pixels, self._level.shape[1])
        blocks = np.unique((y // BLOCK) * self._level.shape[1] + x // BLOCK, return_inverse=True)[1]
        sizes = np.bincount(blocks)
        for _ in range(BLOCK_CYCLES):
            for members, targets in self._candidates:
                complete = np.bincount(blocks[members], minlength=len(sizes)) == sizes
                kept = complete[blocks[members]]
                self._expand(members[kept], targets[kept], np.unique(blocks[members[kept]], return_inverse=True)[1])
            self._candidates = [each for each in self._candidates if (self.sources[each.members] == each.sources).any()]

    def optimize_seams(self) -> None:
        """Move the seams by single pixels."""
        near = self._near_seams()
        for members, targets in self._candidates:
            kept = near[members] & (self.sources[members] != targets)
            self._expand(members[kept], targets[kept], np.arange(np.count_nonzero(kept)))

    def cost(self, guide: Guide) -> float:
        """Return the sum that is minimized, with the costs of copies by `guide`."""
        total = float(self._guide_costs(guide, self._pixels, self.sources).sum())
        for side, offset in enumerate(self._offsets):
            known, other = self._known[:, side], self._neighbors[:, side]
            at = np.flatnonzero(known >= 0)
            total += BOUNDARY_WEIGHT * float(self._boundary(self.sources[at] + offset, known[at]).sum())
            if side < 2:  # The first two sides reach each pair of neighbors once.
                at = np.flatnonzero(other >= 0)
                total += float(self._seam(self.sources[at], self.sources[other[at]], offset).sum())
        return total

    def _near_seams(self) -> np.ndarray:
        """Return the pixels (P,) bool at most NEAR_SEAM away from a seam or the boundary of the hole."""
        others = self._neighbors
        is_seam = (others >= 0) & (self.sources[others] != self.sources[:, None] + self._offsets)
        near = (is_seam | (self._known >= 0)).any(axis=1)
        for _ in range(NEAR_SEAM):
            near |= ((others >= 0) & near[others]).any(axis=1)
        return near

    def _expand(self, members: np.ndarray, targets: np.ndarray, nodes: np.ndarray) -> None:
        """Give those of `members` (M,) their `targets` (M,) for which this lowers the sum most; those of one node (M,) change together."""
        if not len(members):
            return
        count = int(nodes.max()) + 1
        linear = np.zeros(count)
        place = np.full(len(self._pixels), -1)  # within members
        place[members] = np.arange(len(members))
        current, pairs = self.sources[members], []
        costs = self._guide_costs(self._guide, self._pixels[members], targets)
        linear += np.bincount(nodes, costs - self._costs[members], count)
        for side, offset in enumerate(self._offsets):
            known = self._known[members, side]
            at = np.flatnonzero(known >= 0)
            change = self._boundary(targets[at] + offset, known[at]) - self._boundary(current[at] + offset, known[at])
            linear += np.bincount(nodes[at], BOUNDARY_WEIGHT * change, count)
            other = self._neighbors[members, side]
            is_free = (other >= 0) & (place[other] >= 0)
            at = np.flatnonzero((other >= 0) & ~is_free)
            fixed = self.sources[other[at]]
            linear += np.bincount(nodes[at], self._seam(targets[at], fixed, offset) - self._seam(current[at], fixed, offset), count)
            if side < 2:  # The first two sides reach each pair of neighbors once.
                at = np.flatnonzero(is_free)
                to = place[other[at]]
                both_stay = self._seam(current[at], current[to], offset)
                first_stays, second_stays = self._seam(current[at], targets[to], offset), self._seam(targets[at], current[to], offset)
                linear += np.bincount(nodes[at], second_stays - both_stay, count) - np.bincount(nodes[to], second_stays, count)
                is_cut = nodes[at] != nodes[to]
                weights = np.maximum(first_stays + second_stays - both_stay, 0.0)
                pairs.append((nodes[at][is_cut], nodes[to][is_cut], self._scale * weights[is_cut]))
        changes = minimize_binary(self._scale * linear, *(np.concatenate(parts) for parts in zip(*pairs, strict=True)))[nodes]
        self.sources[members[changes]], self._costs[members[changes]] = targets[changes], costs[changes]

    def _guide_costs(self, guide: Guide | None, pixels: np.ndarray, sources: np.ndarray) -> np.ndarray:
        return np.zeros(len(pixels)) if guide is None else guide.costs(pixels, sources, self._deviation)

    def _boundary(self, first: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Return the cost (E,) of copies of `first` (E,) where `known` (E,) is."""
        return 2.0 * self._difference(first, known) / (self._contrast[first] + self._contrast[known])

    def _seam(self, first: np.ndarray, second: np.ndarray, offset: int) -> np.ndarray:
        """Return the cost (E,) of seams between copies of `first` and `second` (E,), the sources of neighbors `offset` apart."""
        difference = self._difference(first, second - offset) + self._difference(first + offset, second)
        return 2.0 * difference / (self._contrast[first] + self._contrast[second])

    def _difference(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        difference = self._level.texture[first] - self._level.texture[second]
        return np.sqrt(np.einsum("ec,ec->e", difference, difference))
