"""Cuts as meshes in full precision, for files, with their textures."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import FileError
from ...files.complete_files import PNG_SIGNATURE
from ...files.glb import Y_UP, Document, save_glb
from ...geometry.viewers import Viewer
from ...imaging.coded_images import JPEG_START, encode
from ...jobs.progress import Progress, Steps
from ..store.terrain_store import TerrainStore
from .caches import PatchCache
from .cut_meshes import CutMesh, PatchMesh, merge_patches, remove_unused
from .extraction import Cut, CutSettings, extract_cut
from .texture_cuts import TextureSelector
from .tile_maps import StoreMaps
from .tiles import MAX_TILES, Tile, TileGrouping, texture_uvs

PROGRESS_PATCHES = 64  # between two steps
PNG_COLOR_TYPE, PNG_RGBA = 25, 6  # the byte of a PNG file that tells its channels, and its value for RGB with alpha
ROUGHNESS = 0.95
CLAMPED = {"wrapS": 33071, "wrapT": 33071}  # a sampler of glTF that repeats no texel at the border


@dataclass(frozen=True, eq=False)
class CutPart:
    """The triangles of a cut with one material.

    Attributes:
        vertices: (U,) int64, indices of vertices of the cut.
        triangles: (T, 3) int32, indices of `vertices`.
        uvs: (U, 2) float32 in the texture tile, None without.
        texture: number of the texture tile, None without.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    uvs: np.ndarray | None
    texture: int | None


@dataclass(frozen=True)
class ExtractedMesh:
    """The mesh of a cut, without holes, and figures about it.

    Attributes:
        mesh: the mesh, all of whose vertices are used.
        parts: its triangles by material.
        patches: number of patches.
        tiles: number of objects that show the same in a scene.
        max_error: pixels.
        warnings: sentences about damaged parts, which are replaced or missing.
    """

    mesh: CutMesh
    parts: tuple[CutPart, ...]
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
    maps, cache = StoreMaps(store, has_color=True), PatchCache(store, max_bytes=0)
    selector = TextureSelector(store, maps)
    for _ in store.attempts():
        texture_cut = selector.choose(viewer, settings, MAX_TILES)
        cut = extract_cut(store, viewer, settings, selector.is_forced(texture_cut))
        meshes = yield from _read_patches(cache, cut)
    if not meshes:
        raise FileError(f'No patch of "{store.folder}" can be read; build the terrain again.')
    tiles = TileGrouping(store).group(cut, texture_cut.numbers)
    mesh = remove_unused(merge_patches(list(meshes.values()), np.array([level for level, _ in meshes])))
    return ExtractedMesh(
        mesh, _list_parts(store, mesh, meshes, _find_textures(maps, tiles.values())), len(meshes), len(tiles), cut.max_error, store.damages
    )


def read_texture(store: TerrainStore, number: int) -> bytes:
    """Return a texture tile as a JPEG file, or as a PNG file if it has alpha or was stored in another format. Raises FileError."""
    coded = store.textures.read_coded(number)
    if coded.alpha is None and coded.color.startswith(JPEG_START):
        return coded.color
    return encode(store.textures.read(number), "png")


def encode_glb(name: str, extracted: ExtractedMesh, images: Mapping[int, bytes]) -> bytes:
    """Return a cut as a binary glTF file, y upwards, with one mesh and a material per texture tile.

    images: files by the number of their tile, see `read_texture`; a part whose image is missing has no material.

    Raises:
        FileError: the file would be larger than 4 GB.
    """
    numbers, mesh = list(images), extracted.mesh
    positions, normals = mesh.positions @ Y_UP.T, mesh.normals @ Y_UP.T
    primitives = []
    for part in extracted.parts:
        attributes = {"POSITION": positions[part.vertices], "NORMAL": normals[part.vertices]}
        primitive = {"attributes": attributes, "indices": part.triangles.ravel()}
        if part.texture in images:
            attributes["TEXCOORD_0"] = part.uvs * [1.0, -1.0] + [0.0, 1.0]  # v is downwards
            primitive["material"] = numbers.index(part.texture)
        primitives.append(primitive)
    document = {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "meshes": [{"name": name, "primitives": primitives}],
        "materials": [_describe_material(index, content) for index, content in enumerate(images.values())],
        "textures": [{"source": index, "sampler": 0} for index in range(len(images))],
        "samplers": [CLAMPED] if images else [],
        "images": [{"content": content} for content in images.values()],
    }
    return save_glb(document)


def has_alpha(image: bytes) -> bool:
    """Return whether an image of `read_texture` has alpha."""
    return image.startswith(PNG_SIGNATURE) and image[PNG_COLOR_TYPE] == PNG_RGBA


def _describe_material(index: int, image: bytes) -> Document:
    surface = {"baseColorTexture": {"index": index}, "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}
    return {"pbrMetallicRoughness": surface, **({"alphaMode": "MASK"} if has_alpha(image) else {})}


def _find_textures(maps: StoreMaps, tiles: Iterable[Tile]) -> dict[tuple[int, int], int | None]:
    """Return the number of the texture tile of all patches by their level and row, None where there is none."""
    textures = {}
    for tile in tiles:
        found = None if tile.texture is None else maps.find("color", tile.texture)
        textures |= dict.fromkeys(zip(tile.levels.tolist(), tile.rows.tolist(), strict=True), None if found is None else found[0])
    return textures


def _list_parts(
    store: TerrainStore, mesh: CutMesh, meshes: Mapping[tuple[int, int], PatchMesh], textures: Mapping[tuple[int, int], int | None]
) -> tuple[CutPart, ...]:
    """Return the parts of the mesh of patches by their level and row, in the order of their triangles. textures: of the patches."""
    materials = list(dict.fromkeys(textures[patch] for patch in meshes))
    numbers = np.repeat([materials.index(textures[patch]) for patch in meshes], [len(patch.triangles) for patch in meshes.values()])
    parts = []
    for number, texture in enumerate(materials):
        vertices, triangles = np.unique(mesh.triangles[numbers == number], return_inverse=True)
        if len(vertices):
            uvs = None
            if texture is not None:
                index = store.textures.index
                uvs = texture_uvs(store, mesh.ids[vertices], (int(index.levels[texture]), *index.tiles[texture].tolist()))
            parts.append(CutPart(vertices, triangles.reshape(-1, 3).astype(np.int32), uvs, texture))
    return tuple(parts)


def _read_patches(cache: PatchCache, cut: Cut) -> Steps[dict[tuple[int, int], PatchMesh]]:
    """Return the patches of a cut that can be read, by level and row."""
    meshes, keys = {}, cut.list_patches()
    for start in range(0, len(keys), PROGRESS_PATCHES):
        yield Progress(start / len(keys), "Reading patches")
        part = keys[start : start + PROGRESS_PATCHES]
        found = zip(part, cache.read_all(part), strict=True)
        meshes |= {key[:2]: mesh for key, mesh in found if not isinstance(mesh, FileError)}  # the store keeps the sentence
    return meshes
