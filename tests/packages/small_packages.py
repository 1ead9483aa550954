"""Small packages of textured meshes for tests of the server and the page."""

import hashlib
import io
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from PIL import Image

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.increments import Increments, decode_increments, encode_increments
from farfield.addon.core.packages.manifest import MANIFEST, MESH, TEXTURES, Manifest, MeshLevel, PackageMaterial, Section, encode_manifest
from farfield.addon.core.packages.mesh.coding import encode_mesh
from farfield.addon.core.packages.mesh.order import order_mesh
from farfield.addon.core.packages.planning import ErrorModel, find_state_pixels
from farfield.addon.core.packages.settings import PackageSettings
from farfield.addon.core.packages.shading import Shading
from farfield.addon.core.packages.textures.building import build_textures
from farfield.addon.core.packages.textures.texture_tiles import TextureSource
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import simplify_by_cost
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

UNLIT = Shading(is_unlit=True)


def write_opaque_package(folder: Path, seed: int = 0, mesh_size: int = 5000, textures_size: int = 20000) -> Manifest:
    """Write a package whose binary files are random bytes, for a server that does not read them."""
    random = np.random.default_rng(seed)
    mesh, increment = random.bytes(mesh_size), random.bytes(textures_size)
    nothing = Section(0, 0, 0)
    textures = encode_increments(Increments(*(np.zeros(0, np.int64) for _ in range(6)))) + increment
    start = len(textures) - textures_size
    manifest = Manifest(
        name="noise",
        files={name: _describe(content) for name, content in ((MESH, mesh), (TEXTURES, textures))},
        mirrors=(),
        bounds=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        uv_bounds=((0.0, 0.0), (1.0, 1.0)),
        steps=(65535, 65535),
        levels=(MeshLevel(3, 3, (1,), Section(0, mesh_size, zlib.crc32(mesh)), nothing, nothing, nothing, nothing, 0.0),),
        materials=(PackageMaterial("plain", (1.0, 1.0, 1.0, 1.0), {}, False),),
        textures=(),
        increment_count=0,
        increments=Section(0, start, zlib.crc32(textures[:start])),
        checksums=nothing,
        first_increment=start,
        errors=ErrorModel((0.1,), (0.1,), 2.0),
        state_pixels=(0.0,),
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


def write_textured_package(
    folder: Path,
    mesh: TexturedMesh,
    images: list[np.ndarray],
    percents: tuple[int, ...] = (20, 5),
    tile_size: int = 128,
    time_limit: float = 4.0,
    mirrors: tuple[str, ...] = (),
    maps: Mapping[str, np.ndarray] = MappingProxyType({}),
    shading: Shading = UNLIT,
    opacity: float = 1.0,
) -> Manifest:
    """Write a package of `mesh` with levels of `percents` of its triangles, finest first. images: (H, W, 3) uint8, sRGB, row 0 at the top,
    the base color of each material. maps: further images by role, which all materials have. shading, opacity: of all materials."""
    targets = [len(mesh.triangles) * percent // 100 for percent in percents]
    result = run_to_end(simplify_by_cost(mesh, None, targets, TexmeshSettings(vertices="original")))
    ordered = order_mesh(mesh, result.levels, result)
    mesh_content, levels, bounds, uv_bounds = encode_mesh(ordered, _level_pixels(len(ordered.levels)), len(images))
    sources = [TextureSource("base_color", image[::-1], mesh, (index,)) for index, image in enumerate(images)]
    sources += [TextureSource(role, image[::-1], mesh, tuple(range(len(images)))) for role, image in maps.items()]
    shared = {role: len(images) + index for index, role in enumerate(maps)}
    built = run_to_end(build_textures(sources, PackageSettings(tile_size=tile_size, quality=90), 67.0, views=4))
    sizes, ends = built.increments.sizes, np.cumsum(built.increments.sizes)
    table = encode_increments(built.increments)
    parts = [built.content[end - size : end] for end, size in zip(ends, sizes, strict=True)]
    checksums = np.array([zlib.crc32(part) for part in parts], "<u4").tobytes()
    texture_content = table + checksums + built.content
    manifest = Manifest(
        name="Prüfling",
        files={name: _describe(content) for name, content in ((MESH, mesh_content), (TEXTURES, texture_content))},
        mirrors=mirrors,
        bounds=bounds,
        uv_bounds=uv_bounds,
        steps=(65535, 65535),
        levels=levels,
        materials=tuple(
            PackageMaterial(f"paint {index}", (1.0, 1.0, 1.0, opacity), {"base_color": index, **shared}, False, shading)
            for index in range(len(images))
        ),
        textures=built.textures,
        increment_count=len(sizes),
        increments=Section(0, len(table), zlib.crc32(table)),
        checksums=Section(len(table), len(checksums), zlib.crc32(checksums)),
        first_increment=len(table) + len(checksums),
        errors=_model_errors(len(levels), built.flips[:, 0]),
        state_pixels=find_state_pixels(built.flips, 512, 0.01),
        time_limit=time_limit,
        pixels=512.0,
    )
    write_files(folder, {MANIFEST: encode_manifest(manifest), MESH: mesh_content, TEXTURES: texture_content})
    return manifest


def decode_textures(folder: Path, manifest: Manifest) -> list[np.ndarray]:
    """Return the textures (H, W, 3) uint8 of a package, row 0 at the top, decoded by Pillow from all increments."""
    content = (folder / TEXTURES).read_bytes()
    increments = decode_increments(manifest.increments.read(content, TEXTURES), manifest)
    images = [np.full((texture.height, texture.width, 3), 128, np.uint8) for texture in manifest.textures]
    parts = increments.split(content[manifest.first_increment :])
    for index, tile, header, part in zip(increments.textures, increments.tiles, increments.headers, parts, strict=True):
        texture = manifest.textures[index]
        side, columns = texture.tile_size, -(-texture.width // texture.tile_size)
        if tile >= columns * -(-texture.height // side):
            continue  # The tile is one of a coarser level; all of level 0 come in the end.
        size = len(part)
        file = b"".join([texture.headers[header], size.to_bytes(4, "big"), (size + 8).to_bytes(4, "big"), b"mdat", part])
        y, x = tile // columns * side, tile % columns * side
        shown = images[index][y : y + side, x : x + side]
        shown[:] = np.asarray(Image.open(io.BytesIO(file)).convert("RGB"))[: shown.shape[0], : shown.shape[1]]
    return images


def painted_image(width: int, height: int, seed: int = 0) -> np.ndarray:
    """Return an image (H, W, 3) uint8 that differs everywhere: red grows to the right, green downwards, blue is a pattern of soft spots."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / [[[height]], [[width]]]
    phases, frequencies = random.uniform(0.0, 2.0 * np.pi, 6), random.integers(1, 9, (6, 2))
    waves = sum(np.cos(2.0 * np.pi * (fx * x + fy * y) + phase) for (fx, fy), phase in zip(frequencies, phases, strict=True))
    return (255.0 * np.stack([x, y, 0.5 + waves / 12.0], axis=2)).round().astype(np.uint8)


def _describe(content: bytes) -> tuple[int, str]:
    return len(content), hashlib.sha256(content).hexdigest()


def _level_pixels(count: int) -> tuple[float, ...]:
    """Return sizes up to which levels look like the next finer one."""
    return (*(100.0 * 2**level for level in range(count - 1)), 0.0)


def _model_errors(levels: int, flips: np.ndarray) -> ErrorModel:
    """Errors of levels and states of the textures: coarser levels are worse."""
    states = np.minimum.accumulate(flips).clip(0.0, 1.0).tolist()
    return ErrorModel(tuple(0.1 * level for level in reversed(range(levels))), tuple(states), 1.0)
