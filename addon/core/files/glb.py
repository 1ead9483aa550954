"""Binary glTF 2.0 files (.glb): their chunks and accessors, and writing of textured meshes in single precision.

Texture coordinates have v upwards in `GlbPrimitive`, as in Blender, and downwards in the file.
"""

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, GeometryError
from .complete_files import PNG_SIGNATURE

MAGIC, VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
MAX_FILE_BYTES = 2**32 - 1  # lengths in the header are uint32
MAX_SHORT_VERTICES = 65535  # uint16 indices: 65535 itself is reserved
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}  # NumPy type: glTF componentType
DTYPES = {component: np.dtype(f"<{name}") for name, component in COMPONENTS.items()}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
WIDTHS = {name: width for width, name in TYPES.items()}
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from Blender's axes, z upwards, to those of glTF
GENERATOR = "Farfield"
ASSET = {"version": "2.0", "generator": GENERATOR}
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
        material: index into the materials of the scene.
    """

    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    material: int | None = None


@dataclass(frozen=True, eq=False)
class GlbMesh:
    """A mesh, and the name of the node that shows it."""

    name: str
    primitives: tuple[GlbPrimitive, ...]


@dataclass(frozen=True, eq=False)
class GlbScene:
    """The content of a file. materials: as in the file; texture N shows image N. images: PNG or JPEG files as bytes."""

    meshes: tuple[GlbMesh, ...]
    materials: tuple[dict[str, Any], ...] = ()
    images: tuple[bytes, ...] = ()


@dataclass(eq=False)
class GlbBuffer:
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

    def join(self, document: dict[str, Any]) -> bytes:
        """Return a file with this buffer and the rest of its `document`.

        Raises:
            FileError: it would be larger than 4 GB. GeometryError: the document has numbers that are not finite.
        """
        document = {"asset": ASSET, "scene": 0, **{key: value for key, value in document.items() if value}}
        document |= {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": self.length}]}
        try:
            text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode("ascii")
        except ValueError as error:
            raise GeometryError("Numbers of objects or materials are not finite; reset transformations and colors.") from error
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + self.length
        if length > MAX_FILE_BYTES:
            raise FileError(f"A glTF file of {length / 1e9:.1f} GB would be larger than 4 GB; write fewer levels or smaller images.")
        chunks = [struct.pack("<4sIIII", MAGIC, VERSION, length, len(text), JSON_CHUNK), text]
        return b"".join([*chunks, struct.pack("<II", self.length, BINARY_CHUNK), *self.parts])


def encode_glb(scene: GlbScene) -> bytes:
    """Return `scene` as a binary glTF 2.0 file, with a node per mesh.

    Raises:
        FileError: it would be larger than 4 GB, or an image is neither PNG nor JPEG.
    """
    buffer = GlbBuffer()
    meshes = [{"name": mesh.name, "primitives": [_encode_primitive(buffer, part) for part in mesh.primitives]} for mesh in scene.meshes]
    images = [{"bufferView": buffer.add_view(content, {}), "mimeType": find_image_type(content)} for content in scene.images]
    nodes = [{"name": mesh.name, "mesh": index} for index, mesh in enumerate(scene.meshes)]
    document = {"scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": meshes, "materials": list(scene.materials)}
    return buffer.join({**document, "textures": [{"source": index} for index in range(len(images))], "images": images})


def split_glb(content: bytes) -> tuple[dict[str, Any], memoryview]:
    """Return the document and the binary chunk of a complete file."""
    length = struct.unpack_from("<I", content, 12)[0]
    return json.loads(content[20 : 20 + length]), memoryview(content)[28 + length :]


def read_accessor(document: dict[str, Any], binary: memoryview, index: int) -> np.ndarray:
    """Return the values (N, C) of an accessor: numbers as they are stored, or float64 from normalized integers."""
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, width = DTYPES[accessor["componentType"]], WIDTHS[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    strides = (view.get("byteStride", dtype.itemsize * width), dtype.itemsize)
    values = np.ndarray((accessor["count"], width), dtype, binary, start, strides)
    return np.maximum(values / np.iinfo(dtype).max, -1.0) if accessor.get("normalized", False) else values


def is_own_glb(path: Path) -> bool:
    """Whether `path` is a file that Farfield wrote. Raises OSError."""
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


def _encode_primitive(buffer: GlbBuffer, primitive: GlbPrimitive) -> dict[str, Any]:
    attributes = {"POSITION": buffer.add_attribute(primitive.positions.astype(np.float32), has_limits=True)}
    if primitive.normals is not None:
        attributes["NORMAL"] = buffer.add_attribute(primitive.normals.astype(np.float32))
    if primitive.uvs is not None:
        attributes["TEXCOORD_0"] = buffer.add_attribute(flip_v(primitive.uvs).astype(np.float32))
    result: dict[str, Any] = {"attributes": attributes, "indices": buffer.add_indices(primitive.triangles, len(primitive.positions))}
    return result if primitive.material is None else {**result, "material": primitive.material}


def flip_v(uvs: np.ndarray) -> np.ndarray:
    """Return texture coordinates (V, 2) float64 with v in the other direction."""
    return np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1).astype(np.float64)
