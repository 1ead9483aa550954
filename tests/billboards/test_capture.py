"""A captured texture says what the material says: the same colour, normal, roughness and alpha, at the same place."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes, plain_clouds
from farfield.addon.bridge.capture import capture
from farfield.addon.bridge.images import check_images
from farfield.addon.bridge.slots import slots_of
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import FileError
from farfield.addon.core.progress import finish

SETTINGS = BillboardSettings(samples=4)


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.fresh()


def captured(source, directions=None, texel=0.1):
    """The one level of a plain cloud of `source`, and its textures."""
    cloud = plain_clouds.cloud_of_directions(source.mesh, plain_clouds.six_directions() if directions is None else directions, texel)
    return cloud.levels[0], finish(capture(source, cloud, SETTINGS))[0]


def texel_positions(level):
    """World positions (H, W, 3) of the texels on their quads' planes, and the quad of each texel or -1 (H, W)."""
    width, height = level.atlas.size
    slots = slots_of(level)
    rows, columns = np.mgrid[:height, :width] + 0.5
    flat = np.stack([columns - 0.5 * width, rows - 0.5 * height, np.zeros((height, width))], axis=2) * level.texel
    quads, positions = np.full((height, width), -1), np.zeros((height, width, 3))
    for quad, (x, y, w, h) in enumerate(level.atlas.rectangles):
        area = (slice(y, y + h), slice(x, x + w))
        quads[area] = quad
        positions[area] = slots.centers[quad] + (flat[area] - slots.places[quad]) @ slots.axes[quad] / slots.scales[quad]
    return positions, quads


def test_a_plain_box_shows_its_colour_roughness_and_normals():
    source = blender_scenes.taken(blender_scenes.box(made=blender_scenes.material("Red", (0.8, 0.2, 0.1), 0.3)))
    level, textures = captured(source)
    _, quads = texel_positions(level)
    covered = textures.front.colour[..., 3] > 0.99
    assert (covered == (quads >= 0)).all()
    assert textures.front.colour[covered][:, :3] == pytest.approx(np.tile([0.8, 0.2, 0.1], (covered.sum(), 1)), abs=1e-3)
    assert textures.front.normal[covered] == pytest.approx(level.quads.frames[quads[covered], 2], abs=1e-3)
    assert textures.back.normal[covered] == pytest.approx(-level.quads.frames[quads[covered], 2], abs=1e-3)
    assert textures.front.surface[covered] == pytest.approx(np.tile([0.3, 0.0, 0.0], (covered.sum(), 1)), abs=1e-3)


def test_every_texel_of_normals_and_surface_has_a_value():
    source = blender_scenes.taken(blender_scenes.ball())
    _, textures = captured(source)
    assert np.linalg.norm(textures.front.normal, axis=2) == pytest.approx(1.0, abs=1e-4)
    assert textures.front.surface[..., 0] == pytest.approx(0.5, abs=1e-3)


def test_smooth_normals_and_depth_of_a_ball_are_those_of_a_sphere():
    ball = blender_scenes.ball()
    ball.location = (5.0, -2.0, 1.0)
    source = blender_scenes.taken(ball)
    level, textures = captured(source, plain_clouds.spread_directions(20), 0.05)
    positions, quads = texel_positions(level)
    covered = textures.front.colour[..., 3] > 0.99
    lifted = positions + (textures.front.surface[..., 2] * level.error)[..., None] * level.quads.frames[quads, 2]
    outwards = lifted - np.array([5.0, -2.0, 1.0])
    lengths = np.linalg.norm(outwards[covered], axis=1)
    assert lengths == pytest.approx(1.0, abs=0.02)
    cosines = np.einsum("ij,ij->i", outwards[covered] / lengths[:, None], textures.front.normal[covered])
    assert cosines.min() > 0.99


@pytest.mark.parametrize("node, output", [("ShaderNodeNewGeometry", "Position"), ("ShaderNodeTexCoord", "Object")])
def test_materials_that_ask_for_their_place_get_that_of_the_scene(node, output):
    made = blender_scenes.material("Place")
    coordinates = made.node_tree.nodes.new(node)
    blender_scenes.link(made, coordinates.outputs[output], blender_scenes.shader_of(made).inputs["Base Color"])
    box = blender_scenes.box(made=made)
    box.location = (2.0, 3.0, 4.0)
    bpy.context.view_layer.update()
    source = blender_scenes.taken(box)
    level, textures = captured(source)
    positions, _ = texel_positions(level)
    covered = textures.front.colour[..., 3] > 0.99
    expected = positions[covered] - (source.origin if output == "Object" else 0.0)
    assert textures.front.colour[covered][:, :3] == pytest.approx(np.maximum(expected, 0.0), abs=0.03)


def test_generated_coordinates_run_over_the_box():
    made = blender_scenes.material("Generated")
    coordinates = made.node_tree.nodes.new("ShaderNodeTexCoord")
    blender_scenes.link(made, coordinates.outputs["Generated"], blender_scenes.shader_of(made).inputs["Base Color"])
    level, textures = captured(blender_scenes.taken(blender_scenes.box(made=made)))
    positions, _ = texel_positions(level)
    covered = textures.front.colour[..., 3] > 0.99
    assert textures.front.colour[covered][:, :3] == pytest.approx((positions[covered] + 1.0) / 2.0, abs=0.02)


def test_mirrored_objects_keep_their_uv_maps():
    made = blender_scenes.material("UV")
    uv = made.node_tree.nodes.new("ShaderNodeUVMap")
    blender_scenes.link(made, uv.outputs[0], blender_scenes.shader_of(made).inputs["Base Color"])
    card = blender_scenes.card(made=made)
    card.scale = (-1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    level, textures = captured(blender_scenes.taken(card))
    positions, _ = texel_positions(level)
    covered = textures.front.colour[..., 3] > 0.99
    expected = np.column_stack([(1.0 - positions[covered][:, 0]) / 2.0, (1.0 + positions[covered][:, 1]) / 2.0])
    assert textures.front.colour[covered][:, :2] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("way", ["input", "mixed", "grouped"])
def test_alpha_is_the_covered_share_however_it_is_wired(way):
    made = blender_scenes.material("Leaf", (0.2, 0.6, 0.1))
    tree, shader = made.node_tree, blender_scenes.shader_of(made)
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = blender_scenes.disc_image()
    if way == "input":
        tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    else:
        _mix_with_transparent(tree, shader, texture, grouped=way == "grouped")
    _, textures = captured(blender_scenes.taken(blender_scenes.card(made=made)), texel=0.05)
    alpha = textures.front.colour[..., 3]
    assert alpha.sum() * 0.05**2 == pytest.approx(np.pi * 0.8**2, rel=0.03)
    solid = alpha > 0.99
    premultiplied = alpha[..., None] * np.array([0.2, 0.6, 0.1])
    assert solid.any()
    assert textures.front.colour[..., :3] == pytest.approx(premultiplied, abs=1e-3)


def _mix_with_transparent(tree, shader, texture, grouped):
    """Put Mix Shader(alpha, Transparent, shader) before the output, in a group that takes the shader and the alpha when asked."""
    inner, sources = tree, [texture.outputs["Alpha"], shader.outputs[0]]
    target = tree.nodes["Material Output"].inputs["Surface"]
    if grouped:
        inner = bpy.data.node_groups.new("Cut out", "ShaderNodeTree")
        for name, direction, kind in (("Alpha", "INPUT", "Float"), ("In", "INPUT", "Shader"), ("Out", "OUTPUT", "Shader")):
            inner.interface.new_socket(name, in_out=direction, socket_type=f"NodeSocket{kind}")
        group = tree.nodes.new("ShaderNodeGroup")
        group.node_tree = inner
        for source, group_input in zip(sources, group.inputs, strict=True):
            tree.links.new(source, group_input)
        tree.links.new(group.outputs[0], target)
        sources, target = list(inner.nodes.new("NodeGroupInput").outputs)[:2], inner.nodes.new("NodeGroupOutput").inputs[0]
    mixed, transparent = inner.nodes.new("ShaderNodeMixShader"), inner.nodes.new("ShaderNodeBsdfTransparent")
    inner.links.new(sources[0], mixed.inputs[0])
    inner.links.new(transparent.outputs[0], mixed.inputs[1])
    inner.links.new(sources[1], mixed.inputs[2])
    inner.links.new(mixed.outputs[0], target)


def test_two_sided_materials_show_each_side_its_own():
    made = blender_scenes.material("Two")
    tree = made.node_tree
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    tree.links.new(geometry.outputs["Backfacing"], blender_scenes.shader_of(made).inputs["Base Color"])
    _, textures = captured(blender_scenes.taken(blender_scenes.card(made=made)))
    covered = textures.front.colour[..., 3] > 0.99
    assert textures.front.colour[covered][:, 0] == pytest.approx(0.0, abs=1e-4)
    assert textures.back.colour[covered][:, 0] == pytest.approx(1.0, abs=1e-4)


def test_nothing_is_left_behind_when_capture_ends_or_is_stopped():
    source = blender_scenes.taken(blender_scenes.box(made=blender_scenes.material("Red")))
    cloud = plain_clouds.cloud_of_directions(source.mesh, plain_clouds.six_directions(), 0.5)
    before, scene, active = blender_scenes.counts(), bpy.context.scene, bpy.context.object
    stopped = capture(source, cloud, SETTINGS)
    next(stopped)
    next(stopped)
    assert blender_scenes.counts() != before
    stopped.close()
    assert blender_scenes.counts() == before
    finish(capture(source, cloud, SETTINGS))
    assert blender_scenes.counts() == before
    assert (bpy.context.scene, bpy.context.object) == (scene, active)


def test_a_missing_image_is_named_before_any_work(tmp_path):
    made = blender_scenes.material("Bark")
    texture = made.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("bark", 4, 4)
    texture.image.source, texture.image.filepath = "FILE", str(tmp_path / "no such Rinde ä.png")
    source = blender_scenes.taken(blender_scenes.box(made=made))
    with pytest.raises(FileError, match=r"bark.*Bark.*no such Rinde ä.png"):
        check_images(source)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_tiny_and_enormous_objects_look_the_same(scale):
    box = blender_scenes.box(made=blender_scenes.material("Red", (0.8, 0.2, 0.1)))
    box.scale = (scale,) * 3
    bpy.context.view_layer.update()
    level, textures = captured(blender_scenes.taken(box), texel=0.1 * scale)
    _, quads = texel_positions(level)
    inside = quads >= 0
    assert textures.front.colour[inside][:, 3] == pytest.approx(1.0, abs=0.01)
    assert textures.front.colour[inside][:, 0] == pytest.approx(0.8, abs=0.01)
