"""Within the fade range, each camera ray of a render sees exactly one of two levels."""

import bpy
import numpy as np
import pytest

from distance_scenes import add_box, add_camera, add_scatter, attach_levels
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.compat import set_file_format

pytestmark = pytest.mark.usefixtures("empty_scene")
SIDE = 32
FADE_RANGE = 0.2


@pytest.fixture
def scene(tmp_path):
    """A scene with a camera that sees a pixel of the size 0.001 at a distance of 1."""
    add_camera()
    scene = bpy.context.scene
    scene.camera.data.angle = 2.0 * float(np.arctan(0.5e-3 * SIDE))
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 32
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.film_transparent = True
    scene.render.filepath = str(tmp_path / "render.exr")
    set_file_format(scene.render.image_settings, "OPEN_EXR")
    return scene


def render_center(scene: bpy.types.Scene) -> np.ndarray:
    """Return the mean color and alpha (4,) of the center of a render in which the levels shine red, green and blue."""
    for material in bpy.data.materials:
        number = material.name.removesuffix(" Fading")[-1]
        if number in "012":
            inputs = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED").inputs
            inputs["Base Color"].default_value, inputs["Specular IOR Level"].default_value = (0.0, 0.0, 0.0, 1.0), 0.0
            inputs["Emission Color"].default_value = (*np.eye(3)[int(number)], 1.0)
            inputs["Emission Strength"].default_value = 1.0
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = read_pixels(image)[SIDE // 4 : -SIDE // 4, SIDE // 4 : -SIDE // 4]
    bpy.data.images.remove(image)
    return pixels.mean(axis=(0, 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scales", "fraction", "size"),
    [
        ((1.0, 1.0, 1.0), 0.25, 1.0),
        ((1.0, 4.0, 0.5), 0.75, 3.0),
        pytest.param((1.0, 4.0, 0.5), 0.25, 3.0, marks=pytest.mark.exhaustive),
        pytest.param((1.0, 4.0, 0.5), 0.75, 1.0, marks=pytest.mark.exhaustive),
        pytest.param((1.0, 1.0, 1.0), 0.75, 3.0, marks=pytest.mark.exhaustive),
    ],
)
def test_levels_of_an_instance_have_the_expected_fractions(scene, scales, fraction, size):
    distance = 20.0 * (1.0 + fraction * FADE_RANGE) + 0.25  # Of the center of a box; its front is 0.25 nearer.
    scatter = add_scatter([(0.0, size * distance, 0.0)], [add_box("Box", linked=False)])
    on_points = next(node for node in scatter.modifiers[0].node_group.nodes if node.type == "INSTANCE_ON_POINTS")
    on_points.inputs["Scale"].default_value = (size, size, -size)
    attach_levels([scatter], FADE_RANGE, scales)
    assert np.allclose(render_center(scene), [1.0 - fraction, fraction, 0.0, 1.0], atol=0.04)


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "color"), [(10.0, (1, 0, 0)), (40.0, (0, 1, 0)), (100.0, (0, 0, 1))])
def test_an_object_outside_of_the_fade_range_is_one_level(scene, distance, color):
    box = add_box("Box", (0.0, distance, 0.0), size=0.5)
    box.scale = (1.0, 1.0, 2.0)
    attach_levels([box], FADE_RANGE)
    found = render_center(scene)
    assert np.allclose(found[:3] / found[3], color, atol=1e-3) and found[3] > 0.1


def test_a_coarser_level_outside_of_the_image_casts_its_shadow(scene):
    ground = add_box("Ground", (0.0, 30.0, -2.0), size=3.0)
    ground.scale = (1.0, 1.0, 0.01)
    scene.camera.location, scene.camera.rotation_euler = (0.0, 30.0, 10.0), (0.0, 0.0, 0.0)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = (0.0, 0.7, 0.0)
    scene.collection.objects.link(sun)
    bright = render_center(scene)[0]
    caster = add_box("Caster", (4.2, 30.0, 3.0), size=0.5)
    caster.scale = (2.0, 2.0, 2.0)
    attach_levels([caster], FADE_RANGE)
    instances = [item.object.name for item in bpy.context.evaluated_depsgraph_get().object_instances if item.is_instance]
    assert instances == ["Caster 1"]
    assert render_center(scene)[0] < 0.1 * bright
