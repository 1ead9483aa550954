"""The demo's forest: a thousand instances of one relightable cloud, and a day of drivers and keyframes."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy
import mathutils
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from bridge import bakes, blender_scenes
from farfield.addon.bridge.btf.materials.emission_material import AMBIENT, SUNS, sun_color_property, sun_direction_property, sun_node_labels
from farfield.addon.bridge.rendering.render_scene import render_scene
from farfield.addon.core.errors import FileError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.job_run import run_job
from lib import demo_forest, scene_files
from lib.demo_relighting import copy_level_as_cloud
from lib.studio import bounding_sphere, look_at_matrix

PIXELS = 40


@pytest.fixture(scope="module")
def forest_file(extension, tmp_path_factory):
    """A file with a forest of a ball's cloud with one level, small enough to be rendered within seconds."""
    blender_scenes.reset_scene()
    cloud = copy_level_as_cloud(bakes.build_small_cloud(), 1)
    run_to_end(run_job(bakes.prepare_job(cloud, None)))
    path = tmp_path_factory.mktemp("forest") / "Wäldchen.blend"
    demo_forest.write_forest(cloud, path, width=48, samples=1)
    return path


@pytest.fixture
def level(forest_file):
    """The level object of that file, which is opened."""
    scene_files.open_scene(forest_file)
    (level,) = (item for item in bpy.data.objects if item.get("farfield_kind") == "cloud")
    return level


def render(item: bpy.types.Object, angle: float, center: np.ndarray, radius: float) -> np.ndarray:
    """Render `item` in Cycles (PIXELS, PIXELS, 4), from a direction rotated about Z by `angle`."""
    direction = mathutils.Matrix.Rotation(angle, 3, "Z") @ mathutils.Vector((0.6, -0.64, 0.48))
    with render_scene("Instance") as work:
        work.scene.collection.objects.link(item)
        work.scene.render.engine, work.scene.render.film_transparent = "CYCLES", True
        work.scene.cycles.samples, work.scene.cycles.use_denoising = 1, False
        work.scene.cycles.pixel_filter_type, work.scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        work.scene.render.resolution_x = work.scene.render.resolution_y = PIXELS
        work.camera.data.type, work.camera.data.ortho_scale = "ORTHO", 2.2 * radius
        work.camera.matrix_world = look_at_matrix(np.array(direction), center + 4.0 * radius * np.array(direction))
        return work.render()


@pytest.mark.slow
def test_a_rotated_instance_under_a_rotated_sun_looks_the_same(level):
    center, radius = bounding_sphere([level])
    sun = bpy.data.objects["Sun"]
    before = render(level, 0.0, center, radius)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", level.users_collection[0]
    instance.rotation_euler.z = 2.0
    instance.location = base = level.users_collection[0].instance_offset
    center = np.array(base + mathutils.Matrix.Rotation(2.0, 3, "Z") @ (mathutils.Vector(center) - base))
    sun.animation_data_clear()
    sun.rotation_euler.rotate(mathutils.Euler((0.0, 0.0, 2.0)))
    bpy.context.view_layer.update()
    after = render(instance, 2.0, center, radius)
    assert (before[..., 3] > 0.5).mean() > 0.1 and before[..., :3].max() > 0.05
    is_close = np.isclose(before, after, rtol=0.02, atol=0.01).all(axis=-1)
    assert is_close.mean() > 0.99, "except pixels on an edge"
    sun.rotation_euler.rotate(mathutils.Euler((0.0, 0.0, np.pi)))
    bpy.context.view_layer.update()
    assert not np.allclose(after, render(instance, 2.0, center, radius), rtol=0.02, atol=0.01)


@pytest.mark.slow
def test_the_day_needs_no_python(level):
    scene = bpy.context.scene
    (collection,) = level.users_collection
    assert sum(item.instance_collection == collection for item in scene.objects) == demo_forest.TREE_COUNT == 1000
    assert [item for item in bpy.data.objects if item.type == "MESH" and item != level and item.name != "Ground"] == []
    for index, hour in enumerate(demo_forest.DAY):
        scene.frame_set(demo_forest.frame_of_hour(index))
        evaluated = level.evaluated_get(bpy.context.evaluated_depsgraph_get())
        direction = np.array(hour.sun_direction) / np.linalg.norm(hour.sun_direction)
        np.testing.assert_allclose(evaluated[sun_direction_property(0)], direction, atol=1e-5)
        np.testing.assert_allclose(evaluated[sun_color_property(0)], hour.strength * np.array(hour.color), rtol=1e-5)
        np.testing.assert_allclose(evaluated[AMBIENT], hour.sky_radiance, rtol=1e-5)
        assert direction[2] > 0.0


@pytest.mark.slow
def test_the_nodes_of_unlinked_suns_are_muted(level):
    muted = {node.label: node.mute for node in level.data.materials[0].node_tree.nodes if node.type == "GROUP" and node.label}
    assert muted == {label: number > 0 for number in range(SUNS) for label in sun_node_labels(number)}


@pytest.mark.slow
def test_its_times_of_day_are_rendered_by_another_process(forest_file):
    steps = []
    sheet = run_to_end(demo_forest.render_day(forest_file), steps.append)
    assert {step.label.rpartition(" ")[2] for step in steps} <= {hour.name for hour in demo_forest.DAY}
    assert sheet.shape[1] > 3 * 48 and sheet.min() < 0.2
    assert len(np.unique(sheet.round(2).reshape(-1, 3), axis=0)) > 100


@pytest.mark.slow
def test_a_file_that_cannot_be_rendered_is_named(tmp_path):
    with pytest.raises(FileError, match=r"none\.blend.* was not rendered: .*Open the file"):
        run_to_end(demo_forest.render_day(tmp_path / "none.blend"))


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1))
def test_trees_keep_their_distance(seed):
    positions = demo_forest.tree_positions(np.random.default_rng(seed))
    assert positions.shape == (demo_forest.TREE_COUNT, 2)
    nearest = cKDTree(positions).query(positions, 2)[0][:, 1]
    assert nearest.min() >= (1.0 - 2.0 * demo_forest.JITTER) * demo_forest.SPACING - 1e-9
    assert positions[:, 1].min() >= -demo_forest.JITTER * demo_forest.SPACING
    assert np.linalg.norm(positions, axis=1).min() > 0.5 * demo_forest.SPACING, "a tree overlaps the cloud itself"
