"""Operators replace no file of the scene and nothing that Farfield did not write, and refuse before any work."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from farfield.addon.bridge.scene_paths import scene_inputs
from farfield.addon.bridge.texmesh.glb_levels import level_outputs
from farfield.addon.core.btf.settings import ExportSettings
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.glb import save_glb
from farfield.addon.operators.btf.export_job import prepare_export
from textured_scenes import textured_ball

SMALL = {"levels": "ratios", "ratios": "0.5", "views": 2, "max_image": 32, "vertices": "original"}


pytestmark = pytest.mark.usefixtures("few_samples", "coarse_packing")


@pytest.fixture
def folder(empty_scene, tmp_path) -> Path:
    """A folder with the open file and an image that the active object, a ball, shows."""
    ball = textured_ball(6)
    image = ball.data.materials[0].node_tree.nodes["Image Texture"].image
    image.filepath_raw, image.file_format = str(tmp_path / "paint.png"), "PNG"
    image.save()
    image.unpack(method="REMOVE")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"), check_existing=False)
    return tmp_path


def refusal(call, folder: Path) -> str:
    """The sentence with which a call is refused; the files stay as they are."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises((RuntimeError, FileError)) as caught:
        call()
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    return str(caught.value)


def test_files_of_the_scene_are_its_images_and_libraries_with_their_tiles(folder):
    for number in (1001, 1012):
        (folder / f"tiles.{number}.png").touch()
    bpy.data.images.new("Tiles", 4, 4, tiled=True).filepath = str(folder / "tiles.<UDIM>.png")
    names = {given.path.name for given in scene_inputs()}
    assert {"paint.png", "tiles.1001.png", "tiles.1012.png"} <= names


def test_a_stretch_image_is_no_texture_of_the_scene(folder):
    bpy.ops.farfield.unwrap()
    call = lambda: bpy.ops.farfield.unwrap_stretch_image(filepath=str(folder / "paint.png"), resolution=64)  # noqa: E731
    assert "a file of the scene are the same file" in refusal(call, folder)


def test_levels_replace_only_levels(folder):
    (folder / "ball-L1.glb").write_bytes(b"mine")
    assert bpy.ops.farfield.texmesh_levels(**SMALL) == {"FINISHED"}
    call = lambda: bpy.ops.farfield.texmesh_export(filepath=str(folder / "ball.glb"))  # noqa: E731
    assert 'the level "ball-L1.glb" would replace' in refusal(call, folder)
    (folder / "ball-L1.glb").write_bytes(save_glb({"meshes": []}))
    assert bpy.ops.farfield.texmesh_export(filepath=str(folder / "ball.glb")) == {"FINISHED"}
    assert [output.path.name for output in level_outputs(folder / "ball.glb")] == ["ball-L0.glb", "ball-L1.glb"]


def test_levels_in_edit_mode_are_not_written(folder):
    assert bpy.ops.farfield.texmesh_levels(**SMALL) == {"FINISHED"}
    assert bpy.ops.farfield.texmesh_show(level=1) == {"FINISHED"}
    bpy.ops.object.mode_set(mode="EDIT")
    assert "is in Edit Mode; leave it" in refusal(lambda: bpy.ops.farfield.texmesh_export(filepath=str(folder / "ball.glb")), folder)


def test_a_package_replaces_no_other_page(folder):
    site = folder / "site"
    site.mkdir()
    (site / "index.html").write_text("My page")
    call = lambda: bpy.ops.farfield.packages_export(folder=str(site))  # noqa: E731
    assert 'contains "index.html", but no package' in refusal(call, folder)


@pytest.mark.slow
def test_packages_of_several_objects_replace_only_their_folders(folder):
    """The folder above them may have a page of its own."""
    ball = bpy.context.active_object
    textured_ball(6, "Second").select_set(True)
    ball.select_set(True)
    other = folder / "site" / "Second"
    other.mkdir(parents=True)
    (folder / "site" / "index.html").write_text("My page")
    (other / "index.html").write_text("My other page")
    call = lambda: bpy.ops.farfield.packages_export(folder=str(folder / "site"))  # noqa: E731
    assert f'The folder "{other}" contains "index.html", but no package' in refusal(call, folder)
    (other / "index.html").unlink()
    levels = {name: value for name, value in SMALL.items() if name != "vertices"}
    assert bpy.ops.farfield.packages_export(folder=str(folder / "site"), pixels=96, tile_size=32, **levels) == {"FINISHED"}
    assert (folder / "site" / "index.html").read_text() == "My page" and (other / "index.html").is_file()


def test_a_terrain_contains_no_input_of_its_build(folder):
    store = folder / "store"
    store.mkdir()
    np.save(store / "dem.npy", np.zeros((9, 9), np.float32))
    sources = [{"name": str(store / "dem.npy")}]
    call = lambda: bpy.ops.farfield.bdam_build(sources=sources, store=str(store))  # noqa: E731
    assert "which contains" in refusal(call, folder)
    call = lambda: bpy.ops.farfield.bdam_build(sources=sources, store=str(folder))  # noqa: E731
    assert "which contains the open file" in refusal(call, folder)


@pytest.mark.parametrize("suffix", [".glb", ".btf"])
def test_relightable_textures_replace_no_file_of_the_scene(folder, suffix):
    path = folder / f"library{suffix}"
    path.write_bytes(b"mine")
    bpy.data.images["Checker"].filepath = str(path)
    assert "a file of the scene" in refusal(lambda: prepare_export([], path, ExportSettings()), folder)
