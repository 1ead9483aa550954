"""Pictures of a temporary scene are what Blender itself reads from their files; broken ones are refused; nothing stays behind."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from farfield.addon.bridge import temporary
from farfield.addon.bridge.images import pixels_of
from farfield.addon.core.errors import FileError

WIDTH, HEIGHT = 23, 14


def furnished(work: temporary.TemporaryScene) -> None:
    """A triangle in a coloured world, off the middle, in a picture that no axis is alike in."""
    mesh = work.keep(bpy.data.meshes.new("Wedge"))
    mesh.from_pydata([(-1.5, -1, 0), (1, -1, 0), (1, 0.5, 0)], [], [(0, 1, 2)])
    work.add(mesh)
    work.camera.location, work.camera.data.type, work.camera.data.ortho_scale = (0.0, 0.0, 4.0), "ORTHO", 4.0
    render = work.scene.render
    render.engine, render.film_transparent = "CYCLES", True
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    work.scene.cycles.samples = 4
    world = work.keep(bpy.data.worlds.new("Tinted"))
    if world.node_tree is None:
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.5, 3.0, 1.0)
    work.scene.world = world


def names() -> set[str]:
    """Of all data that a render may leave, but for the one image that Blender itself keeps for results."""
    collections = (bpy.data.scenes, bpy.data.images, bpy.data.objects, bpy.data.worlds)
    return {item.name_full for each in collections for item in each} - {"Render Result"}


def by_blender(path) -> np.ndarray:
    picture = bpy.data.images.load(str(path), check_existing=False)
    picture.colorspace_settings.is_data = True
    pixels = pixels_of(picture).copy()
    bpy.data.images.remove(picture)
    return pixels


@pytest.mark.parametrize("percentage", [100, 50])
def test_pictures_are_what_blender_reads(percentage):
    before = names()
    with temporary.temporary_scene("Test") as work:
        furnished(work)
        work.scene.render.resolution_percentage = percentage
        picture = work.render()
        expected = by_blender(work.folder / "picture.exr")
        assert picture.shape == (HEIGHT * percentage // 100, WIDTH * percentage // 100, 4)
        np.testing.assert_array_equal(picture, expected)
        assert 0.1 < (picture[..., 3] > 0.5).mean() < 0.9 and picture[..., 2].max() > picture[..., 0].max() > 0.0
    assert names() == before


@pytest.mark.parametrize("bytes_gone", [1, 100, 3000, 5500])
def test_pictures_that_are_cut_off_are_refused(bytes_gone, monkeypatch):
    whole = temporary._read_picture

    def cut(path, *size):
        path.write_bytes(path.read_bytes()[:-bytes_gone])
        return whole(path, *size)

    monkeypatch.setattr(temporary, "_read_picture", cut)
    with temporary.temporary_scene("Test") as work:
        furnished(work)
        with pytest.raises(FileError, match="cut off"):
            work.render()


def test_a_picture_that_was_not_written_is_not_the_one_before(monkeypatch):
    with temporary.temporary_scene("Test") as work:
        furnished(work)
        work.render()
        silent = SimpleNamespace(render=SimpleNamespace(render=lambda **_: {"FINISHED"}))
        monkeypatch.setattr(temporary, "bpy", SimpleNamespace(ops=silent, data=bpy.data))
        with pytest.raises(FileError, match="cut off"):
            work.render()
