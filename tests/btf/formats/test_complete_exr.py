"""EXR images are complete as Blender writes them, and incomplete without any of their bytes."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from farfield.addon.bridge.imaging.images import create_image
from farfield.addon.compat import set_file_format
from farfield.addon.core.btf.formats.image_folders import is_complete_exr


def write_exr(path, codec: str, shape: tuple[int, int]) -> None:
    """Write noise as an image of half floats."""
    settings = bpy.context.scene.render.image_settings
    set_file_format(settings, "OPEN_EXR")
    settings.color_mode, settings.color_depth, settings.exr_codec = "RGB", "16", codec
    pixels = np.random.default_rng(0).random((*shape, 4), np.float32)
    create_image("Noise", pixels, is_data=True, half_floats=True).save_render(str(path), scene=bpy.context.scene)


@pytest.mark.parametrize("codec", ["NONE", "RLE", "ZIPS", "ZIP"])
@pytest.mark.parametrize("shape", [(1, 1), (16, 9), (37, 20)])
def test_every_truncated_image_is_noticed(empty_scene, tmp_path, codec, shape):
    path = tmp_path / "image.exr"
    write_exr(path, codec, shape)
    assert is_complete_exr(path)
    content = path.read_bytes()
    for size in range(0, len(content), max(1, len(content) // 97)):
        path.write_bytes(content[:size])
        assert not is_complete_exr(path), size
    path.write_bytes(content[:-1])
    assert not is_complete_exr(path)


def test_an_image_without_its_table_is_noticed(empty_scene, tmp_path):
    """A writer that fails at the end leaves zeros there."""
    path = tmp_path / "image.exr"
    write_exr(path, "ZIP", (37, 20))
    content = path.read_bytes()
    table = next(start for start in range(len(content)) if content[start : start + 8] == (start + 3 * 8).to_bytes(8, "little"))
    for position in (table, table + 8, table + 16):
        path.write_bytes(content[:position] + bytes(8) + content[position + 8 :])
        assert not is_complete_exr(path)


@pytest.mark.parametrize("content", [b"", b"text", b"\x76\x2f\x31\x01", b"\x76\x2f\x31\x01\x02\0\0\0\0"])
def test_other_files_are_not_complete_images(tmp_path, content):
    path = tmp_path / "image.exr"
    path.write_bytes(content)
    assert not is_complete_exr(path)
