"""WebP files by Pillow, or by gltf-transform where FARFIELD_GLTF_TRANSFORM names the program, for `packages_bytes.py`.

python3 benchmarks/packages_webp.py spot truck   compares both on the textures of models, for all qualities
"""

import io
import json
import os
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

QUALITIES = (5, 10, 15, 20, 30, 40, 50, 60, 70, 80, 90, 95)
VARIABLE = "FARFIELD_GLTF_TRANSFORM"
METHOD = 6  # Method of Pillow: the slowest, which gives the smallest files.
EFFORT = 100  # Effort of gltf-transform, the same.
TIMEOUT = 300.0  # seconds
ALIGNMENT = 4


def encode_webp(image: np.ndarray, quality: int) -> bytes:
    """Return the WebP file of an image (H, W, 3) uint8, row 0 at the top."""
    program = os.environ.get(VARIABLE)
    return encode_with_pillow(image, quality) if program is None else encode_with_gltf_transform(image, quality, program)


def encode_with_pillow(image: np.ndarray, quality: int) -> bytes:
    """Return the WebP file by Pillow."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=quality, method=METHOD)
    return buffer.getvalue()


def encode_with_gltf_transform(image: np.ndarray, quality: int, program: str) -> bytes:
    """Return the WebP file in a .glb that gltf-transform has converted from one with a PNG image."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG", compress_level=1)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "source.glb", Path(folder) / "target.glb"
        source.write_bytes(make_textured_glb(buffer.getvalue()))
        command = [program, "webp", str(source), str(target), "--quality", str(quality), "--effort", str(EFFORT)]
        subprocess.run(command, check=True, capture_output=True, timeout=TIMEOUT)
        return read_image(target.read_bytes())


def make_textured_glb(image: bytes) -> bytes:
    """Return a .glb of one triangle with an image (a PNG file)."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    uvs = np.array([[0, 0], [1, 0], [0, 1]], "<f4").tobytes()
    parts = [positions, uvs, image]
    starts = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).tolist()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 2, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part)} for start, part in zip(starts[:-1], parts, strict=True)
        ],
        "buffers": [{"byteLength": starts[-1]}],
    }
    text, binary = json.dumps(document).encode(), b"".join(parts)
    text += b" " * (-len(text) % ALIGNMENT)
    binary += b"\0" * (-len(binary) % ALIGNMENT)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def read_image(content: bytes) -> bytes:
    """Return the first image in a .glb."""
    length = struct.unpack_from("<I", content, 12)[0]
    document, start = json.loads(content[20 : 20 + length]), 20 + length + 8
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    offset = start + view.get("byteOffset", 0)
    return content[offset : offset + view["byteLength"]]


def main(names: list[str]) -> None:
    """Print the bytes of both for the first texture of each model, and their largest difference of pixels."""
    from lib import environment

    environment.ensure()
    environment.import_farfield()
    from texmesh_models import open_textured

    program = os.environ[VARIABLE]
    print("| model | quality | Pillow | gltf-transform | ratio | largest difference of pixels |\n|---|---|---|---|---|---|")
    for name in names:
        model = open_textured(environment.ROOT.parent / "shared" / "data", name, 0)
        image = np.ascontiguousarray(next(item for item in model.images if item is not None)[::-1])
        for quality in QUALITIES:
            files = encode_with_pillow(image, quality), encode_with_gltf_transform(image, quality, program)
            decoded = [np.asarray(Image.open(io.BytesIO(file)).convert("RGB")).astype(int) for file in files]
            ours, theirs = map(len, files)
            print(
                f"| {name} | {quality} | {ours:,} | {theirs:,} | {theirs / ours:.3f} | {np.abs(decoded[0] - decoded[1]).max()} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
    main(sys.argv[1:])
