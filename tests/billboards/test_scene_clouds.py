"""A cloud in Blender: custom properties of its objects, UVs of its quads, and renders like those of the source."""

import math

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes, pbr_clouds
from farfield.addon.bridge.billboards.capture import capture_textures
from farfield.addon.bridge.billboards.clouds import create_cloud
from farfield.addon.bridge.cameras import read_scene_camera
from farfield.addon.bridge.imaging.images import create_image
from farfield.addon.bridge.rendering.render_properties import estimate_transparent_bounces
from farfield.addon.bridge.rendering.render_scene import render_scene
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.jobs.progress import run_to_end


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.reset_scene()


def create_simple_cloud(source, directions, texel, textures=True, joined=False):
    """Return a simple cloud of `source` and its collection."""
    cloud = pbr_clouds.cloud_of_directions(source.mesh, directions, texel, joined)
    captured = run_to_end(capture_textures(source, cloud, BillboardSettings(samples=4))) if textures else None
    return cloud, create_cloud(cloud, captured, source, bpy.context.scene.collection)


def render_object(item: bpy.types.Object, sun_direction: tuple[float, float, float]) -> np.ndarray:
    """Return a small Cycles render of one object under a Sun light and a gray sky."""
    from mathutils import Vector

    with render_scene("Render") as work:
        work.scene.collection.objects.link(item)
        work.scene.render.engine = "CYCLES"
        work.scene.cycles.samples, work.scene.cycles.use_denoising = 24, False
        work.scene.render.resolution_x = work.scene.render.resolution_y = 64
        work.scene.render.film_transparent = True
        sun = work.add_object(work.own(bpy.data.lights.new("Sun", "SUN")))
        sun.data.energy = 3.0
        sun.rotation_euler = Vector(sun_direction).to_track_quat("Z", "Y").to_euler()
        direction = Vector((0.3, -1.0, 0.4)).normalized()
        work.camera.location = direction * 8.0
        work.camera.rotation_euler = direction.to_track_quat("Z", "Y").to_euler()
        work.camera.data.angle = 0.4
        item.hide_render = False
        return work.render()


def test_custom_properties_of_levels():
    box = blender_scenes.box("Kiste ä")
    box.location = (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    source = blender_scenes.read_objects(box)
    cloud, collection = create_simple_cloud(source, pbr_clouds.axis_directions(), 0.1)
    level = collection.objects[0]
    assert (collection.name, level.name) == ("Kiste ä Cloud", "Kiste ä Cloud L0")
    assert (level["farfield_kind"], level["farfield_level"], level["farfield_quads"]) == ("cloud", 0, 6)
    assert level["farfield_error"] == pytest.approx(cloud.levels[0].error)
    assert level["farfield_texels"] == 6 * 20 * 20
    assert level["farfield_texture_bytes"] > 0
    assert level.matrix_basis.to_translation() == box.location
    assert not level.hide_render
    assert all(image.packed_files for image in bpy.data.images if "Cloud" in image.name)


def test_quads_span_their_rectangles_of_the_texture():
    cloud, collection = create_simple_cloud(
        blender_scenes.read_objects(blender_scenes.box()), pbr_clouds.axis_directions(), 0.1, textures=False
    )
    mesh, level = collection.objects[0].data, cloud.levels[0]
    uvs = np.array([corner.uv for corner in mesh.uv_layers[0].data]).reshape(6, 4, 2) * level.atlas.size
    positions = np.array([vertex.co for vertex in mesh.vertices]).reshape(6, 4, 3)
    assert positions == pytest.approx(level.quads.corners(), abs=1e-5)
    assert uvs.min(axis=1) == pytest.approx(pbr_clouds.quad_corners(level.atlas), abs=1e-3)
    assert np.ptp(uvs, axis=1) == pytest.approx(level.atlas.quad_sizes, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("sun", [(1.0, -0.5, 1.0), (-1.0, 0.2, 0.3)], ids=["front", "grazing"])
def test_ball_of_quads_is_lit_like_the_ball(sun):
    ball = blender_scenes.ball(material=blender_scenes.create_material("Clay", (0.8, 0.4, 0.2), 0.6))
    _, collection = create_simple_cloud(blender_scenes.read_objects(ball), pbr_clouds.spiral_directions(60), 0.04, joined=True)
    source, cloud = render_object(ball, sun), render_object(collection.objects[0], sun)
    both = np.minimum(source[..., 3], cloud[..., 3]) > 0.99
    assert both.sum() > 0.85 * (source[..., 3] > 0.99).sum()
    difference = np.abs(source - cloud)[both][:, :3].mean()
    assert difference < 0.12 * source[both][:, :3].mean()


def test_colors_without_alpha_survive_packing_and_saving(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (8, 8, 4)).astype(np.float32) / 255.0
    pixels[:4, :, 3] = 0.0
    for is_data in (False, True):
        create_image(f"Data {is_data}", pixels, is_data)
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


def test_all_clouds_use_one_node_group():
    source = blender_scenes.read_objects(blender_scenes.box())
    create_simple_cloud(source, pbr_clouds.axis_directions(), 0.5)
    create_simple_cloud(source, pbr_clouds.axis_directions(), 0.5)
    assert len(bpy.data.node_groups) == 1


def test_stacked_quads_need_more_transparent_bounces():
    source = blender_scenes.read_objects(blender_scenes.ball())
    level = create_simple_cloud(source, pbr_clouds.spiral_directions(6), 0.1, textures=False)[1].objects[0]
    single, stacked = estimate_transparent_bounces([level] * 20), estimate_transparent_bounces([level] * 20, all_visible=True)
    assert 32 <= single < stacked <= 1024


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(640, 480), (480, 640)])
def test_pixel_size_of_camera_matches_its_renders(fit, size):
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    scene = bpy.context.scene
    data = bpy.data.cameras.new("Camera")
    scene.camera = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(scene.camera)
    data.sensor_fit, data.sensor_height = fit, 20.0
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.context.view_layer.update()
    camera = read_scene_camera(scene)
    length = camera.pixel_size(10.0) * 100.0
    left, right = (world_to_camera_view(scene, scene.camera, Vector((x, 0.0, -10.0))) for x in (0.0, length))
    assert (right - left).x * size[0] == pytest.approx(100.0, rel=1e-4)
    assert camera.switch_distance(1.0) > 0.0 and math.isfinite(camera.switch_distance(1.0))
