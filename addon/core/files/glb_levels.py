"""Levels of detail in binary glTF files (MSFT_lod), plain or quantized (KHR_mesh_quantization), from files of a general exporter.

The same input gives the same bytes. General tools quantize each mesh by itself, which moves equal vertices of levels apart.
"""

import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GeometryError
from .glb import GlbBuffer, read_accessor, split_glb

QUANTIZATION, LEVELS, SCREEN_COVERAGE = "KHR_mesh_quantization", "MSFT_lod", "MSFT_screencoverage"
TEXTURE_TRANSFORM, UNLIT = "KHR_texture_transform", "KHR_materials_unlit"
KEPT = ("materials", "textures", "samplers")  # parts of a document that stay in their order


@dataclass(frozen=True, eq=False)
class LevelNode:
    """A mesh in the scene.

    Attributes:
        source: the name of its node in the file of the exporter.
        name: any text.
        bounds: (2, 3), the lowest and highest position that quantized positions can represent; meshes with the same bounds round equal
            positions to equal ones.
        matrix: (4, 4), from the mesh to the world, y upwards; None if they are the same.
        levels: indices of the nodes that replace this one as it covers less of the image, finest first.
        coverages: of the node itself and of each level, the fraction of the image down to which it shows.
    """

    source: str
    name: str
    bounds: np.ndarray
    matrix: np.ndarray | None = None
    levels: tuple[int, ...] = ()
    coverages: tuple[float, ...] = ()


@dataclass(frozen=True)
class _Grid:
    """Values that the stored ones represent: offset + scale * stored. The scale is the same in all directions, so that neither normals nor
    turned textures are distorted."""

    offset: tuple[float, ...]
    scale: float


@dataclass(frozen=True, eq=False)
class _File:
    """A file of the exporter: its document and its binary chunk."""

    document: dict[str, Any]
    binary: memoryview

    def read(self, index: int) -> np.ndarray:
        """Return the values (N, C) of an accessor, see `read_accessor`."""
        return read_accessor(self.document, self.binary, index)

    def primitives(self) -> Iterator[dict[str, Any]]:
        """Yield the primitives of all meshes."""
        for mesh in self.document["meshes"]:
            yield from mesh["primitives"]


def encode_levels(
    content: bytes, nodes: Sequence[LevelNode], is_quantized: bool, names: Mapping[str, str], unlit: Collection[str] = ()
) -> bytes:
    """Return a file with the meshes, materials and images of `content`, the file of an exporter, in other nodes.

    is_quantized: store positions in 16 bits with the transform of the node, texture coordinates in 16 bits, normals in 8 bits and colors
    in 16 bits, where they are within 0..1. Texture coordinates outside of 0..1 are scaled by the material (KHR_texture_transform); without
    a texture they remain single precision. names: of materials, by those in `content`. unlit: materials of `content` that are shown
    without light.

    Raises:
        FileError: it would be larger than 4 GB. GeometryError: a mesh has no triangles, or there are numbers that are not finite.
    """
    file, buffer = _File(*split_glb(content)), GlbBuffer()
    document = file.document
    meshes = {node["name"]: node["mesh"] for node in document["nodes"] if "mesh" in node}
    missing = [node.name for node in nodes if node.source not in meshes]
    if missing:
        raise GeometryError(f'"{missing[0]}" has no triangles to write; choose an object with a surface.')
    _merge(document, names, unlit)
    order = {mesh: index for index, mesh in enumerate(dict.fromkeys(meshes[node.source] for node in nodes))}
    grids = {meshes[node.source]: _position_grid(node.bounds) for node in nodes} if is_quantized else {}
    labels = {meshes[node.source]: node.name for node in reversed(nodes)}
    uv_grids = _find_uv_grids(file) if is_quantized else {}
    encoded = [{"name": labels[mesh], "primitives": _encode_mesh(file, buffer, mesh, grids.get(mesh), uv_grids)} for mesh in order]
    for (material, uv_map), grid in uv_grids.items():
        for texture in _textures(document["materials"][material]):
            if _uv_map(texture) == uv_map:
                placement = texture.setdefault("extensions", {}).setdefault(TEXTURE_TRANSFORM, {})
                placement |= _move_placement(placement, grid)
    images = [{**image, "bufferView": _copy_view(file, buffer, image["bufferView"])} for image in document.get("images", ())]
    levels = {index for node in nodes for index in node.levels}
    used, required = _list_extensions(document, is_quantized, bool(levels), uv_grids)
    result = {"extensionsUsed": used, "extensionsRequired": required}
    result |= {"scenes": [{"nodes": [index for index in range(len(nodes)) if index not in levels]}]}
    result |= {"nodes": [_encode_node(node, order[meshes[node.source]], grids.get(meshes[node.source])) for node in nodes]}
    result |= {"meshes": encoded, "images": images, **{key: document[key] for key in KEPT if key in document}}
    return buffer.join(result)


def _copy_view(file: _File, buffer: GlbBuffer, index: int) -> int:
    view = file.document["bufferViews"][index]
    start = view.get("byteOffset", 0)
    return buffer.add_view(bytes(file.binary[start : start + view["byteLength"]]), {})


def _position_grid(bounds: np.ndarray) -> _Grid:
    """Return the cube that quantized positions fill, from -1 to 1."""
    low, high = np.asarray(bounds, np.float64)
    return _Grid(tuple((0.5 * (low + high)).tolist()), float(0.5 * (high - low).max()) or 1.0)


def _find_uv_grids(file: _File) -> dict[tuple[int, int], _Grid]:
    """Return the range of the texture coordinates of all primitives, by material and number of their UV map, as far as they leave 0..1
    and textures use them."""
    found: dict[tuple[int, int], list[np.ndarray]] = {}
    for part in file.primitives():
        material = part.get("material")
        for uv_map in {} if material is None else {_uv_map(texture) for texture in _textures(file.document["materials"][material])}:
            if f"TEXCOORD_{uv_map}" in part["attributes"]:
                found.setdefault((material, uv_map), []).append(file.read(part["attributes"][f"TEXCOORD_{uv_map}"]))
    grids = {}
    for key, parts in sorted(found.items(), key=lambda item: item[0]):
        uvs = np.concatenate(parts).astype(np.float64)
        low, high = uvs.min(axis=0), uvs.max(axis=0)
        if (low < 0.0).any() or (high > 1.0).any():
            grids[key] = _Grid(tuple(low.tolist()), float((high - low).max()) or 1.0)
    return grids


def _textures(value: object) -> Iterator[dict[str, Any]]:
    """Yield the references to textures within a material."""
    for key, item in value.items() if isinstance(value, dict) else ():
        if key.endswith("Texture"):
            yield item
        else:
            yield from _textures(item)


def _uv_map(texture: dict[str, Any]) -> int:
    return texture.get("extensions", {}).get(TEXTURE_TRANSFORM, {}).get("texCoord", texture.get("texCoord", 0))


def _encode_mesh(
    file: _File, buffer: GlbBuffer, mesh: int, grid: _Grid | None, uv_grids: Mapping[tuple[int, int], _Grid]
) -> list[dict[str, Any]]:
    """Return the primitives of a mesh, quantized if there is a `grid` for its positions."""
    result = []
    for part in file.document["meshes"][mesh]["primitives"]:
        attributes = {}
        for name, index in part["attributes"].items():
            values = file.read(index)
            if not np.isfinite(values).all():
                raise GeometryError("A level has coordinates or colors that are not finite; repair its mesh.")
            uv_grid = uv_grids.get((part.get("material", -1), int(name.removeprefix("TEXCOORD_")) if "TEXCOORD" in name else -1))
            is_fraction = file.document["accessors"][index].get("normalized", False)
            attributes[name] = _store(values, is_fraction) if grid is None else _quantize(name, values, grid, uv_grid)
        triangles = file.read(part["indices"]).ravel().astype(np.int64)
        kept, joined = _join_vertices(list(attributes.values()))
        encoded = {}
        for name, values in attributes.items():
            encoded[name] = buffer.add_attribute(values[kept], values.dtype.kind != "f", name == "POSITION")
        shown = {"material": part["material"]} if "material" in part else {}
        result.append({"attributes": encoded, "indices": buffer.add_indices(joined[triangles], len(kept)), **shown})
    return result


def _store(values: np.ndarray, is_fraction: bool) -> np.ndarray:
    """Return values as they are stored without quantization: fractions in 16 bits, others in single precision."""
    return np.rint(65535.0 * values).astype(np.uint16) if is_fraction else values.astype(np.float32)


def _quantize(name: str, values: np.ndarray, grid: _Grid, uv_grid: _Grid | None) -> np.ndarray:
    """Return stored values of a vertex attribute."""
    if name == "POSITION":
        return np.rint(32767.0 * np.clip((values - grid.offset) / grid.scale, -1.0, 1.0)).astype(np.int16)
    if name == "NORMAL":
        return np.rint(127.0 * values).astype(np.int8)
    if uv_grid is not None:
        values = np.clip((values - uv_grid.offset) / uv_grid.scale, 0.0, 1.0)
    return _store(values, values.min() >= 0.0 and values.max() <= 1.0)


def _join_vertices(attributes: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first of vertices with equal attributes, (K,) indices in ascending order, and the position of each vertex among them."""
    rows = np.concatenate([np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1) for values in attributes], axis=1)
    _, first, inverse = np.unique(rows.view(f"V{rows.shape[1]}").ravel(), return_index=True, return_inverse=True)
    kept, places = np.unique(first, return_inverse=True)
    return kept, places[inverse.ravel()]


def _merge(document: dict[str, Any], names: Mapping[str, str], unlit: Collection[str]) -> None:
    """Give materials their final names, let those of `unlit` be shown without light, and let equal textures and materials be one."""
    textures = _keep_first(document, "textures")
    for material in document.get("materials", ()):
        material |= {"extensions": {UNLIT: {}}} if material.get("name") in unlit else {}
        material["name"] = names.get(material.get("name", ""), material.get("name", ""))
        for texture in _textures(material):
            texture["index"] = textures[texture["index"]]
    materials = _keep_first(document, "materials")
    for mesh in document["meshes"]:
        for part in mesh["primitives"]:
            part |= {"material": materials[part["material"]]} if "material" in part else {}


def _keep_first(document: dict[str, Any], key: str) -> list[int]:
    """Remove repetitions from a list of a document, and return the new index of each item."""
    kept: dict[str, int] = {}
    indices = [kept.setdefault(json.dumps(item, sort_keys=True), len(kept)) for item in document.get(key, ())]
    document[key] = [json.loads(text) for text in kept]
    return indices


def _move_placement(placement: Mapping[str, Any], grid: _Grid) -> dict[str, list[float]]:
    """Return offset and scale of a texture that was placed by `placement`, for the stored values of a grid."""
    angle, scale = placement.get("rotation", 0.0), np.array(placement.get("scale", (1.0, 1.0)))
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])  # v is downwards
    offset = turn @ (scale * grid.offset) + placement.get("offset", (0.0, 0.0))
    return {"offset": offset.tolist(), "scale": (scale * grid.scale).tolist()}


def _encode_node(node: LevelNode, mesh: int, grid: _Grid | None) -> dict[str, Any]:
    result: dict[str, Any] = {"name": node.name, "mesh": mesh}
    if node.matrix is not None:
        matrix = np.array(node.matrix, np.float64)
        if grid is not None:
            matrix[:3, 3] += matrix[:3, :3] @ grid.offset
            matrix[:3, :3] *= grid.scale
        result["matrix"] = matrix.T.ravel().tolist()  # column by column
    elif grid is not None:
        result |= {"translation": list(grid.offset), "scale": [grid.scale] * 3}
    if node.levels:
        result["extensions"] = {LEVELS: {"ids": list(node.levels)}}
        result |= {"extras": {SCREEN_COVERAGE: list(node.coverages)}} if node.coverages else {}
    return result


def _list_extensions(
    document: dict[str, Any], is_quantized: bool, has_levels: bool, uv_grids: Mapping[tuple[int, int], _Grid]
) -> tuple[list[str], list[str]]:
    """Return the extensions that the file uses, and those that a reader needs to show it correctly."""
    required = {*document.get("extensionsRequired", ()), *([QUANTIZATION] if is_quantized else ())}
    required |= {TEXTURE_TRANSFORM} if uv_grids else set()
    found = {name for material in document.get("materials", ()) for name in material.get("extensions", {})}
    used = {name for name in document.get("extensionsUsed", ()) if not name.startswith("KHR_materials_")} | found | required
    return sorted(used | ({LEVELS} if has_levels else set())), sorted(required)
