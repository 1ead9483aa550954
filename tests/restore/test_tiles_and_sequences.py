"""Images with UDIM tiles, image sequences, and linked images."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.restore.image_sources import read_tiles
from restore_images import FAST, HEIGHT, HOLE, WIDTH, hole, new_image, new_mask, ramp, read, restore

pytestmark = pytest.mark.usefixtures("empty_scene")
SIZES = {1002: (HEIGHT, WIDTH), 1011: (40, 20)}


def save_png(path, pixels, file_format="PNG", color_space="sRGB"):
    """Write stored values (H, W, 4) to a file."""
    is_float = file_format == "OPEN_EXR"
    # Blender writes values of "Non-Color" as they are, others through the color space and back.
    image = new_image("saved", pixels, "Non-Color" if is_float else color_space, is_float)
    image.filepath_raw, image.file_format = str(path), file_format
    image.save()
    bpy.data.images.remove(image)


def load_tiles(folder, name, pixels_of):
    """A tiled image with the tiles of SIZES."""
    for number, size in SIZES.items():
        save_png(folder / f"{name}.{number}.png", pixels_of(number, size))
    image = bpy.data.images.load(str(folder / f"{name}.1002.png"))
    image.name, image.source = name, "TILED"
    image.filepath = str(folder / f"{name}.<UDIM>.png")
    image.tiles[0].number = 1002
    for number in set(SIZES) - {tile.number for tile in image.tiles}:
        image.tiles.new(number)
    image.reload()
    return image


def tile_pixels(number, size):
    """A ramp with a black hole, of another color per tile."""
    pixels = ramp(*size)
    pixels[..., 2] = 0.2 if number == 1002 else 0.6
    pixels[HOLE] = (0.0, 0.0, 0.0, 1.0)
    return pixels


def mask_pixels(_number, size):
    return np.dstack([hole(*size).astype(np.float32)] * 3 + [np.ones(size, np.float32)])


@pytest.mark.parametrize("storage", ["files", "packed", "unsaved strokes"])
def test_every_tile_is_restored_and_packed(tmp_path, storage):
    image = load_tiles(tmp_path, "fels ü", tile_pixels)
    mask = load_tiles(tmp_path, "mask", mask_pixels)
    if storage == "packed":
        image.pack(), mask.pack()
        for path in tmp_path.iterdir():
            path.unlink()
    if storage == "unsaved strokes":
        pixels = read(image)
        pixels[:3] = 1.0
        image.pixels.foreach_set(pixels.ravel())
        image.update()
    before, file_format = read_tiles(image), image.file_format
    assert {number: tile.shape[:2] for number, tile in before.items()} == SIZES
    result = restore("fels ü")
    assert result.source == "TILED" and sorted(item.tile_number for item in result.packed_files) == sorted(SIZES)
    assert image.is_dirty == (storage == "unsaved strokes") and image.file_format == file_format
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "tiles.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "tiles.blend"))
    after = read_tiles(bpy.data.images["fels ü restored"])
    for number, size in SIZES.items():
        outside = ~hole(*size)
        assert np.array_equal(after[number][outside], before[number][outside])
        truth = ramp(*size)
        assert np.abs(after[number] - truth)[HOLE][..., :2].max() < 0.03
        assert np.abs(after[number][HOLE][..., 2] - (0.2 if number == 1002 else 0.6)).max() < 0.01, "tiles are mixed up"


def test_float_tiles_keep_their_values():
    image = bpy.data.images.new("hdr", 32, 24, alpha=True, float_buffer=True, tiled=True)
    pixels = ramp() * np.float32([7.0, 7.0, 7.0, 1.0])
    pixels[HOLE] = 0.0
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    after = read_tiles(restore("hdr", mask="alpha", mask_image=""))[1001]
    assert np.array_equal(after[~hole()], pixels[~hole()]) and after[HOLE].min() > 0.5


def test_tiles_without_holes_are_copied_and_their_number_is_named(tmp_path):
    load_tiles(tmp_path, "rock", tile_pixels)
    load_tiles(tmp_path, "mask", lambda number, size: mask_pixels(number, size) * (number == 1011))
    before = read_tiles(bpy.data.images["rock"])
    after = read_tiles(restore("rock"))
    assert np.array_equal(after[1002], before[1002]) and not np.array_equal(after[1011], before[1011])
    load_tiles(tmp_path, "full", lambda number, size: np.ones((*size, 4), np.float32) if number == 1011 else mask_pixels(number, size))
    with pytest.raises(RuntimeError, match="Tile 1011"):
        bpy.ops.farfield.restore_image(image="rock", mask_image="full", **FAST)


def test_masks_of_tiled_images_have_tiles(tmp_path):
    load_tiles(tmp_path, "rock", tile_pixels)
    new_mask("plain")
    with pytest.raises(RuntimeError, match='"rock" has UDIM tiles, but "plain" has none'):
        bpy.ops.farfield.restore_image(image="rock", mask_image="plain", **FAST)


def test_a_missing_tile_is_named(tmp_path):
    for name, pixels_of in (("rock", tile_pixels), ("mask", mask_pixels)):
        load_tiles(tmp_path, name, pixels_of).use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    (tmp_path / "rock.1011.png").unlink()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    with pytest.raises(RuntimeError, match="rock") as caught:
        bpy.ops.farfield.restore_image(image="rock", mask_image="mask", **FAST)
    assert "Traceback" not in str(caught.value) and "log" not in str(caught.value)


@pytest.mark.parametrize("file_format", ["PNG", "OPEN_EXR"])
def test_frames_of_a_sequence_are_restored_into_files(tmp_path, file_format):
    source_folder, out = tmp_path / "quelle ü", tmp_path / "out"
    source_folder.mkdir()
    extension = "exr" if file_format == "OPEN_EXR" else "png"
    for number in (8, 9, 10):
        pixels = ramp()
        pixels[..., 2] = number / np.float32(20.0)
        pixels[HOLE] = (0.0, 0.0, 0.0, 1.0)
        save_png(source_folder / f"shot_{number:03}.{extension}", pixels, file_format)
    (source_folder / f"other_009.{extension}").write_bytes(b"not a frame")
    image = bpy.data.images.load(str(source_folder / f"shot_008.{extension}"))
    image.name, image.source = "shot", "SEQUENCE"
    new_mask()
    with pytest.raises(RuntimeError, match="Output Folder"):
        bpy.ops.farfield.restore_image(image="shot", mask_image="mask", **FAST)
    result = restore("shot", output_folder=str(out))
    assert sorted(path.name for path in out.iterdir()) == [f"shot restored_{number:04}.{extension}" for number in (8, 9, 10)]
    assert result.source == "SEQUENCE" and result.colorspace_settings.name == image.colorspace_settings.name
    for number in (8, 9, 10):
        before = bpy.data.images.load(str(source_folder / f"shot_{number:03}.{extension}"))
        after = bpy.data.images.load(str(out / f"shot restored_{number:04}.{extension}"))
        assert np.array_equal(read(after)[~hole()], read(before)[~hole()])
        assert np.abs(read(after)[HOLE][..., 2] - number / 20.0).max() < 0.01


def test_a_sequence_is_written_completely_or_not_at_all(tmp_path):
    for number in (1, 2):
        save_png(tmp_path / f"shot_{number}.png", ramp())
    (tmp_path / "shot_2.png").write_bytes((tmp_path / "shot_2.png").read_bytes()[:40])
    image = bpy.data.images.load(str(tmp_path / "shot_1.png"))
    image.name, image.source = "shot", "SEQUENCE"
    new_mask()
    with pytest.raises(RuntimeError, match=r"shot_2\.png"):
        bpy.ops.farfield.restore_image(image="shot", mask_image="mask", output_folder=str(tmp_path / "out"), **FAST)
    assert not (tmp_path / "out").exists()


def test_masks_can_be_sequences(tmp_path):
    for number in (1, 2):
        save_png(tmp_path / f"shot_{number}.png", tile_pixels(1002, (HEIGHT, WIDTH)))
        mask = mask_pixels(0, (HEIGHT, WIDTH)) * np.float32([number == 2] * 3 + [1])
        save_png(tmp_path / f"mask_{number}.png", mask, color_space="Non-Color")
    for name in ("shot", "mask"):
        image = bpy.data.images.load(str(tmp_path / f"{name}_1.png"))
        image.name, image.source = name, "SEQUENCE"
    restore("shot", output_folder=str(tmp_path / "out"))
    first, second = (read(bpy.data.images.load(str(tmp_path / "out" / f"shot restored_000{number}.png"))) for number in (1, 2))
    assert first[HOLE][..., :3].max() == 0.0 and second[HOLE][..., :2].min() > 0.1


def test_a_linked_image_becomes_a_local_copy(tmp_path):
    for name in ("linked", "mask"):
        image = new_image("linked", tile_pixels(1002, (HEIGHT, WIDTH))) if name == "linked" else new_mask()
        image.pack()
        image.use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, target):
        target.images = ["linked", "mask"]
    source = bpy.data.images["linked"]
    assert source.library is not None
    before = read(source)
    result = restore("linked")
    assert result.library is None and np.array_equal(read(source), before)
    assert np.array_equal(read(result)[~hole()], before[~hole()]) and read(result)[HOLE][..., 0].min() > 0.1


def test_a_linked_tiled_image_becomes_a_local_copy(tmp_path):
    for name, pixels_of in (("rock", tile_pixels), ("mask", mask_pixels)):
        load_tiles(tmp_path, name, pixels_of).use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, target):
        target.images = ["rock", "mask"]
    result = restore("rock")
    assert result.library is None and sorted(tile.number for tile in result.tiles) == sorted(SIZES)
    assert {image.name for image in bpy.data.images} == {"rock", "mask", "rock restored"}, "temporary images are removed"
