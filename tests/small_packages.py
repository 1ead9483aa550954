"""Small packages of textured meshes for tests of the server and the page."""

import hashlib
import io
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from farfield.addon.core.texmesh.streaming.increments import Increments, encode_increments
from farfield.addon.core.texmesh.streaming.manifest import MANIFEST, MESH, TEXTURES, Manifest, MeshLevel, PackageMaterial, PlanRow, Section
from farfield.addon.core.texmesh.streaming.manifest_json import encode_manifest


def write_opaque_package(folder: Path, seed: int = 0, mesh_size: int = 5000, textures_size: int = 20000) -> Manifest:
    """Write a package whose binary files are random bytes, for a server that does not read them."""
    random = np.random.default_rng(seed)
    mesh, increment = random.bytes(mesh_size), random.bytes(textures_size)
    nothing = Section(0, 0, 0)
    textures = encode_increments(Increments(*(np.zeros(0, np.int64) for _ in range(6)))) + increment
    start = len(textures) - textures_size
    manifest = Manifest(
        name="noise",
        files={name: (len(content), hashlib.sha256(content).hexdigest()) for name, content in ((MESH, mesh), (TEXTURES, textures))},
        mirrors=(),
        bounds=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        uv_bounds=((0.0, 0.0), (1.0, 1.0)),
        levels=(MeshLevel(3, 3, (1,), Section(0, mesh_size, zlib.crc32(mesh)), nothing, nothing, nothing, nothing, 0.0),),
        materials=(PackageMaterial("plain", (1.0, 1.0, 1.0, 1.0), {}, False),),
        textures=(),
        increment_count=0,
        increments=Section(0, start, zlib.crc32(textures[:start])),
        checksums=nothing,
        first_increment=start,
        plan=(PlanRow(mesh_size, 0, 0, 0.1),),
        time_limit=5.0,
        pixels=512.0,
    )
    write_files(folder, {MANIFEST: encode_manifest(manifest), MESH: mesh, TEXTURES: textures})
    return manifest


def write_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write files into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


def split_scans(jpeg: bytes) -> tuple[bytes, list[bytes]]:
    """Return the header of a progressive JPEG file, up to the tables of its first scan, and its scans with their tables."""
    header, scans, start, position = b"", [], 2, 2
    while jpeg[position : position + 2] != b"\xff\xd9":
        marker, size = jpeg[position + 1], int.from_bytes(jpeg[position + 2 : position + 4], "big")
        position += 2 + size
        if marker not in (0xC4, 0xDA):
            start = position
        elif marker == 0xDA:
            while jpeg[position] != 0xFF or jpeg[position + 1] == 0 or 0xD0 <= jpeg[position + 1] <= 0xD7:
                position += 1
            header = header or jpeg[:start]
            scans.append(jpeg[start:position])
            start = position
    return header, scans


def encode_tiles(image: np.ndarray, tile_size: int, quality: int = 90) -> list[tuple[bytes, list[bytes]]]:
    """Return header and scans of the tiles of `image` (H, W, 3) uint8, row 0 at the top; borders are padded with the last texels."""
    height, width = image.shape[:2]
    padded = np.pad(image, ((0, -height % tile_size), (0, -width % tile_size), (0, 0)), mode="edge")
    tiles = []
    for y in range(0, height, tile_size):
        for x in range(0, width, tile_size):
            stream = io.BytesIO()
            tile = Image.fromarray(np.ascontiguousarray(padded[y : y + tile_size, x : x + tile_size]))
            tile.save(stream, "JPEG", quality=quality, progressive=True, subsampling=0)
            tiles.append(split_scans(stream.getvalue()))
    return tiles
