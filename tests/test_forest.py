"""The demo's forest: one relightable cloud, a thousand instances, a day that passes with drivers and keys alone."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy
import mathutils
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import forest
import scene_files
from bridge import bakes, blender_scenes
from demo_relighting import cloud_of_level
from farfield.addon.bridge.btf_materials import AMBIENT, SUNS, light_property, sun_labels, sun_property
from farfield.addon.bridge.temporary import temporary_scene
from farfield.addon.core.errors import FileError
from farfield.addon.core.progress import finish
from farfield.addon.operators.long_work import whole
from studio import bounds, looking_along

PIXELS = 40


@pytest.fixture(scope="module")
def forest_file(extension, tmp_path_factory):
    """A forest of a ball's cloud of one level, small enough to be rendered within seconds."""
    blender_scenes.fresh()
    cloud = cloud_of_level(bakes.small_cloud(), 1)
    finish(whole(bakes.job_of(cloud, None)))
    path = tmp_path_factory.mktemp("forest") / "Wäldchen.blend"
    forest.write_forest(cloud, path, width=48, samples=1)
    return path


@pytest.fixture
def level(forest_file):
    """The level object of that file, which is open."""
    scene_files.open_scene(forest_file)
    (level,) = (item for item in bpy.data.objects if item.get("farfield_kind") == "cloud")
    return level


def picture(shown: bpy.types.Object, turn: float, center: np.ndarray, reach: float) -> np.ndarray:
    """A Cycles render (PIXELS, PIXELS, 4) of `shown`, from a side that is turned about Z by `turn`."""
    towards = mathutils.Matrix.Rotation(turn, 3, "Z") @ mathutils.Vector((0.6, -0.64, 0.48))
    with temporary_scene("Instance") as work:
        work.scene.collection.objects.link(shown)
        work.scene.render.engine, work.scene.render.film_transparent = "CYCLES", True
        work.scene.cycles.samples, work.scene.cycles.use_denoising = 1, False
        work.scene.cycles.pixel_filter_type, work.scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        work.scene.render.resolution_x = work.scene.render.resolution_y = PIXELS
        work.camera.data.type, work.camera.data.ortho_scale = "ORTHO", 2.2 * reach
        work.camera.matrix_world = looking_along(np.array(towards), center + 4.0 * reach * np.array(towards))
        return work.render()


def test_a_turned_instance_under_a_turned_sun_looks_the_same(level):
    center, reach = bounds([level])
    sun = bpy.data.objects["Sun"]
    before = picture(level, 0.0, center, reach)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", level.users_collection[0]
    instance.rotation_euler.z = 2.0
    instance.location = foot = level.users_collection[0].instance_offset
    center = np.array(foot + mathutils.Matrix.Rotation(2.0, 3, "Z") @ (mathutils.Vector(center) - foot))
    sun.animation_data_clear()
    sun.rotation_euler.rotate(mathutils.Euler((0.0, 0.0, 2.0)))
    bpy.context.view_layer.update()
    after = picture(instance, 2.0, center, reach)
    assert (before[..., 3] > 0.5).mean() > 0.1 and before[..., :3].max() > 0.05
    same = np.isclose(before, after, rtol=0.02, atol=0.01).all(axis=-1)
    assert same.mean() > 0.99, "but for pixels on an edge"
    sun.rotation_euler.rotate(mathutils.Euler((0.0, 0.0, np.pi)))
    bpy.context.view_layer.update()
    assert not np.allclose(after, picture(instance, 2.0, center, reach), rtol=0.02, atol=0.01)


def test_the_day_passes_without_python(level):
    scene = bpy.context.scene
    (collection,) = level.users_collection
    assert sum(item.instance_collection == collection for item in scene.objects) == forest.TREES == 1000
    assert [item for item in bpy.data.objects if item.type == "MESH" and item != level and item.name != "Ground"] == []
    for number, hour in enumerate(forest.DAY):
        scene.frame_set(forest.frame_of(number))
        seen = level.evaluated_get(bpy.context.evaluated_depsgraph_get())
        towards = np.array(hour.towards_sun) / np.linalg.norm(hour.towards_sun)
        np.testing.assert_allclose(seen[sun_property(0)], towards, atol=1e-5)
        np.testing.assert_allclose(seen[light_property(0)], hour.strength * np.array(hour.colour), rtol=1e-5)
        np.testing.assert_allclose(seen[AMBIENT], hour.sky, rtol=1e-5)
        assert towards[2] > 0.0


def test_suns_that_do_not_shine_are_not_worked_out(level):
    muted = {node.label: node.mute for node in level.data.materials[0].node_tree.nodes if node.type == "GROUP" and node.label}
    assert muted == {label: number > 0 for number in range(SUNS) for label in sun_labels(number)}


def test_its_hours_are_rendered_by_another_process(forest_file):
    steps = []
    sheet = finish(forest.render_day(forest_file), steps.append)
    assert {step.label.rpartition(" ")[2] for step in steps} <= {hour.name for hour in forest.DAY}
    assert sheet.shape[1] > 3 * 48 and sheet.min() < 0.2
    assert len(np.unique(sheet.round(2).reshape(-1, 3), axis=0)) > 100


def test_a_file_that_cannot_be_rendered_is_named(tmp_path):
    with pytest.raises(FileError, match=r"none\.blend.* was not rendered: .*Open it"):
        finish(forest.render_day(tmp_path / "none.blend"))


@given(st.integers(0, 2**32 - 1))
def test_trees_keep_apart_and_stand_in_view(seed):
    places = forest.places(np.random.default_rng(seed))
    assert places.shape == (forest.TREES, 2)
    nearest = cKDTree(places).query(places, 2)[0][:, 1]
    assert nearest.min() >= (1.0 - 2.0 * forest.JITTER) * forest.SPACING - 1e-9
    assert places[:, 1].min() >= -forest.JITTER * forest.SPACING
    assert np.linalg.norm(places, axis=1).min() > 0.5 * forest.SPACING, "one stands in the cloud itself"
