"""Ordinary meshes of cuts, and the cut that is fine enough for a whole camera path."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.viewers import Viewer
from ...jobs.progress import Progress, Steps, subprogress
from ..settings import ViewSettings
from ..store.terrain_store import TerrainStore
from .caches import PatchCache
from .extraction import Cut, CutSettings, extract_union_cut
from .texture_cuts import TextureCut, TextureSelector
from .tile_maps import StoreMaps
from .tiles import MAX_TILES, TileGrouping, TileMesh, build_tile_mesh


@dataclass(frozen=True)
class FrozenMesh:
    """A mesh that no longer changes.

    Attributes:
        location: (3,) float64, position of the mesh in local meters with exaggeration.
        vertices: (V, 3) float32, relative to the location.
        normals: (V, 3) float32, unit vectors.
        triangles: (T, 3) int32, counterclockwise seen from above.
        uvs: (T, 3, 2) float32, None without texture.
        levels: (T,) int8, levels of the patches.
        materials: keys of the material slots.
        slots: (T,) int32, the slot of each triangle.
    """

    location: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    uvs: np.ndarray | None
    levels: np.ndarray
    materials: tuple[int | str | None, ...]
    slots: np.ndarray


def choose_path_cut(store: TerrainStore, viewers: Sequence[Viewer], settings: ViewSettings) -> Steps[tuple[TextureCut, Cut]]:
    """Return the texture tiles and the coarsest cut that satisfy the tolerance for each of `viewers`, at least one, in the local frame.

    Nothing is culled, because shadows and reflections show what the camera does not. The triangle budget does not count. At most MAX_TILES
    textures are used for the whole path; `describe_limit` tells whether they are too few for the tolerance.
    """
    cut_settings = CutSettings(settings.tolerance, settings.exaggeration)
    selector = TextureSelector(store, StoreMaps(store, settings.shading == "texture"))
    textures = yield from subprogress(selector.choose_for_path(viewers, cut_settings, MAX_TILES), 0.0, 0.5)
    return textures, (yield from subprogress(extract_union_cut(store, viewers, cut_settings, selector.is_forced(textures)), 0.5, 1.0))


def describe_limit(textures: TextureCut, settings: ViewSettings) -> str:
    """Return a sentence if the textures of a path are coarser than the tolerance, because more than MAX_TILES would be needed, or ""."""
    if textures.tolerance is None or textures.tolerance <= settings.tolerance:
        return ""
    return (
        f"Textures are limited to {MAX_TILES} tiles, so that texels cover up to {textures.tolerance:.3g} pixels; "
        "freeze parts of the path for finer ones."
    )


def freeze_cut(store: TerrainStore, textures: TextureCut, cut: Cut, exaggeration: float) -> Steps[tuple[list[FrozenMesh], tuple[str, ...]]]:
    """Return the meshes of the tiles of a cut, whose materials are the numbers of their maps or None, and sentences about damaged
    parts, which are missing unless `cut` avoids them."""
    cache = PatchCache(store)
    tiles = TileGrouping(store).group(cut, textures.numbers)
    meshes, damages = [], []
    for number, (key, tile) in enumerate(tiles.items()):
        yield Progress(number / len(tiles), "Reading patches")
        mesh = build_tile_mesh(store, cache, key, tile, exaggeration)
        damages += mesh.damages
        if len(mesh.triangles):
            meshes.append(freeze_tile(mesh, tile.texture))
    return meshes, tuple(dict.fromkeys([*store.damages, *damages]))


def freeze_tile(mesh: TileMesh, material: int | str | None) -> FrozenMesh:
    """Return the mesh of a tile with the key of its material."""
    uvs = None if mesh.uvs is None else mesh.uvs[mesh.triangles]
    slots = np.zeros(len(mesh.triangles), np.int32)
    return FrozenMesh(mesh.location, mesh.vertices, mesh.normals, mesh.triangles, uvs, mesh.levels, (material,), slots)


def join(meshes: Sequence[FrozenMesh]) -> FrozenMesh:
    """Return one mesh of several, at least one, with one vertex wherever vertices have exactly the same position.

    Corners without texture have the UV coordinates (0, 0) if others have a texture.
    """
    location = meshes[0].location
    positions = np.concatenate([mesh.vertices.astype(np.float64) + (mesh.location - location) for mesh in meshes])
    _, first, inverse = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    triangles = inverse.reshape(-1).astype(np.int32)[
        np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)])
    ]
    materials = tuple(dict.fromkeys(material for mesh in meshes for material in mesh.materials))
    slots = [np.array([materials.index(material) for material in mesh.materials], np.int32)[mesh.slots] for mesh in meshes]
    uvs = None
    if any(mesh.uvs is not None for mesh in meshes):
        uvs = np.concatenate([np.zeros((len(mesh.triangles), 3, 2), np.float32) if mesh.uvs is None else mesh.uvs for mesh in meshes])
    return FrozenMesh(
        location,
        positions[first].astype(np.float32),
        np.concatenate([mesh.normals for mesh in meshes])[first],
        triangles,
        uvs,
        np.concatenate([mesh.levels for mesh in meshes]),
        materials,
        np.concatenate(slots),
    )
