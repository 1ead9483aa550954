"""Reading of binary glTF 2.0 files: triangles with positions, normals, texture coordinates, colors, base color textures, and levels."""

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from farfield.addon.core.errors import FileError
from farfield.addon.core.files.file_access import check_readable, convert_os_errors
from farfield.addon.core.files.glb import (
    BINARY_CHUNK,
    COMPONENTS,
    JSON_CHUNK,
    LEVELS,
    MAGIC,
    QUANTIZATION,
    SCREEN_COVERAGE,
    TYPES,
    VERSION,
    GlbMesh,
    GlbNode,
    GlbPrimitive,
    GlbScene,
    flip_v,
)
from farfield.addon.core.files.glb_materials import NEAREST, OPAQUE, TEXTURE_TRANSFORM, UNLIT, WRAPS, GlbMaterial, GlbTexture

READABLE_EXTENSIONS = {QUANTIZATION, TEXTURE_TRANSFORM, LEVELS, UNLIT}
DTYPES = {component: np.dtype(f"<{name}") for name, component in COMPONENTS.items()}
COUNTS = {name: count for count, name in TYPES.items()}
TRIANGLES = 4  # primitive mode
MAX_INDEX = 2**31 - 1
MAX_EXPANSION = 64  # bytes of all arrays and images relative to the file, whose parts can be used repeatedly
# What JSON raises that is not as glTF prescribes.
DAMAGES = (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError)


@dataclass(eq=False)
class _Reader:
    """The document and the binary chunk of one file, with the arrays made so far, so that primitives which share data share arrays."""

    path: Path
    document: dict[str, Any]
    binary: bytes
    arrays: dict[tuple[object, ...], np.ndarray] = field(default_factory=dict)
    byte_count: int = 0

    def fail(self, problem: str) -> FileError:
        return FileError(f'"{self.path}" cannot be read: {problem}; export it again as one .glb file.')

    def get(self, kind: str, index: int) -> dict[str, Any]:
        """Return the object `index` of the top-level list `kind`."""
        items = self.document.get(kind, [])
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(items):
            raise self.fail(f"it refers to {kind} {index}, but has {len(items)}")
        return items[index]

    def read_view(self, index: int) -> tuple[memoryview, int | None]:
        """Return the bytes of a buffer view and its stride."""
        view = self.get("bufferViews", index)
        buffer = self.get("buffers", view["buffer"])
        if view["buffer"] != 0 or "uri" in buffer:
            raise self.fail("its data are in other files")
        start, length = view.get("byteOffset", 0), view["byteLength"]
        if not 0 <= start <= start + length <= len(self.binary):
            raise self.fail("it is truncated or damaged")
        return memoryview(self.binary)[start : start + length], view.get("byteStride")

    def count_bytes(self, count: int) -> None:
        """Add `count` to the bytes that were made from the file.

        Raises:
            FileError: a small file would fill the memory.
        """
        self.byte_count += count
        if self.byte_count > MAX_EXPANSION * len(self.binary):
            raise self.fail("it uses the same data too often")

    def reuse(self, key: tuple[object, ...], make: Callable[[], np.ndarray]) -> np.ndarray:
        """Return the array with this key, made at the first call."""
        if key not in self.arrays:
            self.arrays[key] = make()
            self.count_bytes(self.arrays[key].nbytes)
        return self.arrays[key]

    def read_accessor(self, index: int) -> np.ndarray:
        """Return the values (N, C) float64 of an accessor, normalized if it says so."""
        return self.reuse(("values", index), lambda: self._decode(self.get("accessors", index), False))

    def read_triangles(self, index: int) -> np.ndarray:
        """Return the triangles (T, 3) int32 of an accessor with indices."""
        return self.reuse(("triangles", index), lambda: self._decode(self.get("accessors", index), True))

    def _decode(self, accessor: dict[str, Any], is_integer: bool) -> np.ndarray:
        if "sparse" in accessor or "bufferView" not in accessor:
            raise self.fail("it has sparse data, which Farfield does not read")
        content, stride = self.read_view(accessor["bufferView"])
        dtype, columns, count = DTYPES[accessor["componentType"]], COUNTS[accessor["type"]], accessor["count"]
        row, offset = dtype.itemsize * columns, accessor.get("byteOffset", 0)
        stride = row if stride is None else stride
        if count < 1 or stride < row or offset < 0 or offset + (count - 1) * stride + row > len(content):
            raise self.fail("it is truncated or damaged")
        values = np.ndarray((count, columns), dtype, content, offset, (stride, dtype.itemsize))
        if is_integer:
            if dtype.kind != "u" or columns != 1 or count % 3 or values.max() > MAX_INDEX:
                raise self.fail("its indices are not those of triangles")
            return values.reshape(-1, 3).astype(np.int32)
        result = values.astype(np.float64)
        if accessor.get("normalized", False) and dtype.kind in "iu":
            result = np.maximum(result / np.iinfo(dtype).max, -1.0)
        if not np.isfinite(result).all():
            raise self.fail("it contains numbers that are not finite")
        return result


def read_glb(path: Path) -> GlbScene:
    """Return the content of a binary glTF 2.0 file.

    Nodes with meshes are listed in the order of the file, with matrices to the world; their parents are applied. Other content, such as
    animations, cameras, lights, points and lines, is ignored. Texture coordinates are those of the base color texture, with its transform.

    Raises:
        FileError: the file cannot be read, is damaged, refers to other files, or needs an extension that Farfield does not read.
    """
    check_readable(path)
    with convert_os_errors(f'Cannot read "{path}"'):
        content = path.read_bytes()
    reader = _Reader(path, *_split_chunks(path, content))
    try:
        return _read_scene(reader)
    except DAMAGES as error:
        raise reader.fail("its description is damaged") from error


def _split_chunks(path: Path, content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the document and the binary chunk, b"" if there is none."""
    damaged = FileError(f'"{path}" is not a complete binary glTF 2.0 file (.glb); export it again.')
    if len(content) < 20:
        raise damaged
    magic, version, length = struct.unpack_from("<4sII", content)
    if magic != MAGIC or version != VERSION or not 20 <= length <= len(content):
        raise damaged
    chunks: dict[int, bytes] = {}
    position = 12
    while position + 8 <= length:
        size, kind = struct.unpack_from("<II", content, position)
        if position + 8 + size > length:
            raise damaged
        chunks.setdefault(kind, content[position + 8 : position + 8 + size])
        position += 8 + size
    try:
        document = json.loads(chunks.get(JSON_CHUNK, b""))
    except (ValueError, RecursionError) as error:
        raise damaged from error
    if not isinstance(document, dict):
        raise damaged
    return document, chunks.get(BINARY_CHUNK, b"")


def _read_scene(reader: _Reader) -> GlbScene:
    unknown = sorted(set(reader.document.get("extensionsRequired", [])) - READABLE_EXTENSIONS)
    if unknown:
        raise reader.fail(f"it needs the extension {unknown[0]}, which Farfield does not read")
    transforms = []
    materials = []
    for material in reader.document.get("materials", []):
        read, transform = _read_material(reader, material)
        materials.append(read)
        transforms.append(transform)
    meshes = [
        GlbMesh(str(mesh.get("name", "")), tuple(_read_primitives(reader, mesh, transforms))) for mesh in reader.document.get("meshes", [])
    ]
    images = []
    for image in reader.document.get("images", []):
        if "bufferView" not in image:
            raise reader.fail("its images are in other files")
        view, _ = reader.read_view(image["bufferView"])
        reader.count_bytes(len(view))
        images.append(bytes(view))
    return GlbScene(tuple(_read_nodes(reader)), tuple(meshes), tuple(materials), tuple(images))


def _read_material(reader: _Reader, material: dict[str, Any]) -> tuple[GlbMaterial, tuple[int, np.ndarray]]:
    """Return a material, and the index of the texture coordinates of its texture with their transform (2, 3)."""
    surface = material.get("pbrMetallicRoughness", {})
    factor = tuple(float(value) for value in surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0)))
    if len(factor) != 4:
        raise reader.fail("a base color has no four values")
    image, uv_set, transform = None, 0, np.eye(2, 3)
    texture = surface.get("baseColorTexture")
    if texture is not None:
        image = reader.get("textures", texture["index"]).get("source")
        if image is not None:
            reader.get("images", image)
        extension = texture.get("extensions", {}).get(TEXTURE_TRANSFORM, {})
        uv_set = int(extension.get("texCoord", texture.get("texCoord", 0)))
        angle, scale = float(extension.get("rotation", 0.0)), np.array(extension.get("scale", (1.0, 1.0)), np.float64)
        rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])  # v is downwards
        transform = np.column_stack([rotation * scale, np.array(extension.get("offset", (0.0, 0.0)), np.float64)])
    name, is_double_sided = str(material.get("name", "")), bool(material.get("doubleSided", False))
    texture = None if image is None else GlbTexture(image, *_read_sampler(reader, texture["index"]))
    mode, cutoff = str(material.get("alphaMode", OPAQUE)), float(material.get("alphaCutoff", 0.5))
    is_unlit = UNLIT in material.get("extensions", {})
    return GlbMaterial(name, factor, texture, is_double_sided, mode, cutoff, is_unlit), (uv_set, transform)


def _read_sampler(reader: _Reader, texture: int) -> tuple[tuple[str, str], bool]:
    """Return how a texture is wrapped, and whether its pixels are squares."""
    index = reader.get("textures", texture).get("sampler")
    sampler = {} if index is None else reader.get("samplers", index)
    names = {code: name for name, code in WRAPS.items()}
    wraps = tuple(names[sampler.get(key, WRAPS["repeat"])] for key in ("wrapS", "wrapT"))
    return wraps, sampler.get("magFilter") == NEAREST


def _read_primitives(reader: _Reader, mesh: dict[str, Any], transforms: list[tuple[int, np.ndarray]]) -> list[GlbPrimitive]:
    primitives = []
    for primitive in mesh["primitives"]:
        if primitive.get("mode", TRIANGLES) != TRIANGLES:
            continue
        attributes, material = primitive["attributes"], primitive.get("material")
        if material is not None:
            reader.get("materials", material)
        uv_set, transform = transforms[material] if material is not None else (0, np.eye(2, 3))
        positions = reader.read_accessor(attributes["POSITION"])
        values = {}
        for name, key, widths in (("normals", "NORMAL", (3,)), ("uvs", f"TEXCOORD_{uv_set}", (2,)), ("colors", "COLOR_0", (3, 4))):
            values[name] = reader.read_accessor(attributes[key]) if key in attributes else None
            if values[name] is not None and (values[name].shape[1] not in widths or len(values[name]) != len(positions)):
                raise reader.fail(f"its {name} do not fit its vertices")
        if values["uvs"] is not None:
            values["uvs"] = _transform_uvs(reader, attributes[f"TEXCOORD_{uv_set}"], transform)
        if "indices" in primitive:
            triangles = reader.read_triangles(primitive["indices"])
        else:
            triangles = reader.reuse(("soup", len(positions)), partial(_soup_triangles, len(positions)))
        if positions.shape[1] != 3 or not len(triangles) or triangles.max() >= len(positions):
            raise reader.fail("its triangles do not fit its vertices")
        primitives.append(GlbPrimitive(positions, triangles, values["normals"], values["uvs"], values["colors"], material))
    return primitives


def _transform_uvs(reader: _Reader, accessor: int, transform: np.ndarray) -> np.ndarray:
    """Return texture coordinates (V, 2) with v upwards, transformed as the material prescribes."""
    uvs = reader.read_accessor(accessor)
    return reader.reuse(("uvs", accessor, transform.tobytes()), lambda: flip_v(uvs @ transform[:, :2].T + transform[:, 2]))


def _soup_triangles(vertex_count: int) -> np.ndarray:
    """Return triangles (T, 3) int32 without shared vertices. A last incomplete one is ignored, as glTF prescribes."""
    return np.arange(vertex_count - vertex_count % 3, dtype=np.int32).reshape(-1, 3)


def _read_nodes(reader: _Reader) -> list[GlbNode]:
    """Return the nodes with meshes, with matrices to the world."""
    nodes = reader.document.get("nodes", [])
    parents = np.full(len(nodes), -1)
    for index, node in enumerate(nodes):
        for child in node.get("children", []):
            reader.get("nodes", child)
            if parents[child] != -1:
                raise reader.fail("a node has several parents")
            parents[child] = index
    with_mesh = [index for index, node in enumerate(nodes) if "mesh" in node]
    positions = {index: position for position, index in enumerate(with_mesh)}
    matrices = _world_matrices(reader, [_local_matrix(reader, node) for node in nodes], parents)
    result = []
    for index in with_mesh:
        node = nodes[index]
        reader.get("meshes", node["mesh"])
        levels = node.get("extensions", {}).get(LEVELS, {}).get("ids", [])
        levels = tuple(positions[level] for level in levels)
        coverages = tuple(float(value) for value in (node.get("extras") or {}).get(SCREEN_COVERAGE, ())) if levels else ()
        result.append(GlbNode(str(node.get("name", "")), node["mesh"], matrices[index], levels, coverages))
    return result


def _world_matrices(reader: _Reader, local: list[np.ndarray], parents: np.ndarray) -> list[np.ndarray]:
    """Return the matrices (4, 4) from nodes to the world, parents first."""
    matrices: list[np.ndarray | None] = [None] * len(local)
    for start in range(len(local)):
        chain, index = [], start
        while index != -1 and matrices[index] is None:
            chain.append(index)
            if len(chain) > len(local):
                raise reader.fail("its nodes form a cycle")
            index = parents[index]
        for index in reversed(chain):
            parent = parents[index]
            matrices[index] = local[index] if parent == -1 else matrices[parent] @ local[index]
    return matrices


def _local_matrix(reader: _Reader, node: dict[str, Any]) -> np.ndarray:
    """Return the matrix (4, 4) of a node to its parent."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
    else:
        x, y, z, w = (float(value) for value in node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
        matrix = np.eye(4)
        matrix[:3, :3] = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
        matrix[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
        matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    if not np.isfinite(matrix).all():
        raise reader.fail("it contains numbers that are not finite")
    return matrix
