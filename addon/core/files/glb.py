"""Binary glTF 2.0 files (.glb): textured meshes, plain or quantized (KHR_mesh_quantization), with levels of detail (MSFT_lod).

The same scene gives the same bytes. Texture coordinates have v upwards here, as in Blender, and downwards in the file.

Blender's own exporter writes no levels of detail, and packages for glTF leave quantization, which must not open cracks between meshes, to
their callers.
"""

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, GeometryError
from .complete_files import PNG_SIGNATURE
from .glb_materials import TEXTURE_TRANSFORM, UNIT_RANGE, UNLIT, GlbMaterial, UvRange, encode_materials

MAGIC, VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
MAX_FILE_BYTES = 2**32 - 1  # lengths in the header are uint32
MAX_SHORT_VERTICES = 65535  # uint16 indices: 65535 itself is reserved
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}  # NumPy type: glTF componentType
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
QUANTIZATION, LEVELS = "KHR_mesh_quantization", "MSFT_lod"
SCREEN_COVERAGE = "MSFT_screencoverage"
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from Blender's axes, z upwards, to those of glTF
GENERATOR = "Farfield"
MAX_ASSET_BYTES = 256  # The document begins with the name of the program that wrote it.
IMAGE_TYPES = {PNG_SIGNATURE: "image/png", b"\xff\xd8\xff": "image/jpeg"}  # first bytes of the content


@dataclass(frozen=True, eq=False)
class GlbPrimitive:
    """Triangles with one material.

    Attributes:
        positions: (V, 3) floats, y upwards as in glTF, in any unit (meters by its convention).
        triangles: (T, 3) integers into the vertices, counter-clockwise seen from outside.
        normals: (V, 3), unit vectors.
        uvs: (V, 2), v upwards.
        colors: (V, 3 or 4), scene-linear.
        material: index into the materials of the scene.
    """

    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    colors: np.ndarray | None = None
    material: int | None = None


@dataclass(frozen=True, eq=False)
class GlbMesh:
    """A mesh. bounds: (2, 3), the lowest and highest position that quantized positions can represent, None for those of the mesh: meshes
    with the same bounds round equal positions to equal ones."""

    name: str
    primitives: tuple[GlbPrimitive, ...]
    bounds: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class GlbNode:
    """A mesh in the scene.

    Attributes:
        name: any text.
        mesh: index into the meshes of the scene.
        matrix: (4, 4), from the mesh to the world; None if they are the same.
        levels: indices of the nodes that replace this one as it covers less of the image, finest first.
        coverages: of the node itself and of each level, the fraction of the image down to which it shows.
    """

    name: str
    mesh: int
    matrix: np.ndarray | None = None
    levels: tuple[int, ...] = ()
    coverages: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class GlbScene:
    """The content of a file. images: PNG or JPEG files as bytes. Nodes that are levels of others do not show by themselves."""

    nodes: tuple[GlbNode, ...]
    meshes: tuple[GlbMesh, ...]
    materials: tuple[GlbMaterial, ...] = ()
    images: tuple[bytes, ...] = ()


@dataclass(eq=False)
class _Buffer:
    """The binary chunk with its views and accessors, while they are collected."""

    parts: list[bytes] = field(default_factory=list)
    length: int = 0
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)

    def add_view(self, content: bytes, properties: dict[str, Any]) -> int:
        """Append `content` at a multiple of four bytes and return the index of its view."""
        self.views.append({"buffer": 0, "byteOffset": self.length, "byteLength": len(content), **properties})
        padded = content + bytes(-len(content) % 4)
        self.parts.append(padded)
        self.length += len(padded)
        return len(self.views) - 1

    def add_indices(self, triangles: np.ndarray, vertex_count: int) -> int:
        """Append an accessor for the corners of `triangles`, and return its index."""
        values = triangles.reshape(-1, 1).astype("<u2" if vertex_count <= MAX_SHORT_VERTICES else "<u4")
        view = self.add_view(values.tobytes(), {"target": INDEX_BUFFER})
        return self._add_accessor(view, values, {})

    def add_attribute(self, values: np.ndarray, is_normalized: bool = False, has_limits: bool = False) -> int:
        """Append an accessor for `values` (V, C) of a type in COMPONENTS, and return its index. Vertices are padded to four bytes."""
        row = values.itemsize * values.shape[1]
        stride = row + -row % 4
        rows = np.zeros((len(values), stride), np.uint8)
        rows[:, :row] = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).view(np.uint8).reshape(len(values), row)
        view = self.add_view(rows.tobytes(), {"byteStride": stride, "target": VERTEX_BUFFER})
        properties: dict[str, Any] = {"normalized": True} if is_normalized else {}
        if has_limits:
            properties |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self._add_accessor(view, values, properties)

    def _add_accessor(self, view: int, values: np.ndarray, properties: dict[str, Any]) -> int:
        component = COMPONENTS[values.dtype.str[1:]]
        shape = {"componentType": component, "count": len(values), "type": TYPES[values.shape[1]]}
        self.accessors.append({"bufferView": view, **shape, **properties})
        return len(self.accessors) - 1


def encode_glb(scene: GlbScene, is_quantized: bool = False) -> bytes:
    """Return `scene` as a binary glTF 2.0 file.

    is_quantized: store positions in 16 bits with the transform of the node, texture coordinates in 16 bits, normals in 8 bits and colors
    in 16 bits, where they are within 0..1. Texture coordinates outside of 0..1 are scaled by the material (KHR_texture_transform); without
    a texture they remain single precision.

    Raises:
        FileError: it would be larger than 4 GB, or an image is neither PNG nor JPEG.
        GeometryError: a mesh has no triangles, refers to vertices or materials that do not exist, or has values that are not finite.
    """
    for mesh in scene.meshes:
        _check_mesh(mesh, len(scene.materials))
    buffer = _Buffer()
    ranges = [_find_uv_range(scene, index) if is_quantized else UNIT_RANGE for index in range(len(scene.materials))]
    grids = [_position_grid(mesh) for mesh in scene.meshes] if is_quantized else [None] * len(scene.meshes)
    meshes = []
    for mesh, grid in zip(scene.meshes, grids, strict=True):
        primitives = [_encode_primitive(buffer, primitive, grid, ranges) for primitive in mesh.primitives]
        meshes.append({"name": mesh.name, "primitives": primitives})
    images = [{"bufferView": buffer.add_view(content, {}), "mimeType": find_image_type(content)} for content in scene.images]
    levels = {index for node in scene.nodes for index in node.levels}
    document: dict[str, Any] = {"asset": {"version": "2.0", "generator": GENERATOR}}
    used, required = _list_extensions(scene, is_quantized, ranges)
    document |= {"extensionsUsed": used} if used else {}
    document |= {"extensionsRequired": required} if required else {}
    document |= {"scene": 0, "scenes": [{"nodes": [index for index in range(len(scene.nodes)) if index not in levels]}]}
    document |= {"nodes": [_encode_node(node, grids[node.mesh]) for node in scene.nodes], "meshes": meshes}
    described = {**encode_materials(scene.materials, ranges), "images": images}
    document |= {key: described[key] for key in ("materials", "textures", "images", "samplers") if described.get(key)}
    document |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": buffer.length}]}
    return _join_chunks(document, b"".join(buffer.parts))


def is_own_glb(path: Path) -> bool:
    """Whether `path` is a file that this module wrote. Raises OSError."""
    with path.open("rb") as file:
        start = file.read(MAX_ASSET_BYTES)
    return start.startswith(MAGIC) and f'"{GENERATOR}"'.encode() in start


def find_image_type(content: bytes) -> str:
    """Return the media type of an image file in memory.

    Raises:
        FileError: it is neither PNG nor JPEG.
    """
    for start, name in IMAGE_TYPES.items():
        if content.startswith(start):
            return name
    raise FileError("An image for a glTF file is neither PNG nor JPEG; encode it as one of them.")


def _check_mesh(mesh: GlbMesh, material_count: int) -> None:
    for primitive in mesh.primitives:
        count = len(primitive.positions)
        if not len(primitive.triangles):
            raise GeometryError(f'"{mesh.name}" has no triangles to write; choose an object with a surface.')
        if primitive.triangles.min() < 0 or primitive.triangles.max() >= count:
            raise GeometryError(f'"{mesh.name}" has triangles with vertices that do not exist; there are {count}.')
        if primitive.material is not None and not 0 <= primitive.material < material_count:
            raise GeometryError(f'"{mesh.name}" refers to material {primitive.material}, but there are {material_count}.')
        for name in ("positions", "normals", "uvs", "colors"):
            values = getattr(primitive, name)
            if values is not None and (len(values) != count or not np.isfinite(values).all()):
                raise GeometryError(
                    f'"{mesh.name}" has {len(values)} {name} for {count} vertices, or some that are not finite; repair them.'
                )
    if not mesh.primitives:
        raise GeometryError(f'"{mesh.name}" has no triangles to write; choose an object with a surface.')


def _position_grid(mesh: GlbMesh) -> tuple[np.ndarray, float]:
    """Return center (3,) and half side of the cube that quantized positions fill. A cube, so that normals are not distorted."""
    bounds = mesh.bounds
    if bounds is None:
        lows, highs = zip(*((part.positions.min(axis=0), part.positions.max(axis=0)) for part in mesh.primitives), strict=True)
        bounds = np.stack([np.min(lows, axis=0), np.max(highs, axis=0)])
    low, high = np.asarray(bounds, np.float64)
    return 0.5 * (low + high), float(0.5 * (high - low).max()) or 1.0


def _find_uv_range(scene: GlbScene, material: int) -> UvRange:
    """Return the range of the texture coordinates of all primitives with a textured material; the unit square if they are within."""
    used = [part.uvs for mesh in scene.meshes for part in mesh.primitives if part.material == material and part.uvs is not None]
    if scene.materials[material].texture is None or not used:
        return UNIT_RANGE
    stored = np.concatenate([flip_v(uvs) for uvs in used])
    low, high = stored.min(axis=0), stored.max(axis=0)
    if (low >= 0.0).all() and (high <= 1.0).all():
        return UNIT_RANGE
    scale = np.where(high > low, high - low, 1.0)
    return UvRange(tuple(low.tolist()), tuple(scale.tolist()))


def _encode_primitive(
    buffer: _Buffer, primitive: GlbPrimitive, grid: tuple[np.ndarray, float] | None, ranges: list[UvRange]
) -> dict[str, Any]:
    attributes = {}
    if grid is None:
        attributes["POSITION"] = buffer.add_attribute(primitive.positions.astype(np.float32), has_limits=True)
    else:
        relative = np.clip((primitive.positions - grid[0]) / grid[1], -1.0, 1.0)
        attributes["POSITION"] = buffer.add_attribute(np.rint(32767.0 * relative).astype(np.int16), True, has_limits=True)
    if primitive.normals is not None:
        is_byte = grid is not None
        values = np.rint(127.0 * primitive.normals).astype(np.int8) if is_byte else primitive.normals.astype(np.float32)
        attributes["NORMAL"] = buffer.add_attribute(values, is_byte)
    if primitive.uvs is not None:
        uv_range = UNIT_RANGE if primitive.material is None else ranges[primitive.material]
        attributes["TEXCOORD_0"] = _encode_fractions(buffer, (flip_v(primitive.uvs) - uv_range.offset) / uv_range.scale, grid is not None)
    if primitive.colors is not None:
        attributes["COLOR_0"] = _encode_fractions(buffer, primitive.colors, grid is not None)
    result: dict[str, Any] = {"attributes": attributes, "indices": buffer.add_indices(primitive.triangles, len(primitive.positions))}
    return result if primitive.material is None else {**result, "material": primitive.material}


def _encode_fractions(buffer: _Buffer, values: np.ndarray, is_quantized: bool) -> int:
    """Return the accessor of `values` (V, C): uint16 if quantized and all within 0..1, single precision otherwise."""
    if is_quantized and values.min() >= 0.0 and values.max() <= 1.0:
        return buffer.add_attribute(np.rint(65535.0 * values).astype(np.uint16), True)
    return buffer.add_attribute(values.astype(np.float32))


def _encode_node(node: GlbNode, grid: tuple[np.ndarray, float] | None) -> dict[str, Any]:
    result: dict[str, Any] = {"name": node.name, "mesh": node.mesh}
    if node.matrix is not None:
        matrix = np.array(node.matrix, np.float64)
        if grid is not None:
            matrix[:3, 3] += matrix[:3, :3] @ grid[0]
            matrix[:3, :3] *= grid[1]
        result["matrix"] = matrix.T.ravel().tolist()  # column by column
    elif grid is not None:
        result |= {"translation": grid[0].tolist(), "scale": [grid[1]] * 3}
    if node.levels:
        result["extensions"] = {LEVELS: {"ids": list(node.levels)}}
        result |= {"extras": {SCREEN_COVERAGE: list(node.coverages)}} if node.coverages else {}
    return result


def _list_extensions(scene: GlbScene, is_quantized: bool, ranges: list[UvRange]) -> tuple[list[str], list[str]]:
    """Return the extensions that the file uses, and those that a reader needs to show it correctly."""
    required = [QUANTIZATION] if is_quantized else []
    is_placed = any(material.texture is not None and material.texture.placement is not None for material in scene.materials)
    required += [TEXTURE_TRANSFORM] if is_placed or any(uv_range != UNIT_RANGE for uv_range in ranges) else []
    optional = [LEVELS] if any(node.levels for node in scene.nodes) else []
    optional += [UNLIT] if any(material.is_unlit for material in scene.materials) else []
    return required + optional, required


def flip_v(uvs: np.ndarray) -> np.ndarray:
    """Return texture coordinates (V, 2) float64 with v in the other direction."""
    return np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1).astype(np.float64)


def _join_chunks(document: dict[str, Any], binary: bytes) -> bytes:
    try:
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode("ascii")
    except ValueError as error:
        raise GeometryError("Numbers of objects or materials are not finite; reset transformations and colors.") from error
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    if length > MAX_FILE_BYTES:
        raise FileError(f"A glTF file of {length / 1e9:.1f} GB would be larger than 4 GB; write fewer levels or smaller images.")
    header = struct.pack("<4sII", MAGIC, VERSION, length)
    return b"".join([header, struct.pack("<II", len(text), JSON_CHUNK), text, struct.pack("<II", len(binary), BINARY_CHUNK), binary])
