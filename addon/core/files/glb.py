"""Binary glTF 2.0 files (.glb), read and written as their document with arrays and images in place of references to the binary chunk.

In such a document, `attributes`, `targets` and `indices` of primitives and `inverseBindMatrices` of skins are arrays, and images have their
file as `content`.
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
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
WIDTHS = {name: width for width, name in TYPES.items()}
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from Blender's axes, z upwards, to those of glTF
GENERATOR = "Farfield"
ASSET = {"version": "2.0", "generator": GENERATOR}
MAX_ASSET_BYTES = 256  # The document begins with the name of the program that wrote it.
JOINTS, WEIGHTS = "JOINTS_", "WEIGHTS_"  # beginnings of names of attributes
IMAGE_TYPES = {PNG_SIGNATURE: "image/png", b"\xff\xd8\xff": "image/jpeg"}  # first bytes of the content
Document = dict[str, Any]


@dataclass(eq=False)
class _Buffer:
    """The binary chunk with its views and accessors, while they are collected."""

    parts: list[bytes] = field(default_factory=list)
    length: int = 0
    views: list[Document] = field(default_factory=list)
    accessors: list[Document] = field(default_factory=list)

    def add_view(self, content: bytes, properties: Document) -> int:
        """Append `content` at a multiple of four bytes and return the index of its view."""
        self.views.append({"buffer": 0, "byteOffset": self.length, "byteLength": len(content), **properties})
        padded = content + bytes(-len(content) % 4)
        self.parts.append(padded)
        self.length += len(padded)
        return len(self.views) - 1

    def add_primitive(self, part: Document) -> Document:
        """Append the arrays of a primitive, and return it with their accessors: integers of attributes are fractions of the largest, or
        joints."""
        attributes = self.add_attributes(part["attributes"])
        targets = {"targets": [self.add_attributes(target) for target in part["targets"]]} if "targets" in part else {}
        count = len(part["attributes"]["POSITION"])
        indices = part["indices"].reshape(-1, 1).astype("<u2" if count <= MAX_SHORT_VERTICES else "<u4")
        view = self.add_view(indices.tobytes(), {"target": INDEX_BUFFER})
        return {**part, **targets, "attributes": attributes, "indices": self.add_accessor(view, indices, {})}

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
        view = self.add_view(rows.tobytes(), {"byteStride": stride, "target": VERTEX_BUFFER})
        properties: Document = {} if is_float or name.startswith(JOINTS) else {"normalized": True}
        properties |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if name == "POSITION" else {}
        return self.add_accessor(view, values, properties)

    def add_skin(self, skin: Document) -> Document:
        """Append the matrices (J, 16) of a skin, and return it with their accessor."""
        matrices = np.ascontiguousarray(skin["inverseBindMatrices"], "<f4")
        return {**skin, "inverseBindMatrices": self.add_accessor(self.add_view(matrices.tobytes(), {}), matrices, {})}

    def add_accessor(self, view: int, values: np.ndarray, properties: Document) -> int:
        """Append an accessor for what a view holds, and return its index."""
        component = COMPONENTS[values.dtype.str[1:]]
        self.accessors.append(
            {"bufferView": view, "componentType": component, "count": len(values), "type": TYPES[values.shape[1]], **properties}
        )
        return len(self.accessors) - 1


def save_glb(document: Document) -> bytes:
    """Return a document as a file of Farfield. Floats get single precision. The same document gives the same bytes.

    Raises:
        FileError: it would be larger than 4 GB, or an image is neither PNG nor JPEG. GeometryError: it has numbers that are not finite.
    """
    buffer = _Buffer()
    meshes = [{**mesh, "primitives": [buffer.add_primitive(part) for part in mesh["primitives"]]} for mesh in document["meshes"]]
    skins = [buffer.add_skin(skin) for skin in document.get("skins", ())]
    images = [{**image, "bufferView": buffer.add_view(image["content"], {})} for image in document.get("images", ())]
    for image in images:
        image["mimeType"] = find_image_type(image.pop("content"))
    result = {"asset": ASSET, "scene": 0, **{key: value for key, value in document.items() if value}, "meshes": meshes}
    result |= ({"images": images} if images else {}) | ({"skins": skins} if skins else {})
    result |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": buffer.length}]}
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


def load_glb(content: bytes) -> Document:
    """Return the document of a complete file that refers to no other file. Normalized integers become float64."""
    length = struct.unpack_from("<I", content, 12)[0]
    document, binary = json.loads(content[20 : 20 + length]), memoryview(content)[28 + length :]
    for part in (part for mesh in document["meshes"] for part in mesh["primitives"]):
        for arrays in (part["attributes"], *part.get("targets", ())):
            arrays |= {name: _read_accessor(document, binary, index) for name, index in arrays.items()}
        part["indices"] = _read_accessor(document, binary, part["indices"]).ravel().astype(np.int64)
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
        FileError: it is neither PNG nor JPEG.
    """
    for start, name in IMAGE_TYPES.items():
        if content.startswith(start):
            return name
    raise FileError("An image for a glTF file is neither PNG nor JPEG; encode it as one of them.")
