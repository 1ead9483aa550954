"""Image files for tests, written with OpenImageIO or byte by byte."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from farfield.addon.bridge.blender import import_blender_module
from farfield.addon.core.geometry.cameras import OrthographicView

CURVE = b"curv" + bytes(4) + struct.pack(">IHH", 1, 0x0233, 0)  # gamma 2.2


def open_image_io() -> Any:
    """Return the module OpenImageIO."""
    return import_blender_module("OpenImageIO", "The test", "use another Blender")


def write_image(path: Path, stored: np.ndarray, attributes: dict[str, Any] | None = None, change=None) -> Path:
    """Write the array (H, W, C), row 0 at the top, with its own type, as it is. `change` may change the header. Returns `path`."""
    oiio = open_image_io()
    name = {"float16": "half", "float32": "float", "float64": "double"}.get(stored.dtype.name, stored.dtype.name)
    spec = oiio.ImageSpec(stored.shape[1], stored.shape[0], stored.shape[2], name)
    for attribute, value in ({"oiio:UnassociatedAlpha": 1} if path.suffix == ".png" else {}).items() | (attributes or {}).items():
        spec.attribute(attribute, value)
    if stored.dtype == np.float16:
        spec.attribute("tiff:half", 1)
    if change is not None:
        change(spec)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec), file.geterror()
    assert file.write_image(np.ascontiguousarray(stored)), file.geterror()
    file.close()
    return path


def read_image(path: Path) -> tuple[np.ndarray, Any]:
    """Return the array (H, W, C) of the file, row 0 at the top, as it is stored, and the header."""
    oiio = open_image_io()
    configuration = oiio.ImageSpec()
    configuration.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageInput.open(str(path), configuration)
    spec = file.spec()
    stored = file.read_image(0, 0, 0, spec.nchannels, spec.format)
    file.close()
    return stored, spec


def png_chunk(name: bytes, content: bytes) -> bytes:
    """Return a chunk of a PNG file."""
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def png_bytes(width: int, height: int, depth: int, color_type: int, rows: bytes, chunks: bytes = b"") -> bytes:
    """Return a PNG file with these header fields and filtered rows. `chunks` precede the rows."""
    header = struct.pack(">IIBBBBB", width, height, depth, color_type, 0, 0, 0)
    rows = png_chunk(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", header) + chunks + rows + png_chunk(b"IEND", b"")


def jpeg_bytes(components: int, adobe_transform: int | None) -> bytes:
    """Return a uniform JPEG file of 8 x 8 pixels. Its Huffman tables have one code each: no difference, and end of block."""

    def segment(marker: int, content: bytes) -> bytes:
        return bytes((0xFF, marker)) + struct.pack(">H", len(content) + 2) + content

    adobe = b"" if adobe_transform is None else segment(0xEE, b"Adobe" + struct.pack(">HHHB", 100, 0, 0, adobe_transform))
    frame = struct.pack(">BHHB", 8, 8, 8, components) + b"".join(bytes((index + 1, 0x11, 0)) for index in range(components))
    scan = bytes([components]) + b"".join(bytes((index + 1, 0)) for index in range(components)) + bytes((0, 63, 0))
    table = bytes([1]) + bytes(15) + bytes([0])  # one code of one bit, for the symbol 0
    data = bytes([0x00]) if components == 4 else bytes([0x3F >> (2 * components - 2)])
    return (
        b"\xff\xd8" + adobe + segment(0xDB, bytes([0]) + bytes([16] * 64)) + segment(0xC0, frame)
        + segment(0xC4, bytes([0x00]) + table) + segment(0xC4, bytes([0x10]) + table) + segment(0xDA, scan) + data + b"\xff\xd9"
    )  # fmt: skip


def icc_profile() -> bytes:
    """Return a small valid color profile: the primaries of sRGB with a gamma of 2.2."""
    primaries = {b"rXYZ": (28578, 14581, 912), b"gXYZ": (25241, 46981, 6362), b"bXYZ": (9376, 3974, 46799)}
    tags = {b"desc": b"desc" + bytes(4) + struct.pack(">I", 5) + b"Test\0" + bytes(79), b"cprt": b"text" + bytes(4) + b"none" + bytes(4)}
    tags |= {b"wtpt": b"XYZ " + bytes(4) + struct.pack(">3i", 63190, 65536, 54061)}
    tags |= {name: b"XYZ " + bytes(4) + struct.pack(">3i", *values) for name, values in primaries.items()}
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), CURVE)
    table, body = struct.pack(">I", len(tags)), b""
    for name, content in tags.items():
        table += name + struct.pack(">II", 132 + 12 * len(tags) + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    header = struct.pack(
        ">I4sI4s4s4s6H4s", 128 + len(table) + len(body), b"none", 0x02100000, b"mntr", b"RGB ", b"XYZ ", 2020, 1, 1, 0, 0, 0, b"acsp"
    )
    return (header.ljust(68, b"\0") + struct.pack(">3i", 63190, 65536, 54061)).ljust(128, b"\0") + table + body


def pixel_of(view: OrthographicView, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column (N,) of the pixel that shows each of `positions` (N, 3); the nearest pixel for positions outside."""
    column, row = np.clip(np.floor(view.project(positions)[0]), 0, view.resolution - 1).astype(np.int64).T
    return row, column
