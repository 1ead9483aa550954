"""Binary glTF 2.0 files (.glb), read and written as their document with arrays and images in place of references to the binary chunk.

In such a document, `attributes`, `targets` and `indices` of primitives and `inverseBindMatrices` of skins are arrays, and images have their
file as `content`.
"""

import json
import struct
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, GeometryError
from .complete_files import PNG_SIGNATURE
from .meshopt_compression import EXTENSION, encode_rows, encode_triangles, reorder

MAGIC, VERSION = b"glTF", 2
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
MAX_FILE_BYTES = 2**32 - 1  # lengths in the header are uint32
MAX_SHORT_VERTICES = 65535  # uint16 indices: 65535 itself is reserved
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}  # NumPy type: glTF componentType
DTYPES = {component: np.dtype(f"<{name}") for name, component in COMPONENTS.items()}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
WIDTHS = {name: width for width, name in TYPES.items()}
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from Blender's axes, z upwards, to those of glTF
GENERATOR = "Farfield"
ASSET = {"version": "2.0", "generator": GENERATOR}
MAX_ASSET_BYTES = 256  # The document begins with the name of the program that wrote it.
JOINTS, WEIGHTS = "JOINTS_", "WEIGHTS_"  # beginnings of names of attributes
IMAGE_TYPES = {PNG_SIGNATURE: "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}  # first bytes of the content
WEBP = "EXT_texture_webp"
Document = dict[str, Any]


@dataclass(eq=False)
class _Buffer:
    """The binary chunk with its views and accessors, while they are collected.

    Attributes:
        is_compressed: whether arrays are compressed.
        parts: of the chunk.
        length: of the chunk, in bytes.
        plain_length: of all compressed arrays, in bytes before compression.
        views, accessors: as in the document.
        streams: of compressed arrays: their view and themselves, by bytes per row, target, and whether they are normals.
    """

    is_compressed: bool
    parts: list[bytes] = field(default_factory=list)
    length: int = 0
    plain_length: int = 0
    views: list[Document] = field(default_factory=list)
    accessors: list[Document] = field(default_factory=list)
    streams: dict[tuple[int, int, bool], tuple[int, list[np.ndarray]]] = field(default_factory=dict)

    def describe(self) -> list[Document]:
        """Return the buffers of the document: the chunk, and the one that compressed arrays would be in."""
        plain = {"byteLength": self.plain_length, "extensions": {EXTENSION: {"fallback": True}}}
        return [{"byteLength": self.length}, *([plain] if self.plain_length else [])]

    def add_view(self, content: bytes, properties: Document) -> int:
        """Append `content` at a multiple of four bytes and return the index of its view."""
        self.views.append({"buffer": 0, "byteOffset": self.length, "byteLength": len(content), **properties})
        self.append(content)
        return len(self.views) - 1

    def append(self, content: bytes) -> None:
        """Append `content` and up to three zeros."""
        padded = content + bytes(-len(content) % 4)
        self.parts.append(padded)
        self.length += len(padded)

    def add_array(self, rows: np.ndarray, properties: Document, is_normal: bool = False) -> tuple[int, int]:
        """Append an array (N, S) uint8 of rows of S bytes, and return the index of its view and where it begins there. Compressed arrays
        of one kind share a view."""
        if not self.is_compressed:
            return self.add_view(rows.tobytes(), properties), 0
        key = (rows.shape[1], properties["target"], is_normal)
        if key not in self.streams:
            self.streams[key] = (len(self.views), [])
            self.views.append(properties)
        index, parts = self.streams[key]
        parts.append(rows)
        return index, sum(part.size for part in parts[:-1])

    def finish(self) -> None:
        """Compress what is to be compressed."""
        for (stride, target, is_normal), (index, parts) in self.streams.items():
            rows = np.concatenate(parts)
            content, described = encode_triangles(rows) if target == INDEX_BUFFER else encode_rows(rows, is_normal)
            start = self.length
            self.append(content)
            place = {"buffer": 0, "byteOffset": start, "byteLength": len(content), "byteStride": stride, "count": len(rows), **described}
            plain = {"buffer": 1, "byteOffset": self.plain_length, "byteLength": rows.size, **self.views[index]}
            self.views[index] = {**plain, "extensions": {EXTENSION: place}}
            self.plain_length += rows.size + -rows.size % 4

    def add_primitive(self, part: Document) -> Document:
        """Append the arrays of a primitive, and return it with their accessors: integers of attributes are fractions of the largest, or
        joints."""
        indices, arrays, targets = part["indices"], part["attributes"], part.get("targets", [])
        if self.is_compressed:
            columns = {(number, name): values for number, group in enumerate([arrays, *targets]) for name, values in group.items()}
            indices, columns = reorder(indices, columns)
            arrays, *targets = (
                {name: values for (owner, name), values in columns.items() if owner == number} for number in range(1 + len(targets))
            )
        attributes = self.add_attributes(arrays)
        moved = {"targets": [self.add_attributes(target) for target in targets]} if targets else {}
        count = len(arrays["POSITION"])
        indices = indices.reshape(-1, 1).astype("<u2" if count <= MAX_SHORT_VERTICES else "<u4")
        place = self.add_array(indices.view(np.uint8), {"target": INDEX_BUFFER})
        return {**part, **moved, "attributes": attributes, "indices": self.add_accessor(place, indices, {})}

    def add_attributes(self, arrays: Document) -> Document:
        """Append the arrays of vertices by name, and return their accessors."""
        return {name: self.add_attribute(name, values) for name, values in arrays.items()}

    def add_attribute(self, name: str, values: np.ndarray) -> int:
        """Append an accessor for `values` (V, C) and return its index. Vertices are padded to four bytes."""
        is_float = values.dtype.kind == "f"
        values = np.ascontiguousarray(values, "<f4" if is_float else values.dtype.newbyteorder("<"))
        row = values.itemsize * values.shape[1]
        stride = row + -row % 4
        rows = np.zeros((len(values), stride), np.uint8)
        rows[:, :row] = values.view(np.uint8).reshape(len(values), row)
        is_normal = name == "NORMAL" and values.dtype == np.int8
        place = self.add_array(rows, {"byteStride": stride, "target": VERTEX_BUFFER}, is_normal)
        properties: Document = {} if is_float or name.startswith(JOINTS) else {"normalized": True}
        properties |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if name == "POSITION" else {}
        return self.add_accessor(place, values, properties)

    def add_skin(self, skin: Document) -> Document:
        """Append the matrices (J, 16) of a skin, and return it with their accessor."""
        matrices = np.ascontiguousarray(skin["inverseBindMatrices"], "<f4")
        return {**skin, "inverseBindMatrices": self.add_accessor((self.add_view(matrices.tobytes(), {}), 0), matrices, {})}

    def add_accessor(self, place: tuple[int, int], values: np.ndarray, properties: Document) -> int:
        """Append an accessor for what a view holds from a byte on, and return its index."""
        component = COMPONENTS[values.dtype.str[1:]]
        start = {"byteOffset": place[1]} if place[1] else {}
        described = {"componentType": component, "count": len(values), "type": TYPES[values.shape[1]]}
        self.accessors.append({"bufferView": place[0], **start, **described, **properties})
        return len(self.accessors) - 1


def save_glb(document: Document, is_compressed: bool = False) -> bytes:
    """Return a document as a file of Farfield. Floats get single precision. The same document gives the same bytes.

    is_compressed: whether meshes are compressed (EXT_meshopt_compression).

    Raises:
        FileError: it would be larger than 4 GB, or an image is neither PNG, JPEG nor WebP.
        GeometryError: it has numbers that are not finite.
    """
    buffer = _Buffer(is_compressed)
    meshes = [{**mesh, "primitives": [buffer.add_primitive(part) for part in mesh["primitives"]]} for mesh in document["meshes"]]
    skins = [buffer.add_skin(skin) for skin in document.get("skins", ())]
    buffer.finish()
    images = [{**image, "bufferView": buffer.add_view(image["content"], {})} for image in document.get("images", ())]
    for image in images:
        image["mimeType"] = find_image_type(image.pop("content"))
    result = {"asset": ASSET, "scene": 0, **{key: value for key, value in document.items() if value}, "meshes": meshes}
    result |= ({"images": images} if images else {}) | ({"skins": skins} if skins else {})
    _mark_webp(result)
    _require(result, [EXTENSION] if buffer.plain_length else [])
    result |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": buffer.describe()}
    try:
        text = json.dumps(result, separators=(",", ":"), allow_nan=False).encode("ascii")
    except ValueError as error:
        raise GeometryError("Numbers of objects or materials are not finite; reset transformations and colors.") from error
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + buffer.length
    if length > MAX_FILE_BYTES:
        raise FileError(f"A glTF file of {length / 1e9:.1f} GB would be larger than 4 GB; write fewer levels or smaller images.")
    chunks = [struct.pack("<4sIIII", MAGIC, VERSION, length, len(text), JSON_CHUNK), text]
    return b"".join([*chunks, struct.pack("<II", buffer.length, BINARY_CHUNK), *buffer.parts])


def _mark_webp(document: Document) -> None:
    """Let textures with WebP images name these as an extension prescribes, which readers then need."""
    images = document.get("images", ())
    textures = [
        {**{key: value for key, value in texture.items() if key != "source"}, "extensions": {WEBP: {"source": texture["source"]}}}
        if "source" in texture and images[texture["source"]]["mimeType"] == "image/webp"
        else texture
        for texture in document.get("textures", ())
    ]
    if any(WEBP in texture.get("extensions", {}) for texture in textures):
        document["textures"] = textures
        _require(document, [WEBP])


def _require(document: Document, extensions: Collection[str]) -> None:
    """Let readers need extensions."""
    for key in ("extensionsUsed", "extensionsRequired") if extensions else ():
        document[key] = sorted({*document.get(key, ()), *extensions})


def load_glb(content: bytes) -> Document:
    """Return the document of a complete file that refers to no other file. Normalized integers become float64."""
    length = struct.unpack_from("<I", content, 12)[0]
    document, binary = json.loads(content[20 : 20 + length]), memoryview(content)[28 + length :]
    for part in (part for mesh in document["meshes"] for part in mesh["primitives"]):
        for arrays in (part["attributes"], *part.get("targets", ())):
            arrays |= {name: _read_accessor(document, binary, index) for name, index in arrays.items()}
        part["indices"] = _read_accessor(document, binary, part["indices"]).ravel().astype(np.int64)
    for texture in document.get("textures", ()):
        texture |= texture.get("extensions", {}).get(WEBP, {})
    for skin in document.get("skins", ()):
        skin["inverseBindMatrices"] = _read_accessor(document, binary, skin["inverseBindMatrices"])
    for image in document.get("images", ()):
        view = document["bufferViews"][image.pop("bufferView")]
        image["content"] = bytes(binary[view.get("byteOffset", 0) :][: view["byteLength"]])
    return {key: value for key, value in document.items() if key not in ("asset", "accessors", "bufferViews", "buffers")}


def _read_accessor(document: Document, binary: memoryview, index: int) -> np.ndarray:
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
        FileError: it is neither PNG, JPEG nor WebP.
    """
    for start, name in IMAGE_TYPES.items():
        if content.startswith(start):
            return name
    raise FileError("An image for a glTF file is neither PNG, JPEG nor WebP; encode it as one of them.")
