"""Measures how many bytes textures of packages need for the same FLIP error as uniform quality, for `bench_texmesh.py`."""

import io
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.streaming.textures.building import BuiltTextures, build_textures
from farfield.addon.core.texmesh.streaming.textures.progressive_files import decode_tile, join_scans, split_scans
from farfield.addon.core.texmesh.streaming.textures.settings import TextureSettings
from farfield.addon.core.texmesh.streaming.textures.texture_tiles import TextureSource, TileGrid, cut_tiles, join_tiles
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

QUALITIES = (2, 4, 7, 11, 17, 25, 37, 50, 65, 80, 92)
Images = list[np.ndarray | None]


class Curve(NamedTuple):
    """Ascending bytes (N,) and the FLIP errors (N,) that they give."""

    byte_counts: np.ndarray
    flips: np.ndarray

    def bytes_at(self, flip: float) -> float:
        """Return the bytes that give `flip`, between measured ones by the logarithms of both; NaN outside."""
        order = np.argsort(self.byte_counts)
        counts, flips = self.byte_counts[order], np.minimum.accumulate(self.flips[order])
        if not flips[-1] <= flip <= flips[0]:
            return float("nan")
        return float(np.exp(np.interp(np.log(flip), np.log(flips[::-1]), np.log(counts[::-1]))))


def list_sources(mesh: TexturedMesh, images: Sequence[np.ndarray | None]) -> list[TextureSource]:
    """Return one source for each distinct texture."""
    groups: dict[int, list[int]] = {}
    for material, image in enumerate(images):
        if image is not None and (mesh.materials == material).any():
            groups.setdefault(id(image), []).append(material)
    return [TextureSource("base_color", images[materials[0]], mesh, tuple(materials)) for materials in groups.values()]


def decode_built(built: BuiltTextures, count: int) -> list[np.ndarray]:
    """Return the textures (H, W, 3) uint8, row 0 at the bottom, that the first `count` increments give; tiles without any are gray."""
    parts: dict[tuple[int, int], list[bytes]] = {}
    ends = np.cumsum(built.increments.sizes)
    headers: dict[tuple[int, int], int] = {}
    for index in range(count):
        key = int(built.increments.textures[index]), int(built.increments.tiles[index])
        parts.setdefault(key, []).append(built.content[ends[index] - built.increments.sizes[index] : ends[index]])
        headers[key] = int(built.increments.headers[index])
    images = []
    for number, texture in enumerate(built.textures):
        tiles = np.full((texture.tile_count, texture.tile_size, texture.tile_size, 3), 128, np.uint8)
        for (owner, tile), scans in parts.items():
            if owner == number:
                tiles[tile] = decode_tile(texture.headers[headers[owner, tile]], scans)[::-1]
        images.append(join_tiles(tiles, TileGrid(texture.width, texture.height, texture.tile_size))[::-1])
    return images


def spread_images(sources: Sequence[TextureSource], decoded: Sequence[np.ndarray], count: int) -> Images:
    """Return the decoded texture of each material."""
    images: Images = [None] * count
    for source, image in zip(sources, decoded, strict=True):
        for material in source.materials:
            images[material] = image
    return images


def measure_built(
    built: BuiltTextures, sources: Sequence[TextureSource], judge: Callable[[Images], float], count: int, points: int
) -> Curve:
    """Return the curve of prefixes of the increments, at numbers of bytes in a geometric series."""
    ends = np.concatenate([[0], np.cumsum(built.increments.sizes)])
    fixed = sum(sum(map(len, texture.headers)) for texture in built.textures)
    targets = ends[-1] * np.geomspace(0.03, 1.0, points)
    counts = np.unique(np.searchsorted(ends, targets, side="right") - 1)
    flips = [judge(spread_images(sources, decode_built(built, int(number)), count)) for number in counts]
    return Curve(ends[counts] + fixed, np.array(flips))


def measure_uniform(sources: Sequence[TextureSource], judge: Callable[[Images], float], count: int) -> Curve:
    """Return the curve of whole textures as progressive JPEG files of one quality."""
    sizes, flips = [], []
    for quality in QUALITIES:
        files = [encode_image(source.image[::-1], quality) for source in sources]
        decoded = [np.asarray(Image.open(io.BytesIO(file)).convert("RGB"))[::-1] for file in files]
        sizes.append(sum(map(len, files)))
        flips.append(judge(spread_images(sources, decoded, count)))
    return Curve(np.array(sizes), np.array(flips))


def measure_prefixes(sources: Sequence[TextureSource], judge: Callable[[Images], float], count: int, quality: int, side: int) -> Curve:
    """Return the curve of tiles coded by the library at one quality, of which all have the same number of scans."""
    coded = []
    for source in sources:
        grid = TileGrid(source.image.shape[1], source.image.shape[0], side)
        image = np.pad(
            source.image[::-1], [(0, grid.padded_shape[axis] - source.image.shape[axis]) for axis in (0, 1)] + [(0, 0)], mode="edge"
        )
        coded.append((grid, [split_scans(encode_image(tile, quality)) for tile in cut_tiles(image, side)]))
    sizes, flips = [], []
    for scans in range(1, max(len(tile[1]) for _, tiles in coded for tile in tiles) + 1):
        sizes.append(sum(sum(map(len, tile[1][:scans])) for _, tiles in coded for tile in tiles))
        decoded = [
            join_tiles(np.stack([decode_tile(header, parts[:scans])[::-1] for header, parts in tiles]), grid)[::-1] for grid, tiles in coded
        ]
        flips.append(judge(spread_images(sources, decoded, count)))
    return Curve(np.array(sizes), np.array(flips))


def encode_image(image: np.ndarray, quality: int) -> bytes:
    """Return a progressive JPEG file of an image (H, W, 3) uint8, without subsampling of colors."""
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, "JPEG", quality=quality, progressive=True, subsampling=0)
    return file.getvalue()


def build(sources: Sequence[TextureSource], settings: TextureSettings) -> BuiltTextures:
    """Build the textures of a package."""
    return run_to_end(build_textures(sources, settings))


__all__ = ["join_scans"]
