"""The material of the ground: detail down to centimeters near the viewer, and none that pixels cannot show."""

import math

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.clipbox.materials import create_terrain_material

PIXELS = 48


def render_ground(folder, height, meter=1.0, ripples=None, terrain="dunes"):
    """The color (N, N, 3) of level ground from above, `height` meters above it, without light and shadow; rows go along y."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene, height = bpy.context.scene, height * meter
    root = bpy.data.objects.new("Root", None)
    mesh = bpy.data.meshes.new("Ground")
    mesh.from_pydata([(-height, -height, 0), (height, -height, 0), (height, height, 0), (-height, height, 0)], [], [(0, 1, 2, 3)])
    material = create_terrain_material("Ground", root, -100.0 * meter, 100.0 * meter, meter, terrain=terrain, meter=meter)
    mesh.materials.append(material)
    tree = material.node_tree
    group = next(node for node in tree.nodes if node.type == "GROUP")
    if ripples is not None:
        group.inputs["Ripples"].default_value = ripples
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


@pytest.mark.slow
def test_ripples_lie_across_the_wind_near_the_viewer_and_are_none_far_away(tmp_path):
    near, smooth = (render_ground(tmp_path, 20.0, ripples=ripples) for ripples in (1.0, 0.0))
    ripples = (near - smooth).mean(axis=2)
    assert np.diff(ripples, axis=1).std() > 1.5 * np.diff(ripples, axis=0).std() > 0.0
    far = [render_ground(tmp_path, 5000.0, ripples=ripples) for ripples in (1.0, 0.0)]
    np.testing.assert_allclose(*far, atol=1e-6)


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
