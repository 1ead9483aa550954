"""A cloud in Blender: objects that say what they are, quads that lie where their texels are, and a picture like the original's."""

import math

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes, plain_clouds
from farfield.addon.bridge.cameras import scene_camera
from farfield.addon.bridge.capture import capture
from farfield.addon.bridge.clouds import make_cloud, needed_transparent_bounces
from farfield.addon.bridge.images import data_image
from farfield.addon.bridge.temporary import temporary_scene
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.progress import finish


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.fresh()


def made_cloud(source, directions, texel, textures=True, joined=False):
    """A plain cloud of `source` and the collection made of it."""
    cloud = plain_clouds.cloud_of_directions(source.mesh, directions, texel, joined)
    captured = finish(capture(source, cloud, BillboardSettings(samples=4))) if textures else None
    return cloud, make_cloud(cloud, captured, source, bpy.context.scene.collection)


def picture(shown: bpy.types.Object, sun_direction: tuple[float, float, float]) -> np.ndarray:
    """A small Cycles render of one object under a sun and a grey sky."""
    from mathutils import Vector

    with temporary_scene("Picture") as work:
        work.scene.collection.objects.link(shown)
        work.scene.render.engine = "CYCLES"
        work.scene.cycles.samples, work.scene.cycles.use_denoising = 24, False
        work.scene.render.resolution_x = work.scene.render.resolution_y = 64
        work.scene.render.film_transparent = True
        sun = work.add(work.keep(bpy.data.lights.new("Sun", "SUN")))
        sun.data.energy = 3.0
        sun.rotation_euler = Vector(sun_direction).to_track_quat("Z", "Y").to_euler()
        towards = Vector((0.3, -1.0, 0.4)).normalized()
        work.camera.location = towards * 8.0
        work.camera.rotation_euler = towards.to_track_quat("Z", "Y").to_euler()
        work.camera.data.angle = 0.4
        shown.hide_render = False
        return work.render()


def test_levels_say_what_they_are():
    box = blender_scenes.box("Kiste ä")
    box.location = (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    source = blender_scenes.taken(box)
    cloud, collection = made_cloud(source, plain_clouds.six_directions(), 0.1)
    level = collection.objects[0]
    assert (collection.name, level.name) == ("Kiste ä Cloud", "Kiste ä Cloud L0")
    assert (level["farfield_kind"], level["farfield_level"], level["farfield_quads"]) == ("cloud", 0, 6)
    assert level["farfield_error"] == pytest.approx(cloud.levels[0].error)
    assert level["farfield_texels"] == 6 * 20 * 20
    assert level["farfield_texture_bytes"] > 0
    assert level.matrix_basis.to_translation() == box.location
    assert not level.hide_render
    assert all(image.packed_files for image in bpy.data.images if "Cloud" in image.name)


def test_a_quad_spans_its_rectangle_of_the_texture():
    cloud, collection = made_cloud(blender_scenes.taken(blender_scenes.box()), plain_clouds.six_directions(), 0.1, textures=False)
    mesh, level = collection.objects[0].data, cloud.levels[0]
    uvs = np.array([corner.uv for corner in mesh.uv_layers[0].data]).reshape(6, 4, 2) * level.atlas.size
    positions = np.array([vertex.co for vertex in mesh.vertices]).reshape(6, 4, 3)
    assert positions == pytest.approx(level.quads.corners(), abs=1e-5)
    assert uvs.min(axis=1) == pytest.approx(level.atlas.rectangles[:, :2], abs=1e-3)
    assert np.ptp(uvs, axis=1) == pytest.approx(level.atlas.rectangles[:, 2:], abs=1e-3)


@pytest.mark.parametrize("sun", [(1.0, -0.5, 1.0), (-1.0, 0.2, 0.3)], ids=["front", "grazing"])
def test_a_ball_of_quads_is_lit_like_the_ball(sun):
    ball = blender_scenes.ball(made=blender_scenes.material("Clay", (0.8, 0.4, 0.2), 0.6))
    _, collection = made_cloud(blender_scenes.taken(ball), plain_clouds.spread_directions(60), 0.04, joined=True)
    original, cloud = picture(ball, sun), picture(collection.objects[0], sun)
    both = np.minimum(original[..., 3], cloud[..., 3]) > 0.99
    assert both.sum() > 0.85 * (original[..., 3] > 0.99).sum()
    difference = np.abs(original - cloud)[both][:, :3].mean()
    assert difference < 0.12 * original[both][:, :3].mean()


def test_colours_under_no_alpha_survive_packing_and_saving(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 4)).astype(np.float32) / 255.0
    pixels[:4, :, 3] = 0.0
    for is_data in (False, True):
        data_image(f"Data {is_data}", pixels, is_data)
    bpy.data.images["Data True"].use_fake_user = bpy.data.images["Data False"].use_fake_user = True
    path = str(tmp_path / "packed ü.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    for is_data in (False, True):
        image = bpy.data.images[f"Data {is_data}"]
        assert image.colorspace_settings.is_data == is_data
        read = np.empty(256, np.float32)
        image.pixels.foreach_get(read)
        assert read.reshape(8, 8, 4) == pytest.approx(pixels, abs=0.5 / 255.0)


def test_one_node_group_serves_all_clouds():
    source = blender_scenes.taken(blender_scenes.box())
    made_cloud(source, plain_clouds.six_directions(), 0.5)
    made_cloud(source, plain_clouds.six_directions(), 0.5)
    assert len(bpy.data.node_groups) == 1


def test_more_quads_behind_each_other_need_more_transparent_bounces():
    source = blender_scenes.taken(blender_scenes.ball())
    level = made_cloud(source, plain_clouds.spread_directions(6), 0.1, textures=False)[1].objects[0]
    once, together = needed_transparent_bounces([level] * 20), needed_transparent_bounces([level] * 20, together=True)
    assert 32 <= once < together <= 1024


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(640, 480), (480, 640)])
def test_the_camera_sees_as_many_pixels_as_it_renders(fit, size):
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    scene = bpy.context.scene
    data = bpy.data.cameras.new("Camera")
    scene.camera = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(scene.camera)
    data.sensor_fit, data.sensor_height = fit, 20.0
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.context.view_layer.update()
    camera = scene_camera(scene)
    length = camera.pixel_size(10.0) * 100.0
    left, right = (world_to_camera_view(scene, scene.camera, Vector((x, 0.0, -10.0))) for x in (0.0, length))
    assert (right - left).x * size[0] == pytest.approx(100.0, rel=1e-4)
    assert camera.switch_distance(1.0) > 0.0 and math.isfinite(camera.switch_distance(1.0))
