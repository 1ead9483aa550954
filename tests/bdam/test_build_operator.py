"""The operator *Build Large Terrain*: files from the panel and from the caller, images of heights, and errors."""

import bpy
import numpy as np
import pytest
from PIL import Image

from farfield.addon.bridge.bdam.objects import SceneTerrain
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.operators.results import read_result

pytestmark = pytest.mark.usefixtures("empty_scene")
SETTINGS = {"patch_size": "16", "executor": "serial", "cell_size": 10.0}


def write_heights(path, seed=1, size=33):
    np.save(path, np.random.default_rng(seed).uniform(0.0, 30.0, (size, size)).astype(np.float32))
    return str(path)


def write_image(path, pixels):
    """Write gray values (H, W), 0 to 1, row 0 at the bottom, as a PNG file with 8 bits."""
    Image.fromarray(np.round(255.0 * pixels[::-1]).astype(np.uint8)).save(path)
    return str(path)


def test_files_and_settings_come_from_the_panel(tmp_path):
    folder = tmp_path / "été"
    folder.mkdir()
    write_heights(folder / "a.npy")
    write_image(folder / "ground.png", np.full((40, 40), 0.5))
    for kind, name in (("SOURCES", "a.npy"), ("IMAGES", "ground.png")):
        for _ in range(2):  # a file that is in the list is not added again
            bpy.ops.farfield.bdam_add_files(kind=kind, directory=str(folder), files=[{"name": name}])
    panel = bpy.context.scene.farfield_bdam_build
    assert [len(panel.files(kind)) for kind in ("SOURCES", "IMAGES")] == [1, 1]
    panel.store, panel.patch_size, panel.executor = str(folder / "store"), "16", "serial"
    assert bpy.ops.farfield.bdam_build() == {"FINISHED"}
    with TerrainStore(folder / "store") as store:
        assert (store.header.rows, store.header.leaf_cells, store.header.cell_size) == (33, 16, 1.0)
        assert store.textures is not None and abs(int(store.textures.read(0)[256, 256, 0]) - 128) <= 2
    bpy.ops.farfield.bdam_remove_file(kind="IMAGES", index=0)
    bpy.ops.farfield.bdam_remove_file(kind="SOURCES")
    assert [len(panel.files(kind)) for kind in ("SOURCES", "IMAGES")] == [0, 0]


def test_the_caller_gives_files_and_settings(tmp_path):
    path, store = write_heights(tmp_path / "a.npy"), tmp_path / "store"
    bpy.context.scene.farfield_bdam_build.images.add().name = "missing.png"
    assert bpy.ops.farfield.bdam_build(sources=[{"name": path}], store=str(store), **SETTINGS) == {"FINISHED"}
    with TerrainStore(store) as terrain:
        assert terrain.header.cell_size == 10.0 and terrain.textures is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npy", "store"]


def test_an_image_has_heights(tmp_path):
    pixels = np.linspace(0.0, 1.0, 40 * 33).reshape(33, 40)
    path, store = write_image(tmp_path / "heights.png", pixels), tmp_path / "store"
    bpy.ops.farfield.bdam_build(sources=[{"name": path}], store=str(store), image_height=510.0, **SETTINGS)
    with TerrainStore(store) as terrain:
        assert (terrain.header.rows, terrain.header.columns, terrain.header.height_step) == (33, 40, 2.0)
        for row in range(len(terrain.levels[-1].indices)):
            patch = terrain.read(len(terrain.levels) - 1, row)
            assert np.abs(2.0 * patch.z - 510.0 * pixels[patch.y, patch.x]).max() <= 1.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"store": "out"}, "at least one elevation model"),
        ({"sources": [{"name": "a.npy"}]}, "set Store"),
        ({"sources": [{"name": "none.npy"}], "store": "out"}, "does not exist"),
        ({"sources": [{"name": "//a.npy"}], "store": "out"}, "never saved"),
        ({"sources": [{"name": "a.npy"}], "store": "out", "images": [{"name": "a.npy"}]}, "texture"),
    ],
)
def test_invalid_input_is_named(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    write_heights(tmp_path / "a.npy")
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.farfield.bdam_build(**arguments, **SETTINGS)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npy"]


def test_build_loads_the_terrain_and_names_holes(tmp_path, capfd):
    heights = np.random.default_rng(1).uniform(0.0, 30.0, (33, 33)).astype(np.float32)
    heights[4:8, 4:8] = np.nan
    np.save(tmp_path / "a.npy", heights)
    arguments = {"sources": [{"name": str(tmp_path / "a.npy")}], "store": str(tmp_path / "store"), **SETTINGS}
    bpy.ops.object.camera_add()
    bpy.context.scene.camera, bpy.context.object.data.clip_end = bpy.context.object, 10.0
    assert bpy.ops.farfield.bdam_build(**arguments, load=True) == {"FINISHED"}
    (terrain,) = SceneTerrain.in_scene(bpy.context.scene)
    assert terrain.folder == tmp_path / "store" and terrain.figures.triangles > 100 and terrain.tiles()
    holes, camera_range, *others = read_result(bpy.context.scene, "bdam")
    assert holes == "1 void filled."
    assert "shows nothing beyond 10 m; raise Clip End" in camera_range and any(" patches, " in sentence for sentence in others)
    bpy.ops.farfield.bdam_remove()
    bpy.ops.farfield.bdam_build(**arguments, fill_holes="none")
    assert "0 voids filled, 1 left of 0.0016 km²; Fill Holes can fill all." in capfd.readouterr().out


def test_a_new_folder_is_proposed_for_the_terrain(tmp_path):
    write_heights(tmp_path / "été.npy")
    (tmp_path / "été terrain").mkdir()
    bpy.ops.farfield.bdam_add_files(kind="SOURCES", directory=str(tmp_path), files=[{"name": "été.npy"}])
    assert bpy.context.scene.farfield_bdam_build.store == str(tmp_path / "été terrain 2")
