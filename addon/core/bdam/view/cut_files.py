"""Cuts as meshes in full precision, for files."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ...errors import FileError
from ...geometry.viewers import Viewer
from ...jobs.progress import Progress, Steps
from ..store.terrain_store import TerrainStore
from .caches import PatchCache
from .cut_meshes import CutMesh, PatchMesh, merge_patches, remove_unused
from .extraction import Cut, CutSettings, extract_cut
from .texture_cuts import TextureSelector
from .tile_maps import StoreMaps
from .tiles import MAX_TILES, TileGrouping

PROGRESS_PATCHES = 64  # between two steps


@dataclass(frozen=True)
class ExtractedMesh:
    """The mesh of a cut, without holes, and figures about it.

    Attributes:
        mesh: the mesh, all of whose vertices are used.
        patches: number of patches.
        tiles: number of objects that show the same in a scene.
        max_error: pixels.
        warnings: sentences about damaged parts, which are replaced or missing.
    """

    mesh: CutMesh
    patches: int
    tiles: int
    max_error: float
    warnings: tuple[str, ...] = ()


def extract_mesh(store: TerrainStore, viewer: Viewer, settings: CutSettings) -> Steps[ExtractedMesh]:
    """Return the mesh that shows a terrain to a viewer in its local frame. Other patches replace damaged ones.

    Raises:
        FileError: no patch can be read.
    """
    yield Progress(0.0, "Choosing patches")
    selector, cache = TextureSelector(store, StoreMaps(store, has_color=True)), PatchCache(store, max_bytes=0)
    for _ in store.attempts():
        texture_cut = selector.choose(viewer, settings, MAX_TILES)
        cut = extract_cut(store, viewer, settings, selector.is_forced(texture_cut))
        meshes, levels = yield from _read_patches(cache, cut)
    if not meshes:
        raise FileError(f'No patch of "{store.folder}" can be read; build the terrain again.')
    tiles = TileGrouping(store).group(cut, texture_cut.numbers)
    return ExtractedMesh(remove_unused(merge_patches(meshes, levels)), len(meshes), len(tiles), cut.max_error, store.damages)


def _read_patches(cache: PatchCache, cut: Cut) -> Steps[tuple[list[PatchMesh], np.ndarray]]:
    """Return the patches of a cut that can be read, and their levels (N,)."""
    meshes, levels = [], []
    for index, key in enumerate(cut.list_patches()):
        if index % PROGRESS_PATCHES == 0:
            yield Progress(index / len(cut), "Reading patches")
        with suppress(FileError):  # the store keeps the sentence
            meshes.append(cache.read(key))
            levels.append(key[0])
    return meshes, np.array(levels)
