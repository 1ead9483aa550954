"""Levels that fade into each other: at every place one whole level is seen, in the shares that the core says."""

import bpy
import numpy as np
import pytest

from bridge import blender_scenes
from farfield.addon.bridge import fade_originals, fades
from farfield.addon.bridge.images import pixels_of
from farfield.addon.compat import give_nodes, set_file_format
from farfield.addon.core.cameras import Camera, faded_share
from farfield.addon.operators.billboards_clouds import clouds_in

ERRORS, SPAN = (0.02, 0.04), 0.5
SIDE = 32
GREEN, RED, BLUE = np.eye(3)[[1, 0, 2]]
DISTANCE = 10.0  # from the camera to what it sees


@pytest.fixture
def scene(extension, tmp_path) -> bpy.types.Scene:
    """A camera above the origin, and nothing else."""
    made = blender_scenes.fresh()
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location.z = DISTANCE
    made.collection.objects.link(camera)
    made.camera = camera
    made.render.engine = "CYCLES"
    made.cycles.device, made.cycles.samples = "CPU", 16
    made.cycles.use_denoising = made.cycles.use_adaptive_sampling = False
    made.render.film_transparent = True
    made.render.resolution_x, made.render.resolution_y = SIDE, SIDE
    made.render.filepath = str(tmp_path / "picture.exr")
    set_file_format(made.render.image_settings, "OPEN_EXR")
    return made


def rendered(scene: bpy.types.Scene) -> np.ndarray:
    """What the scene's camera sees (H, W, 4)."""
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = pixels_of(image)
    bpy.data.images.remove(image)
    return pixels


def shining(color: np.ndarray) -> bpy.types.Material:
    made = bpy.data.materials.new("Shining")
    give_nodes(made)
    tree = made.node_tree
    tree.nodes.clear()
    light = tree.nodes.new("ShaderNodeEmission")
    light.inputs["Color"].default_value = (*color, 1.0)
    tree.links.new(light.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made


def three_cards(size: float = 1.0) -> list[bpy.types.Object]:
    """An original and two levels a little below each other; those that are `size` times as large have so much smaller numbers."""
    cards = []
    for number, (color, start, end) in enumerate(
        ((GREEN, fades.ALWAYS, ERRORS[0]), (RED, ERRORS[0], ERRORS[1]), (BLUE, ERRORS[1], fades.FOREVER))
    ):
        card = blender_scenes.card(f"Card {number}", shining(color))
        card.location.z, card.scale = -1e-3 * number, (size, size, size)
        fades.fade(card, start / size, end / size, SPAN)
        cards.append(card)
    return cards


def see_pixels_of(camera: bpy.types.Object, pixel: float) -> None:
    """Let a pixel be so large at the origin."""
    if camera.data.type == "ORTHO":
        camera.data.ortho_scale = pixel * SIDE
    else:
        camera.data.angle = 2.0 * np.arctan(0.5 * pixel * SIDE / DISTANCE)


def middle(scene: bpy.types.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Mean colour and mean alpha of the middle of the picture."""
    part = rendered(scene)[SIDE // 4 : -SIDE // 4, SIDE // 4 : -SIDE // 4]
    return part[..., :3].mean(axis=(0, 1)), part[..., 3].mean()


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("pixel", [0.01, 0.025, 0.035, 0.045, 0.07])
def test_every_place_shows_one_level_in_the_shares_of_the_core(scene, kind, pixel):
    three_cards()
    scene.camera.data.type = kind
    see_pixels_of(scene.camera, pixel)
    color, alpha = middle(scene)
    first, second = (faded_share(pixel, error, SPAN) for error in ERRORS)
    np.testing.assert_allclose(color, (1.0 - first) * GREEN + (first - second) * RED + second * BLUE, atol=0.03)
    assert alpha > 0.999


def test_pixels_count_as_they_are_rendered(scene):
    three_cards()
    see_pixels_of(scene.camera, 0.0125)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 2 * SIDE, SIDE // 2, 25
    scene.camera.data.sensor_fit = "HORIZONTAL"
    color = rendered(scene)[..., :3].mean(axis=(0, 1))
    share = faded_share(0.0125 * 2.0, ERRORS[0], SPAN)
    np.testing.assert_allclose(color, (1.0 - share) * GREEN + share * RED, atol=0.1)


def test_scaled_objects_and_instances_change_by_their_own_size(scene):
    cards = three_cards(size=0.5)
    parts = bpy.data.collections.new("Parts")
    for card in cards:
        parts.objects.link(card)
        scene.collection.objects.unlink(card)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection, instance.scale = "COLLECTION", parts, (4.0, 4.0, 4.0)
    scene.collection.objects.link(instance)
    see_pixels_of(scene.camera, 0.1)
    color, _ = middle(scene)
    share = faded_share(0.1, 4.0 * ERRORS[0], SPAN)
    np.testing.assert_allclose(color, (1.0 - share) * GREEN + share * RED, atol=0.03)


def test_rays_of_light_see_a_change_at_the_middle_of_the_range(scene):
    """A mirror shows one level alone where the camera would see two."""
    cards = three_cards()
    for card in cards:
        card.visible_camera = False
    mirror = blender_scenes.card("Mirror", blender_scenes.material("Mirror", roughness=0.0))
    mirror.scale, mirror.location.z = (3.0, 3.0, 3.0), -DISTANCE
    blender_scenes.shader_of(mirror.data.materials[0]).inputs["Metallic"].default_value = 1.0
    for pixel, shown in ((0.024, GREEN), (0.026, RED)):
        see_pixels_of(scene.camera, pixel)
        color, _ = middle(scene)
        assert np.argmax(color) == np.argmax(shown) and color.max() > 50.0 * np.sort(color)[1]


def test_drivers_need_no_python(scene):
    for card in three_cards():
        assert len(card.animation_data.drivers) == 5
        assert all(each.driver.is_simple_expression and each.driver.is_valid for each in card.animation_data.drivers)


def test_it_is_undone(scene):
    card = three_cards()[0]
    nodes = len(card.data.materials[0].node_tree.nodes)
    fades.wear_fade(card)
    assert len(card.data.materials[0].node_tree.nodes) == nodes  # once only
    fades.unfade(card, [*card.data.materials, None])
    tree = card.data.materials[0].node_tree
    assert len(tree.nodes) == nodes - 1
    assert [link.from_node.type for link in tree.links] == ["EMISSION"]
    assert not [key for key in card.keys() if key.startswith("farfield")] and not card.animation_data.drivers  # noqa: SIM118


def cloud_of(name: str = "Bällchen"):
    """A red ball of two levels, seen by the scene's camera."""
    ball = blender_scenes.ball(name, shining(RED))
    bpy.ops.farfield.billboards_build(levels=2, error=4.0, samples=1)
    return ball, clouds_in(bpy.context.scene)[0]


def test_the_button_lets_original_and_levels_fade_and_the_other_one_ends_it(scene):
    ball, cloud = cloud_of()
    ball.modifiers.new("Subdivision", "SUBSURF")
    before = blender_scenes.counts()
    assert not cloud.fades
    assert bpy.ops.farfield.billboards_fade(fade_range=50.0) == {"FINISHED"}
    (stand_in,) = fade_originals.originals_in(cloud.collection)
    assert len(stand_in.data.polygons) > len(ball.data.polygons) and not stand_in.modifiers
    assert cloud.fades and ball.hide_render and not any(level.hide_render for level in cloud.levels)
    np.testing.assert_allclose(stand_in[fades.FADE], (0.0, cloud.errors[0], 0.5))
    np.testing.assert_allclose(cloud.levels[0][fades.FADE], (*cloud.errors, 0.5))
    assert stand_in.data.materials[0] != ball.data.materials[0]
    assert not [node for node in ball.data.materials[0].node_tree.nodes if node.type == "GROUP"]
    bpy.ops.farfield.billboards_fade()  # again, with another range
    assert len(fade_originals.originals_in(cloud.collection)) == 1 and cloud.levels[0][fades.FADE][2] == pytest.approx(0.25)
    bpy.ops.farfield.billboards_show_level()
    assert not cloud.fades and not fade_originals.originals_in(cloud.collection)
    after = blender_scenes.counts()
    assert {kind: after[kind] - before[kind] for kind in after} == dict.fromkeys(after, 0) | {"node_groups": 1}
    assert [item.hide_render for item in (ball, *cloud.levels)].count(False) == 1


def test_the_coverage_of_a_cloud_stays_while_it_fades(scene):
    _, cloud = cloud_of()
    bpy.ops.farfield.billboards_fade(fade_range=100.0)
    scene.camera.data.type = "ORTHO"
    alone = []
    for pixel in (0.5 * cloud.errors[0], 1.5 * cloud.errors[0]):
        scene.camera.data.ortho_scale = pixel * SIDE
        alone.append(rendered(scene)[..., 3].sum() * pixel**2)
    assert alone[1] == pytest.approx(np.pi, rel=0.06) and alone[0] <= alone[1] * 1.06


def test_collection_instances_stand_in_part_by_part(scene):
    parts = bpy.data.collections.new("Parts")
    for place in (-1.5, 1.5):
        box = blender_scenes.box(f"Box {place}", shining(BLUE))
        box.location.x = place
        scene.collection.objects.unlink(box)
        parts.objects.link(box)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection, instance.location = "COLLECTION", parts, (0.0, 3.0, 0.0)
    scene.collection.objects.link(instance)
    instance.select_set(True)
    bpy.ops.farfield.billboards_build(levels=1, error=4.0, samples=1)
    (cloud,) = clouds_in(scene)
    bpy.ops.farfield.billboards_fade()
    stand_ins = fade_originals.originals_in(cloud.collection)
    assert sorted(tuple(item.matrix_world.translation) for item in stand_ins) == [(-1.5, 3.0, 0.0), (1.5, 3.0, 0.0)]
    assert instance.hide_render


def test_without_its_original_a_cloud_fades_between_its_levels(scene):
    ball, cloud = cloud_of()
    bpy.data.objects.remove(ball)
    bpy.ops.farfield.billboards_fade()
    assert not fade_originals.originals_in(cloud.collection)
    assert cloud.levels[0][fades.FADE][0] == 0.0


def test_there_must_be_a_camera(scene):
    cloud_of()
    scene.camera = None
    assert not bpy.ops.farfield.billboards_fade.poll()


def test_faded_share_is_that_of_a_camera():
    camera = Camera(np.zeros(3), 100, 0.5)
    begin = camera.switch_distance(0.1)
    shares = [faded_share(camera.pixel_size(begin * factor), 0.1, 0.25) for factor in (0.9, 1.0, 1.125, 1.25, 2.0)]
    np.testing.assert_allclose(shares, (0.0, 0.0, 0.5, 1.0, 1.0), atol=1e-9)
