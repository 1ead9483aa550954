"""Sky, Sun and haze of terrains."""

import math

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge import sky
from farfield.addon.bridge.shading.node_builder import create_node_material
from farfield.addon.core.sky import LIGHT_VALUES, SkySettings

SIZE, PIXELS = 100.0, 8


@pytest.fixture(autouse=True)
def empty_scene():
    """A scene without anything."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def hazy_wall(distance, haze, height):
    """A black wall with haze in front of a camera at a height, and its scene."""
    scene = bpy.context.scene
    settings = SkySettings(haze=haze, sun_direction=0.0)
    material, builder = create_node_material("Wall")
    emission = builder.node("ShaderNodeEmission")
    emission.inputs["Strength"].default_value = 0.0
    builder.connect(emission.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    sky.add_haze([material], settings, SIZE, 0.0)
    mesh = bpy.data.meshes.new("Wall")
    corners = [(-1e5, distance, -1e5), (1e5, distance, -1e5), (1e5, distance, 1e5), (-1e5, distance, 1e5)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    mesh.materials.append(material)
    wall, camera = bpy.data.objects.new("Wall", mesh), bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    for item in (wall, camera):
        scene.collection.objects.link(item)
    camera.location, camera.rotation_euler, camera.data.angle = (0.0, 0.0, height), (0.5 * math.pi, 0.0, 0.0), 0.01
    scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 1
    camera.data.clip_end = 1e7
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    scene.view_settings.view_transform, scene.render.image_settings.file_format = "Raw", "OPEN_EXR"
    return scene, wall


def render(scene, folder):
    """The mean of a render, scene-linear."""
    scene.render.filepath = str(folder / "wall.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    mean = np.array(image.pixels).reshape(-1, 4)[:, :3].mean()
    bpy.data.images.remove(image)
    return mean


@pytest.mark.parametrize("height", [pytest.param(0.0, marks=pytest.mark.slow), 30.0])
def test_haze_is_the_fraction_that_was_asked_for_at_half_the_size_and_thins_with_height(tmp_path, height):
    scene, wall = hazy_wall(0.5 * SIZE, 0.4, height)
    near = render(scene, tmp_path)
    wall.location.y = 1e6
    far = render(scene, tmp_path)  # Nothing but haze.
    expected = 1.0 - 0.6 ** math.exp(-height / (sky.HAZE_HEIGHT * SIZE))
    assert near / far == pytest.approx(expected, rel=0.02)


def test_the_world_of_the_user_stays_and_a_second_time_changes_the_first():
    scene = bpy.context.scene
    own = scene.world = bpy.data.worlds.new("Mine")
    sun = sky.add_sky(scene, SkySettings(light="midday", sun_direction=0.5 * math.pi))
    assert own.use_fake_user and scene.world is not own
    to_sun = sun.rotation_euler.to_matrix() @ mathutils.Vector((0.0, 0.0, 1.0))
    elevation = LIGHT_VALUES["midday"].elevation
    assert np.allclose(to_sun, (math.cos(elevation), 0.0, math.sin(elevation)), atol=1e-6)
    again = sky.add_sky(scene, SkySettings(light="golden_hour"))
    assert again == sun and len(bpy.data.worlds) == 2 and len(bpy.data.lights) == 1
    assert sun.data.color[0] == pytest.approx(1.0) and sun.data.color[2] < 0.5


@pytest.mark.slow
def test_no_direction_of_the_world_is_black(tmp_path):
    scene, wall = hazy_wall(0.5 * SIZE, 0.4, 0.0)
    bpy.data.objects.remove(wall)
    sky.add_sky(scene, SkySettings())
    scene.camera.rotation_euler = (0.0, 0.0, 0.0)  # Straight down.
    assert render(scene, tmp_path) > 0.05


def sky_seen(scene, folder, pitch, **settings):
    """The mean of the sky in a small field of view above the horizon, scene-linear."""
    sky.add_sky(scene, SkySettings(sun_direction=0.0, **settings))
    scene.world.cycles.sampling_method = "NONE"  # The camera looks at the sky: nothing in the scene is lit by it.
    scene.camera.rotation_euler = (0.5 * math.pi + pitch, 0.0, 0.0)
    return render(scene, folder)


def test_clouds_cover_the_sky_by_their_setting_and_end_in_the_haze_of_the_horizon(tmp_path):
    scene, wall = hazy_wall(0.5 * SIZE, 0.4, 0.0)
    bpy.data.objects.remove(wall)
    scene.camera.data.angle = 1.5
    means = [sky_seen(scene, tmp_path, 0.5 * math.pi, clouds=cover) for cover in (0.0, 0.2, 0.5)]
    assert 1.1 * means[0] < means[1] and 1.1 * means[1] < means[2]  # Clouds are brighter than the blue of the zenith.
    scene.camera.data.angle = 0.01
    horizon = [sky_seen(scene, tmp_path, 0.01, clouds=cover) for cover in (0.0, 1.0)]
    assert horizon[0] == pytest.approx(horizon[1], rel=1e-3)


def test_haze_is_added_once():
    material, builder = create_node_material("Ground")
    builder.connect(builder.node("ShaderNodeBsdfPrincipled").outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    for haze in (0.2, 0.0):
        sky.add_haze([material], SkySettings(haze=haze), SIZE, 3.0)
    groups = [node for node in material.node_tree.nodes if node.type == "GROUP"]
    assert len(groups) == 1 and groups[0].inputs["Base Height"].default_value == 3.0
    assert groups[0].inputs["Distance"].default_value > 1e9
    output = next(node for node in material.node_tree.nodes if node.type == "OUTPUT_MATERIAL")
    assert output.inputs["Surface"].links[0].from_node == groups[0]


def test_the_light_of_a_preset_is_that_of_the_next_sky_and_a_chosen_one_stays(extension):
    last = bpy.context.scene.farfield_clipbox_sky
    bpy.ops.farfield.preset_apply(tool="clipbox", name="Canyon")
    bpy.ops.farfield.add_sky()
    sun = next(item for item in bpy.context.scene.objects if item.type == "LIGHT")
    assert sun.data.energy == pytest.approx(LIGHT_VALUES[last.light].strength) and last.light != SkySettings().light
    bpy.ops.farfield.add_sky(light="overcast")
    assert last.light == "overcast"
