"""Cuts through the quadtree of texture tiles for a viewer (BDAM, section 4), of a limited number of tiles.

Each tile has the number of pixels that its texels cover where the viewer is nearest to it, and is refined if that exceeds the tolerance.
The number is raised to those of the tiles that `textures.tile_index` names, so that every threshold gives a valid cut; the one that gives
few enough tiles is found by sorting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.viewers import Viewer
from ...jobs.progress import Progress, Steps
from ..store.patch_links import PatchLimits
from ..store.terrain_store import TerrainStore
from .extraction import CutSettings, IsForced
from .projected_errors import Culling
from .tile_maps import StoreMaps


@dataclass(frozen=True)
class TextureCut:
    """Squares of the quadtree that cover the terrain once.

    Attributes:
        numbers: those of squares with maps, see `tile_maps`, by (level, i, j); None where there is no map.
        refined: for each level from 0, the squares (M, 2) int32 that are refined.
        tolerance: the largest number of pixels that texels cover, unless they are the finest ones; None without a choice.
    """

    numbers: dict[tuple[int, int, int], int | None]
    refined: tuple[np.ndarray, ...] = ()
    tolerance: float | None = None


NO_TEXTURES = TextureCut({(0, 0, 0): None})


class TextureSelector:
    """Chooses the squares of the maps of one store, if it has any."""

    def __init__(self, store: TerrainStore, maps: StoreMaps) -> None:
        self._store = store
        self._has_maps = bool(maps.stores)
        if not self._has_maps:
            return
        self._index, self._errors = maps.index, maps.errors
        self._depth = store.tree.depth
        self._min_distance = store.header.cell_size
        self._low, self._high = np.empty((len(self._index), 3)), np.empty((len(self._index), 3))
        for level in range(self._index.level_count):
            numbers = self._index.numbers(level)
            self._low[numbers], self._high[numbers] = square_boxes(store, level, self._index.tiles[numbers])
        self._squares = [self._find_squares(level) for level in range(self._index.level_count)]
        self._added = self._count_added()

    def choose(self, viewer: Viewer, settings: CutSettings, max_count: int) -> TextureCut:
        """Return the cut for a viewer in the local frame, with at most `max_count` tiles, whose texels cover at most `settings.tolerance`
        pixels as far as that number allows."""
        if not self._has_maps:
            return NO_TEXTURES
        return self._choose(self._measure(viewer, settings), settings, max_count)

    def choose_for_path(self, viewers: Sequence[Viewer], settings: CutSettings, max_count: int) -> Steps[TextureCut]:
        """Return the cut for all of `viewers`, at least one, as `choose` does for one.

        If `max_count` tiles are too few, the tiles that cover the fewest pixels, in the frame where they cover most, stay coarse.
        """
        if not self._has_maps:
            return NO_TEXTURES
        pixels = np.zeros(len(self._index))
        for number, viewer in enumerate(viewers):
            yield Progress(number / len(viewers), "Choosing textures")
            np.maximum(pixels, self._measure(viewer, settings), out=pixels)
        return self._choose(pixels, settings, max_count)

    def _choose(self, pixels: np.ndarray, settings: CutSettings, max_count: int) -> TextureCut:
        """Return the cut for tiles that cover `pixels` (N,)."""
        pixels = self._nest(pixels)
        threshold = max(settings.tolerance, self._find_threshold(pixels, max_count))
        return replace(self._cut_below(pixels > threshold), tolerance=threshold)

    def _cut_below(self, is_refined: np.ndarray) -> TextureCut:
        """Return the cut below the tiles (N,) bool that are refined, with their ancestors and relatives."""
        numbers: dict[tuple[int, int, int], int | None] = {}
        refined = []
        for number in self._index.select_cut(is_refined).tolist():
            numbers[int(self._index.levels[number]), *self._index.tiles[number].tolist()] = number
        for level in range(self._index.level_count - 1):
            tiles = self._index.tiles[self._index.numbers(level)][is_refined[self._index.numbers(level)]]
            refined.append(tiles)
            children = _children(tiles)
            is_unknown = (self._index.find(level + 1, children) < 0) & contains_squares(children, self._squares[level + 1])
            numbers.update({(level + 1, i, j): None for i, j in children[is_unknown].tolist()})
        return TextureCut(numbers, tuple(refined))

    def is_forced(self, cut: TextureCut) -> IsForced | None:
        """Return the criterion that patches must be refined until each one lies within one square of the cut, None if all of them do."""
        if not cut.refined:
            return None

        def test(level: int, rows: np.ndarray) -> np.ndarray:
            square_level = level // 2
            if square_level >= len(cut.refined) or not len(cut.refined[square_level]):
                return np.zeros(len(rows), bool)
            return contains_squares(self._store.leaf_squares[level][rows] >> (self._depth - square_level), cut.refined[square_level])

        return test

    def _find_squares(self, level: int) -> np.ndarray:
        """Return the squares (M, 2) of a level that contain terrain."""
        return np.unique(self._store.leaf_squares[2 * level] >> (self._depth - level), axis=0)

    def _count_added(self) -> np.ndarray:
        """Return by how many squares a cut grows when each tile is refined, (N,) int64."""
        added = np.zeros(len(self._index), np.int64)
        for level in range(self._index.level_count - 1):
            numbers = self._index.numbers(level)
            exists = contains_squares(_children(self._index.tiles[numbers]), self._squares[level + 1])
            added[numbers] = exists.reshape(-1, 4).sum(axis=1) - 1
        return added

    def _measure(self, viewer: Viewer, settings: CutSettings) -> np.ndarray:
        """Return the pixels (N,) that the error of each tile covers; 0 for tiles that are culled or at the finest level."""
        scale = np.array([1.0, 1.0, settings.exaggeration])
        low, high = self._low * scale, self._high * scale
        offsets = np.maximum(np.maximum(low - viewer.position, viewer.position - high), 0.0)
        distances = np.maximum(np.sqrt((offsets * offsets).sum(axis=1)), self._min_distance)
        pixels = self._errors * viewer.pixels_per_unit_at(distances)
        if settings.culls:
            culling = Culling(viewer, settings.margin, settings.exaggeration)
            pixels[~culling.are_visible(np.vstack([self._low.T, self._high.T]))] = 0.0
        pixels[(self._index.levels == self._index.level_count - 1) | (high[:, 0] < low[:, 0])] = 0.0
        return pixels

    def _nest(self, pixels: np.ndarray) -> np.ndarray:
        """Return the nested pixels (N,). Those of tiles that cannot be refined, because patches are damaged, become 0."""
        pixels = self._index.nest(pixels)
        if self._store.limits is not None:
            pixels[self._find_blocked(self._store.limits)] = 0.0
        return pixels

    def _find_blocked(self, limits: PatchLimits) -> np.ndarray:
        """Return which tiles cannot be refined, (N,) bool: those around patches that cannot, since a patch needs one texture; and what may
        only be refined together with these."""
        is_blocked = np.zeros(len(self._index), bool)
        for level, relatives in enumerate(self._index.relatives):
            for patch_level in (2 * level, 2 * level + 1):
                start, stop = (int(number) for number in self._store.links.starts[patch_level : patch_level + 2])
                rows = np.flatnonzero(limits.is_blocked[start:stop])
                found = self._index.find(level, self._store.leaf_squares[patch_level][rows] >> (self._depth - level))
                is_blocked[found[found >= 0]] = True
            below = relatives[is_blocked[self._index.numbers(level)]]
            is_blocked[below[below >= 0]] = True
        return is_blocked

    def _find_threshold(self, pixels: np.ndarray, max_count: int) -> float:
        """Return the smallest of the `pixels` (N,) such that refining all tiles above it gives at most `max_count` tiles."""
        order = np.argsort(-pixels, kind="stable")
        counts = 1 + np.cumsum(self._added[order])
        is_too_many = (counts > max_count) & (pixels[order] > 0.0)
        return float(pixels[order][np.argmax(is_too_many)]) if is_too_many.any() else 0.0


def _children(squares: np.ndarray) -> np.ndarray:
    """Return the four children (4 N, 2) of each of `squares` (N, 2)."""
    return (2 * squares[:, None] + np.array([(0, 0), (1, 0), (0, 1), (1, 1)])).reshape(-1, 2)


def square_boxes(store: TerrainStore, level: int, squares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounding boxes, low and high (M, 3) float64 in local meters, of the terrain in `squares` (M, 2) of a level of the
    quadtree; low is infinite and high minus infinity where there is no terrain."""
    patches = store.levels[2 * level]
    keys = _keys(store.leaf_squares[2 * level] >> (store.tree.depth - level))
    wanted = _keys(squares)
    order = np.argsort(wanted, kind="stable")
    places = np.searchsorted(wanted[order], keys)
    is_wanted = places < len(wanted)
    is_wanted[is_wanted] = wanted[order][places[is_wanted]] == keys[is_wanted]
    targets = order[places[is_wanted]]
    low, high = np.full((len(squares), 3), np.inf), np.full((len(squares), 3), -np.inf)
    np.minimum.at(low, targets, patches.low[is_wanted])
    np.maximum.at(high, targets, patches.high[is_wanted])
    return low, high


def contains_squares(squares: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return which of `squares` (N, 2) int are among `others` (M, 2), (N,) bool."""
    return np.isin(_keys(squares), _keys(others))


def _keys(squares: np.ndarray) -> np.ndarray:
    """Return a number (N,) int64 for each square of one level."""
    return (squares[:, 1].astype(np.int64) << 32) | squares[:, 0]
