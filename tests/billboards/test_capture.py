"""Captured maps match the material: the same color, normal, roughness and alpha, at the same positions."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes, pbr_clouds
from farfield.addon.bridge.billboards.atlas_meshes import compute_placement, separate_heights
from farfield.addon.bridge.billboards.capture import capture_textures
from farfield.addon.bridge.imaging.images import check_images
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.jobs.progress import run_to_end

SETTINGS = BillboardSettings(samples=4)


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.reset_scene()


def capture_level(source, directions=None, texel=0.1):
    """Return the only level of a simple cloud of `source`, and its textures."""
    cloud = pbr_clouds.cloud_of_directions(source.mesh, pbr_clouds.axis_directions() if directions is None else directions, texel)
    return cloud.levels[0], run_to_end(capture_textures(source, cloud, SETTINGS))[0]


def texel_positions(level):
    """Return world positions (H, W, 3) of the texels on the planes of their quads, and the quad of each texel or -1 (H, W)."""
    width, height = level.atlas.size
    placement = compute_placement(level)
    rows, columns = np.mgrid[:height, :width] + 0.5
    flat = np.stack([columns - 0.5 * width, rows - 0.5 * height, np.zeros((height, width))], axis=2) * level.texel_size
    quads, positions = np.full((height, width), -1), np.zeros((height, width, 3))
    for quad, ((x, y), (w, h)) in enumerate(zip(pbr_clouds.quad_corners(level.atlas), level.atlas.quad_sizes, strict=True)):
        area = (slice(y, y + h), slice(x, x + w))
        quads[area] = quad
        positions[area] = placement.centers[quad] + (flat[area] - placement.positions[quad]) @ placement.axes[quad] / placement.scales[quad]
    return positions, quads


def test_color_roughness_and_normals_of_box():
    source = blender_scenes.read_objects(blender_scenes.box(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 0.3)))
    level, textures = capture_level(source)
    _, quads = texel_positions(level)
    covered = textures.front.color[..., 3] > 0.99
    assert (covered == (quads >= 0)).all()
    assert textures.front.color[covered][:, :3] == pytest.approx(np.tile([0.8, 0.2, 0.1], (covered.sum(), 1)), abs=1e-3)
    assert textures.front.normal[covered] == pytest.approx(level.quads.frames[quads[covered], 2], abs=1e-3)
    assert textures.back.normal[covered] == pytest.approx(-level.quads.frames[quads[covered], 2], abs=1e-3)
    assert textures.front.roughness_metallic_depth[covered] == pytest.approx(np.tile([0.3, 0.0, 0.0], (covered.sum(), 1)), abs=1e-3)


def test_every_texel_has_normal_and_roughness():
    source = blender_scenes.read_objects(blender_scenes.ball())
    _, textures = capture_level(source)
    assert np.linalg.norm(textures.front.normal, axis=2) == pytest.approx(1.0, abs=1e-4)
    assert textures.front.roughness_metallic_depth[..., 0] == pytest.approx(0.5, abs=1e-3)


def test_smooth_normals_and_depth_of_ball():
    ball = blender_scenes.ball()
    ball.location = (5.0, -2.0, 1.0)
    source = blender_scenes.read_objects(ball)
    level, textures = capture_level(source, pbr_clouds.spiral_directions(20), 0.05)
    positions, quads = texel_positions(level)
    covered = textures.front.color[..., 3] > 0.99
    surface = positions + (textures.front.roughness_metallic_depth[..., 2] * level.error)[..., None] * level.quads.frames[quads, 2]
    outwards = surface - np.array([5.0, -2.0, 1.0])
    lengths = np.linalg.norm(outwards[covered], axis=1)
    assert lengths == pytest.approx(1.0, abs=0.02)
    cosines = np.einsum("ij,ij->i", outwards[covered] / lengths[:, None], textures.front.normal[covered])
    assert cosines.min() > 0.99


@pytest.mark.parametrize("node, output", [("ShaderNodeNewGeometry", "Position"), ("ShaderNodeTexCoord", "Object")])
def test_position_nodes_return_scene_positions(node, output):
    material = blender_scenes.create_material("Position")
    coordinates = material.node_tree.nodes.new(node)
    blender_scenes.link(material, coordinates.outputs[output], blender_scenes.shader_of(material).inputs["Base Color"])
    box = blender_scenes.box(material=material)
    box.location = (2.0, 3.0, 4.0)
    bpy.context.view_layer.update()
    source = blender_scenes.read_objects(box)
    level, textures = capture_level(source)
    positions, _ = texel_positions(level)
    covered = textures.front.color[..., 3] > 0.99
    expected = positions[covered] - (source.origin if output == "Object" else 0.0)
    assert textures.front.color[covered][:, :3] == pytest.approx(np.maximum(expected, 0.0), abs=0.03)


def test_an_object_for_coordinates_needs_a_finite_transform():
    material, target = blender_scenes.create_material("Position"), blender_scenes.box("Target")
    coordinates = material.node_tree.nodes.new("ShaderNodeTexCoord")
    coordinates.object, target.location.x = target, float("nan")
    blender_scenes.link(material, coordinates.outputs["Object"], blender_scenes.shader_of(material).inputs["Base Color"])
    source = blender_scenes.read_objects(blender_scenes.box(material=material))
    with pytest.raises(GeometryError, match='"Target" has a transform that is not finite, and a material uses its coordinates; clear it'):
        capture_level(source)


def test_generated_coordinates_span_the_box():
    material = blender_scenes.create_material("Generated")
    coordinates = material.node_tree.nodes.new("ShaderNodeTexCoord")
    blender_scenes.link(material, coordinates.outputs["Generated"], blender_scenes.shader_of(material).inputs["Base Color"])
    level, textures = capture_level(blender_scenes.read_objects(blender_scenes.box(material=material)))
    positions, _ = texel_positions(level)
    covered = textures.front.color[..., 3] > 0.99
    assert textures.front.color[covered][:, :3] == pytest.approx((positions[covered] + 1.0) / 2.0, abs=0.02)


def test_uv_maps_of_mirrored_objects():
    material = blender_scenes.create_material("UV")
    uv = material.node_tree.nodes.new("ShaderNodeUVMap")
    blender_scenes.link(material, uv.outputs[0], blender_scenes.shader_of(material).inputs["Base Color"])
    card = blender_scenes.card(material=material)
    card.scale = (-1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    level, textures = capture_level(blender_scenes.read_objects(card))
    positions, _ = texel_positions(level)
    covered = textures.front.color[..., 3] > 0.99
    expected = np.column_stack([(1.0 - positions[covered][:, 0]) / 2.0, (1.0 + positions[covered][:, 1]) / 2.0])
    assert textures.front.color[covered][:, :2] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("wiring", ["input", "mixed", "grouped"])
def test_alpha_is_the_covered_fraction(wiring):
    material = blender_scenes.create_material("Leaf", (0.2, 0.6, 0.1))
    tree, shader = material.node_tree, blender_scenes.shader_of(material)
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = blender_scenes.disc_image()
    if wiring == "input":
        tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    else:
        _mix_with_transparent(tree, shader, texture, grouped=wiring == "grouped")
    _, textures = capture_level(blender_scenes.read_objects(blender_scenes.card(material=material)), texel=0.05)
    alpha = textures.front.color[..., 3]
    assert alpha.sum() * 0.05**2 == pytest.approx(np.pi * 0.8**2, rel=0.03)
    solid = alpha > 0.99
    premultiplied = alpha[..., None] * np.array([0.2, 0.6, 0.1])
    assert solid.any()
    assert textures.front.color[..., :3] == pytest.approx(premultiplied, abs=1e-3)


def _mix_with_transparent(tree, shader, texture, grouped):
    """Insert Mix Shader(alpha, Transparent, shader) before the output; if `grouped`, inside a group with shader and alpha as inputs."""
    inner, sources = tree, [texture.outputs["Alpha"], shader.outputs[0]]
    target = tree.nodes["Material Output"].inputs["Surface"]
    if grouped:
        inner = bpy.data.node_groups.new("Cut out", "ShaderNodeTree")
        for name, direction, socket_type in (("Alpha", "INPUT", "Float"), ("In", "INPUT", "Shader"), ("Out", "OUTPUT", "Shader")):
            inner.interface.new_socket(name, in_out=direction, socket_type=f"NodeSocket{socket_type}")
        group = tree.nodes.new("ShaderNodeGroup")
        group.node_tree = inner
        for source, group_input in zip(sources, group.inputs, strict=True):
            tree.links.new(source, group_input)
        tree.links.new(group.outputs[0], target)
        sources, target = list(inner.nodes.new("NodeGroupInput").outputs)[:2], inner.nodes.new("NodeGroupOutput").inputs[0]
    mix, transparent = inner.nodes.new("ShaderNodeMixShader"), inner.nodes.new("ShaderNodeBsdfTransparent")
    inner.links.new(sources[0], mix.inputs[0])
    inner.links.new(transparent.outputs[0], mix.inputs[1])
    inner.links.new(sources[1], mix.inputs[2])
    inner.links.new(mix.outputs[0], target)


def test_sides_of_a_two_sided_material_differ():
    material = blender_scenes.create_material("Two")
    tree = material.node_tree
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    tree.links.new(geometry.outputs["Backfacing"], blender_scenes.shader_of(material).inputs["Base Color"])
    _, textures = capture_level(blender_scenes.read_objects(blender_scenes.card(material=material)))
    covered = textures.front.color[..., 3] > 0.99
    assert textures.front.color[covered][:, 0] == pytest.approx(0.0, abs=1e-4)
    assert textures.back.color[covered][:, 0] == pytest.approx(1.0, abs=1e-4)


def test_no_data_remains_after_capture_or_cancelling():
    source = blender_scenes.read_objects(blender_scenes.box(material=blender_scenes.create_material("Red")))
    cloud = pbr_clouds.cloud_of_directions(source.mesh, pbr_clouds.axis_directions(), 0.5)
    before, scene, active = blender_scenes.count_data(), bpy.context.scene, bpy.context.object
    cancelled = capture_textures(source, cloud, SETTINGS)
    next(cancelled)
    next(cancelled)
    assert blender_scenes.count_data() != before
    cancelled.close()
    assert blender_scenes.count_data() == before
    run_to_end(capture_textures(source, cloud, SETTINGS))
    assert blender_scenes.count_data() == before
    assert (bpy.context.scene, bpy.context.object) == (scene, active)


def test_missing_image_is_named_before_capture(tmp_path):
    material = blender_scenes.create_material("Bark")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("bark", 4, 4)
    texture.image.source, texture.image.filepath = "FILE", str(tmp_path / "no such Rinde ä.png")
    source = blender_scenes.read_objects(blender_scenes.box(material=material))
    with pytest.raises(FileError, match=r"bark.*Bark.*no such Rinde ä.png"):
        check_images(source)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("texel", [1.0, 1e12])
def test_quads_without_extent_are_placed(texel):
    cloud = pbr_clouds.cloud_of_directions(blender_scenes.read_objects(blender_scenes.box()).mesh, pbr_clouds.axis_directions(), 0.1)
    level = cloud.levels[0]
    quads = replace(level.quads, half_sizes=np.zeros_like(level.quads.half_sizes))
    placement = compute_placement(replace(level, quads=quads, texel_size=texel))
    assert placement.scales == pytest.approx(np.ones(len(quads)))


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_extreme_scales_look_the_same(scale):
    box = blender_scenes.box(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1)))
    box.scale = (scale,) * 3
    bpy.context.view_layer.update()
    level, textures = capture_level(blender_scenes.read_objects(box), texel=0.1 * scale)
    _, quads = texel_positions(level)
    inside = quads >= 0
    assert textures.front.color[inside][:, 3] == pytest.approx(1.0, abs=0.01)
    assert textures.front.color[inside][:, 0] == pytest.approx(0.8, abs=0.01)


def test_no_two_quads_are_captured_in_one_plane():
    """Behind a transparent face at the same distance, whole sides of boxes were missing."""
    heights = separate_heights(np.arange(500), 2.0)
    assert np.diff(np.sort(heights)).min() > 1e-6 and 0.0 <= heights.min() <= heights.max() <= 0.02
