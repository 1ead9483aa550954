"""Textures of packages: any number of the first increments of a tile is a JPEG file, and they are in the order of gain per byte."""

import numpy as np
import pytest

from farfield.addon.core.errors import ImageError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.streaming.textures.building import BuiltTextures, build_textures
from farfield.addon.core.texmesh.streaming.textures.progressive_files import check_increment, decode_tile
from farfield.addon.core.texmesh.streaming.textures.settings import TextureSettings
from farfield.addon.core.texmesh.streaming.textures.texture_tiles import TextureSource
from farfield.addon.core.texmesh.textured_mesh import build_textured_mesh
from tests.shapes import sheet

SETTINGS = TextureSettings(tile_size=32, pixels=64, views=4)


def make_source(shape: tuple[int, int] = (70, 90), role: str = "base_color") -> TextureSource:
    mesh = sheet(8, lambda x, y: 0.3 * np.sin(3.0 * x) * y)
    uvs = 0.6 * mesh.vertices[:, :2] / np.abs(mesh.vertices[:, :2]).max()
    image = np.random.default_rng(3).integers(0, 255, (shape[0] // 4 + 1, shape[1] // 4 + 1, 3)).repeat(4, axis=0).repeat(4, axis=1)
    return TextureSource(role, image[: shape[0], : shape[1]].astype(np.uint8), build_textured_mesh(mesh, uvs[mesh.triangles]), (0,))


@pytest.fixture(scope="module")
def built() -> BuiltTextures:
    return run_to_end(build_textures([make_source(), make_source((64, 64), "normal")], SETTINGS))


def test_bytes_add_up(built):
    assert built.increments.sizes.sum() == len(built.content)
    assert len(built.flips) == len(built.increments.sizes) + 1
    assert (np.diff(built.flips) <= 0.0).all()


def test_same_sources_give_same_bytes(built):
    again = run_to_end(build_textures([make_source(), make_source((64, 64), "normal")], SETTINGS))
    assert again.content == built.content and again.textures == built.textures


def test_every_prefix_of_a_tile_decodes(built):
    ends = np.cumsum(built.increments.sizes)
    seen: dict[tuple[int, int], list[bytes]] = {}
    for index, end in enumerate(ends):
        content = built.content[end - built.increments.sizes[index] : end]
        check_increment(content, int(built.increments.scans[index]))
        key = (int(built.increments.textures[index]), int(built.increments.tiles[index]))
        parts = seen.setdefault(key, [])
        parts.append(content)
        texture = built.textures[key[0]]
        assert decode_tile(texture.headers[built.increments.headers[index]], parts).shape == (32, 32, 3)


def test_what_cannot_be_coded_is_refused():
    with pytest.raises(ImageError, match="role"):
        run_to_end(build_textures([make_source(role="height")], SETTINGS))
