"""Renders equal the images that Blender reads from their files; incomplete files are rejected; no data is left behind."""

import contextlib
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.bridge.rendering import render_scene
from farfield.addon.compat import enable_nodes
from farfield.addon.core.errors import FileError

WIDTH, HEIGHT = 23, 14
THREADS = Path("/proc/self/task")


def furnish(work: render_scene.RenderScene) -> None:
    """Add an off-center triangle, a colored World and a non-square resolution, so that no flipped or swapped axis goes unnoticed."""
    mesh = work.own(bpy.data.meshes.new("Wedge"))
    mesh.from_pydata([(-1.5, -1, 0), (1, -1, 0), (1, 0.5, 0)], [], [(0, 1, 2)])
    work.add_object(mesh)
    work.camera.location, work.camera.data.type, work.camera.data.ortho_scale = (0.0, 0.0, 4.0), "ORTHO", 4.0
    render = work.scene.render
    render.engine, render.film_transparent = "CYCLES", True
    render.resolution_x, render.resolution_y, render.resolution_percentage = WIDTH, HEIGHT, 100
    work.scene.cycles.samples = 4
    world = work.own(bpy.data.worlds.new("Tinted"))
    enable_nodes(world)
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.5, 3.0, 1.0)
    work.scene.world = world


def data_names() -> set[str]:
    """Return the names of all data that a render may leave behind, except the image that Blender itself keeps for results."""
    collections = (bpy.data.scenes, bpy.data.images, bpy.data.objects, bpy.data.worlds)
    return {item.name_full for collection in collections for item in collection} - {"Render Result"}


def read_with_blender(path) -> np.ndarray:
    image = bpy.data.images.load(str(path), check_existing=False)
    image.colorspace_settings.is_data = True
    pixels = read_pixels(image).copy()
    bpy.data.images.remove(image)
    return pixels


@pytest.mark.parametrize("percentage", [100, 50])
def test_renders_equal_the_images_that_blender_reads(percentage):
    before = data_names()
    with render_scene.render_scene("Test") as work:
        furnish(work)
        work.scene.render.resolution_percentage = percentage
        image = work.render()
        expected = read_with_blender(work.folder / "render.exr")
        assert image.shape == (HEIGHT * percentage // 100, WIDTH * percentage // 100, 4)
        np.testing.assert_array_equal(image, expected)
        assert 0.1 < (image[..., 3] > 0.5).mean() < 0.9 and image[..., 2].max() > image[..., 0].max() > 0.0
    assert data_names() == before


@pytest.mark.parametrize("missing_bytes", [1, *(pytest.param(count, marks=pytest.mark.exhaustive) for count in (100, 3000)), 5500])
def test_truncated_files_are_rejected(missing_bytes, monkeypatch):
    read_exr = render_scene._read_exr

    def truncate(path, *size):
        path.write_bytes(path.read_bytes()[:-missing_bytes])
        return read_exr(path, *size)

    monkeypatch.setattr(render_scene, "_read_exr", truncate)
    with render_scene.render_scene("Test") as work:
        furnish(work)
        with pytest.raises(FileError, match="truncated"):
            work.render()


def test_a_render_that_was_not_written_is_not_the_previous_one(monkeypatch):
    with render_scene.render_scene("Test") as work:
        furnish(work)
        work.render()
        no_op = SimpleNamespace(render=SimpleNamespace(render=lambda **_: {"FINISHED"}))
        monkeypatch.setattr(render_scene, "bpy", SimpleNamespace(ops=no_op, data=bpy.data))
        with pytest.raises(FileError, match="truncated"):
            work.render()


@pytest.mark.skipif(not THREADS.exists(), reason="this system does not list the threads of a process")
@pytest.mark.parametrize("fails", [False, True])
def test_the_render_session_ends_with_its_scene(fails):
    """A session that outlives its scene keeps a thread, and refers to freed memory."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with render_scene.render_scene("Test") as work:  # the first render starts threads that Blender keeps
        furnish(work)
        work.render()
    before = len(list(THREADS.iterdir()))
    with contextlib.suppress(ZeroDivisionError), render_scene.render_scene("Test") as work:
        furnish(work)
        work.scene.render.use_persistent_data = True
        work.render()
        during = len(list(THREADS.iterdir()))
        if fails:
            raise ZeroDivisionError
    assert len(list(THREADS.iterdir())) <= before < during


def test_a_file_saved_meanwhile_contains_nothing_of_the_render_scene(empty_scene, tmp_path):
    kept = bpy.data.objects.new("Kept", None)
    empty_scene.collection.objects.link(kept)
    with render_scene.render_scene("Test") as work:
        work.scene.collection.objects.link(kept)
        work.add_object(work.own(bpy.data.lights.new("Test Sun", "SUN")))
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "meanwhile.blend"), copy=True, check_existing=False)
    with bpy.data.libraries.load(str(tmp_path / "meanwhile.blend")) as (saved, _):
        assert (saved.scenes, saved.objects, saved.lights, saved.cameras) == ([empty_scene.name], ["Kept"], [], [])
