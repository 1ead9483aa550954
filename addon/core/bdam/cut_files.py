"""Cuts as meshes in full precision, for files."""

from dataclasses import dataclass

from ..geometry.viewers import Viewer
from ..jobs.progress import Progress, Steps
from .cut_meshes import CutMesh, PatchCache, PatchMesh, merge_patches, remove_unused
from .extraction import CutSettings, extract_cut
from .patch_squares import find_leaf_squares
from .store.terrain_store import TerrainStore
from .texture_cuts import TextureSelector
from .tiles import MAX_TILES, TileGrouping

PROGRESS_PATCHES = 64  # between two steps


@dataclass(frozen=True)
class ExtractedMesh:
    """The mesh of a cut, without holes, and figures about it.

    mesh: all of its vertices are used. patches: number of patches. tiles: the number of objects that show the same in a scene. max_error:
    pixels.
    """

    mesh: CutMesh
    patches: int
    tiles: int
    max_error: float


def extract_mesh(store: TerrainStore, viewer: Viewer, settings: CutSettings) -> Steps[ExtractedMesh]:
    """Return the mesh that shows a terrain to a viewer in its local frame.

    Raises:
        FileError: a patch is damaged.
    """
    yield Progress(0.0, "Choosing patches")
    leaf_squares = find_leaf_squares(store)
    squares: dict[tuple[int, int, int], int | None] = {(0, 0, 0): None}
    is_forced = None
    if store.textures is not None:
        selector = TextureSelector(store, leaf_squares)
        texture_cut = selector.choose(viewer, settings, MAX_TILES)
        squares, is_forced = texture_cut.numbers, selector.is_forced(texture_cut)
    cut = extract_cut(store, viewer, settings, is_forced)
    tiles = TileGrouping(store, leaf_squares).group(cut, squares)
    cache = PatchCache(store, max_bytes=0)
    meshes: list[PatchMesh] = []
    for index, (level, row) in enumerate(zip(cut.levels.tolist(), cut.rows.tolist(), strict=True)):
        if index % PROGRESS_PATCHES == 0:
            yield Progress(index / len(cut), "Reading patches")
        meshes.append(cache.get(level, row))
    return ExtractedMesh(remove_unused(merge_patches(meshes, cut.levels)), len(cut), len(tiles), cut.max_error)
