"""The part of a large terrain that a viewer needs, tile by tile: what changes from one position of the viewer to the next."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue

import numpy as np

from ...errors import FarfieldError
from ...geometry.viewer_motion import ViewerMotion
from ...geometry.viewers import Viewer
from ...jobs.progress import Progress, Steps
from ..settings import ViewSettings
from ..store.structure import find_structure
from ..store.terrain_store import TerrainStore
from .caches import PatchCache, Prefetch, TextureFiles
from .extraction import Cut, CutSettings, IsForced, extract_cut
from .texture_cuts import TextureCut, TextureSelector
from .tile_maps import KINDS, ShownMaps, StoreMaps
from .tiles import MAX_TILES, Tile, TileGrouping, TileKey, TileMesh, build_tile_mesh

# The cut stays as it is until the viewer has moved by this fraction of the distance to the terrain, or of the image.
SETTLED_FRACTION = 0.02
CULLING_MARGIN = 0.15  # fraction of the image
# A triangle budget chooses from a series of tolerances, up to the errors of a mountain at `MIN_DEPTH`.
STEPS_PER_OCTAVE, MAX_OCTAVES = 8, 44
MIN_TEXTURE_TILES = 4
READ_PATCHES = 48  # are decoded together, which takes less time than one after the other
PREFETCH_SECONDS, PREFETCH_CUTS = 0.5, 4  # how far and how often it is predicted what a moving viewer needs


@dataclass(frozen=True)
class TileBlock:
    """A tile to be shown. maps: the number of its square and the maps in it, None without."""

    mesh: TileMesh
    maps: tuple[int, ShownMaps] | None


@dataclass(frozen=True)
class Figures:
    """Figures of what is shown.

    Attributes:
        triangles, patches, tiles: numbers of what is shown.
        tolerance: pixels, raised by a triangle budget.
        max_error: pixels.
        byte_count: bytes of patches and textures that the engine keeps in memory.
        raising_budget: the triangle budget that raised the tolerance, 0 if none did.
    """

    triangles: int
    patches: int
    tiles: int
    tolerance: float
    max_error: float
    byte_count: int
    raising_budget: int = 0

    def describe_budget(self) -> str:
        """Return a sentence with the tolerance that the triangle budget has led to, empty if it has not raised it."""
        if not self.raising_budget:
            return ""
        return f"Triangle Budget {self.raising_budget:,} raises the tolerance to {self.tolerance:.2f} pixels."


@dataclass(frozen=True)
class Update:
    """The changes of a move, in addition to the tiles in `BdamEngine.finished_blocks`.

    tiles: all that are shown afterwards, with the number of their maps. is_complete: whether all of them were finished by this move,
    since nothing is known of what was shown before. warnings: sentences about damaged parts, which are replaced or missing.
    """

    tiles: dict[TileKey, int | None]
    is_complete: bool
    figures: Figures
    warnings: tuple[str, ...]


class BdamEngine:
    """Computes the tiles of one store for viewers in its local frame. Only one thread at a time may use it.

    Attributes:
        folder: the folder of the store.
        settings: how the terrain is shown; if they are replaced, `invalidate` must be called. Curvature needs a new engine.
        store: the open store.
        identity: identifies the store and its content.
        finished_blocks: tiles that the current move has finished; every move starts with an empty queue.
        figures: figures of the last move, None before it.
    """

    def __init__(self, folder: Path, settings: ViewSettings, clock: Callable[[], float] = time.perf_counter) -> None:
        """Open the store in `folder`. clock: seconds, for the velocity of viewers.

        Raises:
            FileError: it is missing, damaged or of a newer version.
        """
        self.folder, self.settings = folder, settings
        self.store = TerrainStore(folder, settings.curvature)
        self.identity = f"{folder}|{find_structure(folder).stat().st_mtime_ns}"
        self.finished_blocks: SimpleQueue[tuple[TileKey, TileBlock]] = SimpleQueue()
        self.figures: Figures | None = None
        self._cache = PatchCache(self.store)
        self._grouping = TileGrouping(self.store)
        self._selectors: dict[bool, tuple[StoreMaps, TextureSelector]] = {}
        self._map_files = {kind: TextureFiles(tiles) for kind, tiles in StoreMaps(self.store, True).stores.items()}
        self._motion, self._clock = ViewerMotion(), clock
        self._present: tuple[TextureCut, Cut] | None = None
        self._budget_step = 0
        self._shown: dict[TileKey, tuple] = {}
        self._viewer: Viewer | None = None
        self._clearance = 0.0
        self._warnings: dict[TileKey, tuple[str, ...]] = {}

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) float64 of the terrain in local meters, without exaggeration."""
        roots = self.store.levels[0]
        return roots.low.min(axis=0).astype(np.float64), roots.high.max(axis=0).astype(np.float64)

    @property
    def heights(self) -> tuple[float, float]:
        """Lowest and highest height in meters, with exaggeration."""
        low, high = self.store.height_range
        return low * self.settings.exaggeration, high * self.settings.exaggeration

    @property
    def maps(self) -> StoreMaps:
        """The maps that the settings show."""
        return self._select()[0]

    def move(self, viewer: Viewer) -> Steps[Update]:
        """Compute the tiles that change for a viewer in the local frame. If it is cancelled or fails, the engine stays valid.

        If patches turn out to be damaged, others are chosen, and tiles with them are finished once more; the last ones count.
        """
        self.finished_blocks = SimpleQueue()
        self._motion.record(viewer, self._clock())
        yield Progress(0.0, "Choosing patches")
        shown, warnings = self._shown, self._warnings
        for _ in self.store.attempts():
            texture_cut, cut, tolerance = self._choose(viewer)
            tiles = self._grouping.group(cut, texture_cut.numbers)
            changed = [key for key, tile in tiles.items() if shown.get(key) != tile.signature]
            warnings = {key: sentences for key, sentences in warnings.items() if key in tiles}
            ready = 0
            for index, key in enumerate(changed):
                yield Progress(index / len(changed), "Reading patches")
                if index == ready:
                    ready += self._read_patches([tiles[key] for key in changed[index:]])
                block, warnings[key] = self._build_block(key, tiles[key])
                self.finished_blocks.put((key, block))
            shown = shown | {key: tiles[key].signature for key in changed}
        is_complete = not self._shown
        self._shown = {key: tile.signature for key, tile in tiles.items()}
        self._present = texture_cut, cut
        self._viewer, self._clearance, self._warnings = viewer, self._measure_clearance(cut, viewer), warnings
        byte_count = self._cache.byte_count + sum(files.byte_count for files in self._map_files.values())
        raising_budget = self.settings.triangle_budget if tolerance > self.settings.tolerance else 0
        self.figures = Figures(self._count_triangles(cut), len(cut), len(tiles), tolerance, cut.max_error, byte_count, raising_budget)
        of_tiles = [sentence for key in tiles for sentence in warnings.get(key, ())]
        sentences = tuple(dict.fromkeys([*self.store.damages, *of_tiles]))
        return Update({key: tile.texture for key, tile in tiles.items()}, is_complete, self.figures, sentences)

    def prefetch(self, seconds: float = PREFETCH_SECONDS) -> Steps[None]:
        """Read into the caches what will be needed within `seconds` if the viewer goes on as between the last two moves, nearest first.

        It takes only memory that what is shown does not need, and changes nothing of the next move but the time it takes. It can be
        cancelled at any step.
        """
        if self._present is None or self._motion.predict(seconds) is None:
            return
        texture_cut, cut = self._present
        patches = Prefetch(self._cache, cut.list_patches())
        maps = {kind: Prefetch(files, self._map_keys(kind, texture_cut)) for kind, files in self._map_files.items()}
        for number in range(1, PREFETCH_CUTS + 1):
            yield Progress((number - 1) / PREFETCH_CUTS, "Reading ahead")
            viewer = self._motion.predict(seconds * number / PREFETCH_CUTS)
            settings = self._cut_settings(viewer)
            texture_cut, is_forced = self._choose_textures(viewer, settings)
            # The tolerance is the one that the triangle budget has led to, which changes slowly.
            cut = extract_cut(self.store, viewer, replace(settings, tolerance=self.figures.tolerance), is_forced)
            yield from patches.read(cut.list_patches())
            for kind, prefetch in maps.items():
                yield from prefetch.read(self._map_keys(kind, texture_cut))

    def is_settled_at(self, viewer: Viewer) -> bool:
        """Return whether what is shown is right for a viewer in the local frame: whether it has hardly moved since the last move."""
        last = self._viewer
        if not self._shown or last is None or last.is_interactive != viewer.is_interactive:
            return False
        distance = float(np.linalg.norm(viewer.position - last.position))
        if distance > SETTLED_FRACTION * self._clearance or viewer.projection.kind != last.projection.kind:
            return False
        if np.abs(viewer.matrix[:3, :3] - last.matrix[:3, :3]).max() > SETTLED_FRACTION * np.abs(last.matrix[:3, :3]).max():
            return False
        if viewer.projection.size != last.projection.size:
            return False
        window, last_window = np.array(viewer.projection.window), np.array(last.projection.window)
        return bool(np.abs(window - last_window).max() <= SETTLED_FRACTION * np.ptp(last_window))

    def invalidate(self) -> None:
        """Forget what is shown: the next update is complete."""
        self._shown, self._warnings = {}, {}

    def _choose(self, viewer: Viewer) -> tuple[TextureCut, Cut, float]:
        """Return the texture cut, the cut, and its tolerance in pixels."""
        settings = self._cut_settings(viewer)
        texture_cut, is_forced = self._choose_textures(viewer, settings)
        cut, tolerance = extract_cut(self.store, viewer, settings, is_forced), settings.tolerance
        if self.settings.triangle_budget and self._count_triangles(cut) > self.settings.triangle_budget:
            cut, tolerance = self._fit_budget(viewer, settings, is_forced)
        return texture_cut, cut, tolerance

    def _cut_settings(self, viewer: Viewer) -> CutSettings:
        settings = self.settings
        tolerance = settings.tolerance / (1.0 + SETTLED_FRACTION) if viewer.is_interactive else settings.tolerance
        return CutSettings(tolerance, settings.exaggeration, settings.culling and viewer.is_interactive, CULLING_MARGIN)

    def _choose_textures(self, viewer: Viewer, settings: CutSettings) -> tuple[TextureCut, IsForced | None]:
        """Return the texture cut, and which patches must be refined for it."""
        selector = self._select()[1]
        texture_cut = selector.choose(viewer, settings, self._max_texture_tiles())
        return texture_cut, selector.is_forced(texture_cut)

    def _select(self) -> tuple[StoreMaps, TextureSelector]:
        """Return the maps that the settings show, and what chooses them."""
        has_color = self.settings.shading == "texture"
        if has_color not in self._selectors:
            maps = StoreMaps(self.store, has_color)
            self._selectors[has_color] = maps, TextureSelector(self.store, maps)
        return self._selectors[has_color]

    def _max_texture_tiles(self) -> int:
        """Return how many texture tiles may be shown: those whose smallest cut has half the triangles of the budget."""
        if not self.settings.triangle_budget:
            return MAX_TILES
        triangles = 2 * self.store.tree.leaf_cells**2  # those of the two patches of a tile
        return min(max(self.settings.triangle_budget // (2 * triangles), MIN_TEXTURE_TILES), MAX_TILES)

    def _fit_budget(self, viewer: Viewer, settings: CutSettings, is_forced: IsForced | None) -> tuple[Cut, float]:
        """Return the cut of the smallest tolerance of a fixed series with which it fits into the triangle budget, and that tolerance.

        The series does not depend on earlier moves, so the same view is always shown in the same way. The search begins at the last result.
        """
        cuts: dict[int, Cut] = {}

        def fits(step: int) -> bool:
            cuts[step] = extract_cut(self.store, viewer, replace(settings, tolerance=self._budget_tolerance(settings, step)), is_forced)
            return self._count_triangles(cuts[step]) <= self.settings.triangle_budget

        last = STEPS_PER_OCTAVE * MAX_OCTAVES
        start = min(max(self._budget_step, 1), last)
        fits_start = fits(start)
        low, high = (0, start) if fits_start else (start, last)
        width = 1
        while high - low > 1:
            step = high - width if fits_start else low + width
            if not low < step < high:
                step = (low + high) // 2
            is_low_enough = fits(step)
            low, high = (low, step) if is_low_enough else (step, high)
            width = 2 * width if is_low_enough == fits_start else last  # once the result is between two steps, bisect
        if high not in cuts:
            fits(high)
        self._budget_step = high
        return cuts[high], self._budget_tolerance(settings, high)

    def _budget_tolerance(self, settings: CutSettings, step: int) -> float:
        return settings.tolerance * 2.0 ** (step / STEPS_PER_OCTAVE)

    def _read_patches(self, tiles: list[Tile]) -> int:
        """Read the patches of the first ones of some tiles into the cache, READ_PATCHES or somewhat more, and return how many tiles."""
        counts = np.cumsum([len(tile.levels) for tile in tiles])
        tile_count = min(int(np.searchsorted(counts, READ_PATCHES)) + 1, len(tiles))
        self._cache.read_all([patch for tile in tiles[:tile_count] for patch in tile.list_patches()])
        return tile_count

    def _build_block(self, key: TileKey, tile: Tile) -> tuple[TileBlock, tuple[str, ...]]:
        """Return a tile, and sentences about its damaged parts."""
        mesh = build_tile_mesh(self.store, self._cache, key, tile, self.settings.exaggeration)
        if tile.texture is None:
            return TileBlock(mesh, None), mesh.damages
        maps, damages = self.read_maps(tile.texture)
        return TileBlock(mesh, (tile.texture, maps)), (*mesh.damages, *damages)

    def read_maps(self, number: int) -> tuple[ShownMaps, tuple[str, ...]]:
        """Return the maps of a square, and sentences about those that are damaged, which are None. Keeps the files used last."""
        shown, damages = {}, []
        for kind in KINDS:
            found = self.maps.find(kind, number)
            try:
                shown[kind] = None if found is None else self.maps.place(number, found, self._map_files[kind].read(found[0]))
            except FarfieldError as error:
                shown[kind] = None
                damages.append(str(error))
        return ShownMaps(self.maps.label(number), **shown), tuple(damages)

    def _map_keys(self, kind: str, cut: TextureCut) -> list[int]:
        """Return the numbers of the tiles of a kind that a cut shows."""
        found = [self.maps.find(kind, number) for number in cut.numbers.values() if number is not None]
        return sorted({item[0] for item in found if item is not None})

    def _count_triangles(self, cut: Cut) -> int:
        """Return the number of triangles of a cut, holes included."""
        return int(cut.count_triangles(self.store).sum())

    def _measure_clearance(self, cut: Cut, viewer: Viewer) -> float:
        """Return the distance in meters from a viewer to the nearest patch, at least the size of a cell."""
        nearest = np.inf
        scale = np.array([1.0, 1.0, self.settings.exaggeration])
        for level in np.unique(cut.levels).tolist():
            patches, rows = self.store.levels[level], cut.rows[cut.levels == level]
            low, high = patches.low[rows] * scale, patches.high[rows] * scale
            offsets = np.maximum(np.maximum(low - viewer.position, viewer.position - high), 0.0)
            nearest = min(nearest, float(np.sqrt((offsets * offsets).sum(axis=1)).min()))
        return max(nearest, self.store.header.cell_size)
