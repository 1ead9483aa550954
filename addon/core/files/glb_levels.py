"""Levels of detail in glTF files (MSFT_lod), plain or quantized (KHR_mesh_quantization), from the document of a general exporter.

General tools quantize each mesh by itself, which moves equal vertices of levels apart.
"""

import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GeometryError
from .glb import JOINTS, WEIGHTS, Document

QUANTIZATION, LEVELS, SCREEN_COVERAGE = "KHR_mesh_quantization", "MSFT_lod", "MSFT_screencoverage"
TEXTURE_TRANSFORM, UNLIT, MATERIALS = "KHR_texture_transform", "KHR_materials_unlit", "KHR_materials_"


@dataclass(frozen=True)
class Precision:
    """The largest integers of quantized positions and texture coordinates."""

    position: int
    uv: int


SHORT, UNSIGNED_SHORT = 32767, 65535  # the largest integers that files have
FULL = Precision(SHORT, UNSIGNED_SHORT)
# For files that are compressed: lower bits are noise, which does not compress. A texel of 4096 has four steps.
COMPRESSIBLE = Precision(8191, 16383)


@dataclass(frozen=True, eq=False)
class LevelNode:
    """A mesh in the scene.

    Attributes:
        source: the name of its node in the document of the exporter.
        name: any text.
        bounds: (2, 3), the lowest and highest position that quantized positions can represent; meshes with the same bounds round equal
            positions to equal ones.
        matrix: (4, 4), from the mesh to the world, y upwards.
        levels: indices of the nodes that replace this one as it covers less of the image, finest first.
        coverages: of the node itself and of each level, the fraction of the image down to which it shows.
        pixel_size: the smallest size of a pixel at which it shows, in the unit of the mesh.
    """

    source: str
    name: str
    bounds: np.ndarray
    matrix: np.ndarray
    levels: tuple[int, ...] = ()
    coverages: tuple[float, ...] = ()
    pixel_size: float = 0.0

    def grid(self, precision: "Precision") -> "_Grid":
        """Return the cube that quantized positions fill, from -1 to 1."""
        low, high = np.asarray(self.bounds, np.float64)
        return _Grid(0.5 * (low + high), float(0.5 * (high - low).max()) or 1.0, precision.position)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Values that the stored ones represent: offset + scale * stored / largest. The scale is the same in all directions, so that neither
    normals nor turned textures are distorted.

    largest: stored value. Readers divide by that of the type.
    """

    offset: np.ndarray
    scale: float
    largest: int

    def stored_scale(self, limit: int) -> float:
        """Return the scale of what readers make of a stored value by dividing it by `limit`."""
        return self.scale * limit / self.largest


def arrange_levels(
    document: Document,
    nodes: Sequence[LevelNode],
    precision: Precision | None,
    names: Mapping[str, str],
    unlit: Collection[str] = (),
    joint_names: Mapping[str, str] | None = None,
) -> Document:
    """Return a document with the meshes, skins, materials and images of an exporter in other nodes. The input is changed.

    precision: store positions in up to 16 bits with the transform of the node, texture coordinates in up to 16 bits, normals in 8 bits and
    colors in 16 bits, where they are within 0..1. Positions of meshes with a skin, whose nodes have no transform, and of those with morph
    targets remain single precision. Texture coordinates that leave 0..1 or have less bits are scaled by the material
    (KHR_texture_transform); without a texture they have 16 bits, or single precision outside of 0..1. None to quantize nothing. names: of
    materials, by those in `document`. unlit: materials of `document` that are shown without light. joint_names: of nodes of skeletons, by
    those in `document`.

    Raises:
        GeometryError: a mesh has no triangles, or coordinates that are not finite.
    """
    _merge(document, names, unlit)
    sources = {node["name"]: (node["mesh"], node.get("skin")) for node in document["nodes"] if "mesh" in node}
    meshes, grids, written = {}, {}, []
    for node in nodes:
        if node.source not in sources:
            raise GeometryError(f'"{node.name}" has no triangles to write; choose an object with a surface.')
        source, skin = sources[node.source]
        meshes.setdefault(source, {**document["meshes"][source], "name": node.name})
        is_deformed = skin is not None or any("targets" in part for part in meshes[source]["primitives"])
        grids.setdefault(source, None if precision is None or is_deformed else node.grid(precision))
        written.append(_write_node(node, list(meshes).index(source), grids[source], skin))
    uv_grids = {} if precision is None else _find_uv_grids(document, precision.uv)
    for source, mesh in meshes.items():
        for part in mesh["primitives"]:
            _write_primitive(part, mesh["name"], precision is not None, grids[source], uv_grids)
    for (material, uv_map), grid in uv_grids.items():
        for _, texture in list_textures(document["materials"][material]):
            if find_uv_map(texture) == uv_map:
                placement = texture.setdefault("extensions", {}).setdefault(TEXTURE_TRANSFORM, {})
                placement |= _move_placement(placement, grid)
    levels = {index for node in nodes for index in node.levels}
    added = {QUANTIZATION: precision is not None, TEXTURE_TRANSFORM: bool(uv_grids)}
    kept = {key: document[key] for key in ("materials", "textures", "images", "samplers") if key in document}
    bones, roots, skins = _move_skeletons(document, len(nodes), joint_names or {})
    scenes = [{"nodes": [*(index for index in range(len(nodes)) if index not in levels), *roots]}]
    extensions = _list_extensions(document, {name for name, is_needed in added.items() if is_needed}, bool(levels))
    kept |= {"meshes": _merge_meshes(list(meshes.values()), written), "skins": skins}
    return {**extensions, "scenes": scenes, "nodes": [*written, *bones], **kept}


def _merge_meshes(meshes: Sequence[Document], nodes: Sequence[Document]) -> list[Document]:
    """Let nodes with equal meshes have the same one, and return those that are left."""
    kept: dict[tuple, int] = {}
    for mesh in meshes:
        kept.setdefault(_identify(mesh), len(kept))
    first = {index: mesh for mesh in reversed(meshes) for index in [kept[_identify(mesh)]]}
    for node in nodes:
        node["mesh"] = kept[_identify(meshes[node["mesh"]])]
    return [first[index] for index in range(len(kept))]


def _identify(mesh: Document) -> tuple:
    """Return what meshes have in common that are equal but for their names."""
    parts = [json.dumps({key: value for key, value in mesh.items() if key not in ("name", "primitives")}, sort_keys=True)]
    for part in mesh["primitives"]:
        arrays = [{**part["attributes"], "indices": part["indices"]}, *part.get("targets", ())]
        values = (tuple((name, item.dtype.str, item.tobytes()) for name, item in group.items()) for group in arrays)
        parts.append((part.get("material"), *values))
    return tuple(parts)


def _move_skeletons(document: Document, start: int, names: Mapping[str, str]) -> tuple[list[Document], list[int], list[Document]]:
    """Return the joints of the skins of a document and the nodes above them that `names` has, which are the nodes from `start` on, the
    indices of those without a node above them, and the skins."""
    nodes, skins = document["nodes"], document.get("skins", ())
    parents = {child: index for index, node in enumerate(nodes) for child in node.get("children", ())}
    kept = {joint for skin in skins for joint in skin["joints"]}
    for joint in list(kept):
        while joint in parents:
            joint = parents[joint]
            kept |= {joint} if nodes[joint].get("name") in names else set()
    indices = {index: start + number for number, index in enumerate(sorted(kept))}
    moved = []
    for index in indices:
        children = [indices[child] for child in nodes[index].get("children", ()) if child in indices]
        others = {key: value for key, value in nodes[index].items() if key not in ("children", "mesh", "skin")}
        moved.append({**others, "name": names.get(others["name"], others["name"]), **({"children": children} if children else {})})
    renamed = [{**skin, "joints": [indices[joint] for joint in skin["joints"]]} for skin in skins]
    for skin in renamed:
        skin |= {"name": names.get(skin["name"], skin["name"])} if "name" in skin else {}
        skin |= {"skeleton": indices[skin["skeleton"]]} if "skeleton" in skin else {}
    return moved, [indices[index] for index in indices if parents.get(index) not in indices], renamed


def _list_extensions(document: Document, added: Collection[str], has_levels: bool) -> dict[str, list[str]]:
    """Return the extensions that a file uses, and those that a reader needs to show it correctly, `added` among them."""
    required = {*document.get("extensionsRequired", ()), *added}
    used = required | {name for name in document.get("extensionsUsed", ()) if not name.startswith(MATERIALS)}
    used |= {name for material in document["materials"] for name in material.get("extensions", {})} | ({LEVELS} if has_levels else set())
    return {"extensionsUsed": sorted(used), "extensionsRequired": sorted(required)}


def _merge(document: Document, names: Mapping[str, str], unlit: Collection[str]) -> None:
    """Give materials their final names, let those of `unlit` be shown without light, and let equal textures and materials be one."""
    textures = _keep_first(document, "textures")
    for material in document.get("materials", ()):
        material |= {"extensions": {UNLIT: {}}} if material.get("name") in unlit else {}
        material["name"] = names.get(material.get("name", ""), material.get("name", ""))
        for _, texture in list_textures(material):
            texture["index"] = textures[texture["index"]]
    materials = _keep_first(document, "materials")
    for part in _primitives(document):
        part |= {"material": materials[part["material"]]} if "material" in part else {}


def _keep_first(document: Document, key: str) -> list[int]:
    """Remove repetitions from a list of a document, and return the new index of each item."""
    kept: dict[str, int] = {}
    indices = [kept.setdefault(json.dumps(item, sort_keys=True), len(kept)) for item in document.get(key, ())]
    document[key] = [json.loads(text) for text in kept]
    return indices


def _primitives(document: Document) -> Iterator[Document]:
    for mesh in document["meshes"]:
        yield from mesh["primitives"]


def merge_images(documents: Sequence[Document]) -> None:
    """Let equal images of documents be the same object."""
    files: dict[bytes, bytes] = {}
    for image in (image for document in documents for image in document.get("images", ())):
        image["content"] = files.setdefault(image["content"], image["content"])


def list_textures(value: object) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the names of textures within a material, such as `baseColorTexture`, and what it says about them."""
    for key, item in value.items() if isinstance(value, dict) else ():
        if key.endswith("Texture"):
            yield key, item
        else:
            yield from list_textures(item)


def find_uv_map(texture: Mapping[str, Any]) -> int:
    """Return the number of the UV map by which a material places a texture."""
    return texture.get("extensions", {}).get(TEXTURE_TRANSFORM, {}).get("texCoord", texture.get("texCoord", 0))


def turn_of(placement: Mapping[str, Any]) -> np.ndarray:
    """Return the rotation (2, 2) of texture coordinates, v downwards, by KHR_texture_transform."""
    angle = placement.get("rotation", 0.0)
    return np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])


def _find_uv_grids(document: Document, largest: int) -> dict[tuple[int, int], _Grid]:
    """Return the range of the texture coordinates of all primitives, by material and number of their UV map, as far as they leave 0..1 or
    have less than 16 bits and textures use them."""
    found: dict[tuple[int, int], list[np.ndarray]] = {}
    for part in _primitives(document):
        if "material" in part:
            for uv_map in {find_uv_map(texture) for _, texture in list_textures(document["materials"][part["material"]])}:
                uvs = part["attributes"].get(f"TEXCOORD_{uv_map}")
                if uvs is not None:
                    found.setdefault((part["material"], uv_map), []).append(uvs)
    grids = {}
    for key in sorted(found):
        uvs = np.concatenate(found[key]).astype(np.float64)
        low, high = uvs.min(axis=0), uvs.max(axis=0)
        if (low < 0.0).any() or (high > 1.0).any():
            grids[key] = _Grid(low, float((high - low).max()) or 1.0, largest)
        elif largest < UNSIGNED_SHORT:
            grids[key] = _Grid(np.zeros(2), 1.0, largest)
    return grids


def _move_placement(placement: Mapping[str, Any], grid: _Grid) -> dict[str, list[float]]:
    """Return offset and scale of a texture that was placed by `placement`, for the stored values of a grid."""
    scale = np.array(placement.get("scale", (1.0, 1.0)))
    offset = turn_of(placement) @ (scale * grid.offset) + placement.get("offset", (0.0, 0.0))
    return {"offset": offset.tolist(), "scale": (scale * grid.stored_scale(UNSIGNED_SHORT)).tolist()}


def _write_primitive(part: Document, name: str, is_quantized: bool, grid: _Grid | None, uv_grids: Mapping[tuple[int, int], _Grid]) -> None:
    """Quantize the attributes of a primitive if it `is_quantized`, positions if they have a `grid`, and let equal vertices be one."""
    part["attributes"].pop("TANGENT", None)  # readers compute the same
    for target in part.get("targets", ()):
        target.pop("TANGENT", None)
    attributes = {
        key: np.asarray(values, values.dtype if key.startswith(JOINTS) else np.float32) for key, values in part["attributes"].items()
    }
    if not all(np.isfinite(values).all() for values in attributes.values()):
        raise GeometryError(f'"{name}" has coordinates or colors that are not finite; repair its mesh.')
    for key, values in part["attributes"].items() if is_quantized else ():
        uv_map = int(key.removeprefix("TEXCOORD_")) if key.startswith("TEXCOORD_") else -1
        if not key.startswith((JOINTS, WEIGHTS)) and (key != "POSITION" or grid is not None):
            attributes[key] = _quantize(key, values, grid, uv_grids.get((part.get("material", -1), uv_map)))
    targets = [{key: np.asarray(values, np.float32) for key, values in target.items()} for target in part.get("targets", ())]
    columns = [*attributes.values(), *(values for target in targets for values in target.values())]
    rows = np.concatenate([np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1) for values in columns], axis=1)
    _, first, inverse = np.unique(rows.view(f"V{rows.shape[1]}").ravel(), return_index=True, return_inverse=True)
    kept, places = np.unique(first, return_inverse=True)
    part["attributes"] = {key: values[kept] for key, values in attributes.items()}
    if targets:
        part["targets"] = [{key: values[kept] for key, values in target.items()} for target in targets]
    part["indices"] = places[inverse.ravel()][part["indices"]]


def _quantize(name: str, values: np.ndarray, grid: _Grid | None, uv_grid: _Grid | None) -> np.ndarray:
    """Return stored values of a vertex attribute: integers as fractions of the largest, or floats outside of 0..1. grid: of positions."""
    if grid is not None and name == "POSITION":
        return np.rint(grid.largest * np.clip((values - grid.offset) / grid.scale, -1.0, 1.0)).astype(np.int16)
    if name == "NORMAL":
        return np.rint(127.0 * values).astype(np.int8)
    if uv_grid is not None:
        return np.rint(uv_grid.largest * np.clip((values - uv_grid.offset) / uv_grid.scale, 0.0, 1.0)).astype(np.uint16)
    is_fraction = values.min() >= 0.0 and values.max() <= 1.0
    return np.rint(UNSIGNED_SHORT * values.astype(np.float64)).astype(np.uint16) if is_fraction else values.astype(np.float32)


def _write_node(node: LevelNode, mesh: int, grid: _Grid | None, skin: int | None) -> Document:
    matrix = np.array(node.matrix, np.float64)
    if grid is not None:
        matrix[:3, 3] += matrix[:3, :3] @ grid.offset
        matrix[:3, :3] *= grid.stored_scale(SHORT)
    place: Document = {"matrix": matrix.T.ravel().tolist()} if skin is None else {"skin": skin}  # column by column
    result: Document = {"name": node.name, "mesh": mesh, **place}
    if node.levels:
        result |= {"extensions": {LEVELS: {"ids": list(node.levels)}}, "extras": {SCREEN_COVERAGE: list(node.coverages)}}
    return result
