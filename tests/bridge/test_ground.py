"""The material of the ground: detail down to centimeters near the viewer, and none that pixels cannot show."""

import math
from types import MappingProxyType

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.clipbox.materials import create_terrain_material

PIXELS = 48


def render_ground(folder, height, meter=1.0, terrain="dunes", values=MappingProxyType({}), place=(0.0, 0.0)):
    """The color (N, N, 3) of level ground from above, `height` meters above it, without light and shadow; rows go along y.

    values: of inputs of the group. place: of the terrain, meters.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene, height = bpy.context.scene, height * meter
    root = bpy.data.objects.new("Root", None)
    root.location = -place[0] * meter, -place[1] * meter, 0.0
    mesh = bpy.data.meshes.new("Ground")
    mesh.from_pydata([(-height, -height, 0), (height, -height, 0), (height, height, 0), (-height, height, 0)], [], [(0, 1, 2, 3)])
    material = create_terrain_material("Ground", root, -100.0 * meter, 100.0 * meter, meter, terrain=terrain, meter=meter)
    mesh.materials.append(material)
    tree = material.node_tree
    group = next(node for node in tree.nodes if node.type == "GROUP")
    for name, value in values.items():
        group.inputs[name].default_value = value
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(group.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL").inputs["Surface"])
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    for item in (root, bpy.data.objects.new("Ground", mesh), camera):
        scene.collection.objects.link(item)
    camera.location.z, camera.data.clip_end, camera.data.clip_start = height, 1e5, 1e-3
    camera.data.angle = PIXELS * 0.001  # About the angle between pixels that the ground is made for.
    scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 4
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    scene.view_settings.view_transform, scene.render.image_settings.file_format = "Raw", "OPEN_EXR"
    scene.render.filepath = str(folder / "ground.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    return np.array(image.pixels).reshape(PIXELS, PIXELS, 4)[..., :3]


def variation(colors):
    """The standard deviation between neighbors along x, relative to the mean."""
    return float(np.diff(colors.mean(axis=2), axis=1).std() / colors.mean())


def change(folder, height, terrain, first, second, **options):
    """How the color (N, N) of the ground differs with the second of two sets of inputs of its group."""
    colors = [render_ground(folder, height, terrain=terrain, values=values, **options) for values in (first, second)]
    return (colors[1] - colors[0]).mean(axis=2)


def find_direction(values):
    """The direction in which values (N, N) change most, radians from the x axis, and how much less they do across it, from 0 to 1."""
    y, x = np.gradient(values)
    along, across, both = (x * x).mean(), (y * y).mean(), 2.0 * (x * y).mean()
    return 0.5 * math.atan2(both, along - across), math.hypot(along - across, both) / (along + across)


@pytest.mark.slow
def test_ripples_lie_across_a_wind_that_turns_and_are_none_far_away(tmp_path):
    directions = []
    for place in ((0.0, 0.0), (0.0, 40.0)):
        angle, clearness = find_direction(change(tmp_path, 20.0, "dunes", {"Ripples": 0.0}, {"Ripples": 1.0}, place=place))
        assert clearness > 0.35
        directions.append(angle)
    assert max(map(abs, directions)) < math.radians(60.0)
    assert abs(directions[0] - directions[1]) > math.radians(5.0)
    assert np.abs(change(tmp_path, 5000.0, "dunes", {"Ripples": 0.0}, {"Ripples": 1.0})).max() < 1e-6


@pytest.mark.slow
def test_low_ground_is_moist_and_high_ground_is_dry(tmp_path):
    low, high = (render_ground(tmp_path, 60.0, terrain="hills", values={"Middle Height": height}) for height in (100.0, -100.0))
    assert high.mean() > 1.15 * low.mean()
    assert (high[..., 0] / high[..., 1]).mean() > 1.05 * (low[..., 0] / low[..., 1]).mean()


@pytest.mark.slow
def test_blades_of_grass_change_the_texture_nearby_but_not_the_mean(tmp_path):
    smooth, grass = (render_ground(tmp_path, 3.0, terrain="hills", values={"Blades": blades}) for blades in (0.0, 1.0))
    assert variation(grass) > 1.5 * variation(smooth)
    assert grass.mean() == pytest.approx(smooth.mean(), rel=0.15)
    assert np.abs(change(tmp_path, 5000.0, "hills", {"Blades": 0.0}, {"Blades": 1.0})).max() < 1e-6


@pytest.mark.slow
def test_a_shore_has_a_beach_that_is_wet_near_the_water_and_a_broken_line_of_foam(tmp_path):
    beach, wet, foam = (render_ground(tmp_path, 120.0, terrain="coast", values={"Water Height": -z}) for z in (1.2, 0.4, 0.1))
    assert beach[..., 0].mean() > 1.1 * beach[..., 1].mean()  # Sand instead of grass.
    assert wet.mean() < 0.8 * beach.mean()
    limit = 1.2 * float(wet.min(axis=2).max())
    assert 0.002 < (foam.min(axis=2) > limit).mean() < 0.6


@pytest.mark.slow
def test_dry_ground_is_bare_in_patches(tmp_path):
    colors = render_ground(tmp_path, 3000.0, terrain="hills", values={"Moisture": -0.4, "Scree": (0.0, 0.0, 1.0, 1.0)})
    assert 0.02 < (colors[..., 2] > colors[..., 0]).mean() < 0.8


@pytest.mark.slow
def test_pebbles_lie_in_some_places_only(tmp_path):
    pebbles = np.abs(change(tmp_path, 20.0, "mesas", {"Pebbles": 0.0}, {"Pebbles": 1.0})) > 0.01
    assert 0.02 < pebbles.mean() < 0.9


@pytest.mark.slow
@pytest.mark.parametrize("terrain", ["hills", "mesas"])
def test_the_ground_has_detail_at_the_size_of_pixels_near_and_far(tmp_path, terrain):
    for height in (3.0, 30.0):
        assert 0.01 < variation(render_ground(tmp_path, height, terrain=terrain)) < 0.3


@pytest.mark.slow
def test_a_terrain_of_another_scale_looks_the_same_from_where_it_is_as_large(tmp_path):
    full, quarter = (render_ground(tmp_path, 10.0, meter, terrain="hills") for meter in (1.0, 0.25))
    np.testing.assert_allclose(full, quarter, atol=0.02 * float(full.mean()))
    assert math.isfinite(full.sum())
