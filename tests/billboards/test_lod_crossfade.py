"""Cross-fade: every camera ray sees exactly one level, in fractions that match a reference in NumPy."""

import bpy
import numpy as np
import pytest

from bridge import blender_scenes
from farfield.addon.bridge import lod_crossfade
from farfield.addon.bridge.billboards import source_objects
from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.compat import enable_nodes, set_file_format
from farfield.addon.core.geometry.cameras import Camera

ERRORS, FADE_RANGE = (0.02, 0.04), 0.5
SIDE = 32
GREEN, RED, BLUE = np.eye(3)[[1, 0, 2]]
DISTANCE = 10.0  # from the camera to the cards


def crossfade_fraction(pixel_size: np.ndarray | float, error: float, fade_range: float) -> np.ndarray | float:
    """Reference of the shader: how far a cross-fade to a coarser level has come, 0..1, where a pixel is `pixel_size` long. It begins where
    the coarser level's `error` covers one pixel and ends where a pixel is longer by the fraction `fade_range`."""
    return np.clip((pixel_size - error) / (fade_range * error), 0.0, 1.0)


@pytest.fixture
def scene(extension, tmp_path) -> bpy.types.Scene:
    """A scene with a camera above the origin and nothing else."""
    scene = blender_scenes.reset_scene()
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location.z = DISTANCE
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", 16
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = SIDE, SIDE
    scene.render.filepath = str(tmp_path / "render.exr")
    set_file_format(scene.render.image_settings, "OPEN_EXR")
    return scene


def render(scene: bpy.types.Scene) -> np.ndarray:
    """Return the render (H, W, 4) of the active camera."""
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = read_pixels(image)
    bpy.data.images.remove(image)
    return pixels


def emissive(color: np.ndarray) -> bpy.types.Material:
    material = bpy.data.materials.new("Emissive")
    enable_nodes(material)
    tree = material.node_tree
    tree.nodes.clear()
    light = tree.nodes.new("ShaderNodeEmission")
    light.inputs["Color"].default_value = (*color, 1.0)
    tree.links.new(light.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def three_cards(size: float = 1.0) -> list[bpy.types.Object]:
    """Add cards for a source and two levels slightly below each other. Scaled by `size`, they have inversely scaled limits."""
    cards = []
    for index, (color, start, end) in enumerate(
        ((GREEN, lod_crossfade.MIN_PIXEL, ERRORS[0]), (RED, ERRORS[0], ERRORS[1]), (BLUE, ERRORS[1], lod_crossfade.MAX_PIXEL))
    ):
        card = blender_scenes.card(f"Card {index}", emissive(color))
        card.location.z, card.scale = -1e-3 * index, (size, size, size)
        lod_crossfade.add_crossfade(card, start / size, end / size, FADE_RANGE)
        cards.append(card)
    return cards


def set_pixel_size(camera: bpy.types.Object, pixel_size: float) -> None:
    """Set the size of a pixel at the origin."""
    if camera.data.type == "ORTHO":
        camera.data.ortho_scale = pixel_size * SIDE
    else:
        camera.data.angle = 2.0 * np.arctan(0.5 * pixel_size * SIDE / DISTANCE)


def render_center(scene: bpy.types.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return mean color and mean alpha of the center of the render."""
    center = render(scene)[SIDE // 4 : -SIDE // 4, SIDE // 4 : -SIDE // 4]
    return center[..., :3].mean(axis=(0, 1)), center[..., 3].mean()


@pytest.mark.slow
@pytest.mark.parametrize("camera_type", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("pixel", [0.01, 0.025, 0.035, 0.045, 0.07])
def test_levels_have_the_expected_fractions(scene, camera_type, pixel):
    three_cards()
    scene.camera.data.type = camera_type
    set_pixel_size(scene.camera, pixel)
    color, alpha = render_center(scene)
    first, second = (crossfade_fraction(pixel, error, FADE_RANGE) for error in ERRORS)
    np.testing.assert_allclose(color, (1.0 - first) * GREEN + (first - second) * RED + second * BLUE, atol=0.03)
    assert alpha > 0.999


def test_pixel_size_uses_resolution_and_sensor_fit(scene):
    three_cards()
    set_pixel_size(scene.camera, 0.0125)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 2 * SIDE, SIDE // 2, 25
    scene.camera.data.sensor_fit = "HORIZONTAL"
    color = render(scene)[..., :3].mean(axis=(0, 1))
    fraction = crossfade_fraction(0.0125 * 2.0, ERRORS[0], FADE_RANGE)
    np.testing.assert_allclose(color, (1.0 - fraction) * GREEN + fraction * RED, atol=0.1)


def test_scaled_objects_and_instances_fade_by_their_own_scale(scene):
    cards = three_cards(size=0.5)
    parts = bpy.data.collections.new("Parts")
    for card in cards:
        parts.objects.link(card)
        scene.collection.objects.unlink(card)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection, instance.scale = "COLLECTION", parts, (4.0, 4.0, 4.0)
    scene.collection.objects.link(instance)
    set_pixel_size(scene.camera, 0.1)
    color, _ = render_center(scene)
    fraction = crossfade_fraction(0.1, 4.0 * ERRORS[0], FADE_RANGE)
    np.testing.assert_allclose(color, (1.0 - fraction) * GREEN + fraction * RED, atol=0.03)


def test_other_rays_switch_at_the_center_of_the_range(scene):
    """A mirror shows only one level where the camera would see two."""
    cards = three_cards()
    for card in cards:
        card.visible_camera = False
    mirror = blender_scenes.card("Mirror", blender_scenes.create_material("Mirror", roughness=0.0))
    mirror.scale, mirror.location.z = (3.0, 3.0, 3.0), -DISTANCE
    blender_scenes.shader_of(mirror.data.materials[0]).inputs["Metallic"].default_value = 1.0
    for pixel, shown in ((0.024, GREEN), (0.026, RED)):
        set_pixel_size(scene.camera, pixel)
        color, _ = render_center(scene)
        assert np.argmax(color) == np.argmax(shown) and color.max() > 50.0 * np.sort(color)[1]


def test_drivers_are_simple_expressions(scene):
    for card in three_cards():
        assert len(card.animation_data.drivers) == 5
        assert all(curve.driver.is_simple_expression and curve.driver.is_valid for curve in card.animation_data.drivers)


def test_removing_restores_material_and_properties(scene):
    card = three_cards()[0]
    nodes = len(card.data.materials[0].node_tree.nodes)
    lod_crossfade.apply_to_materials(card)
    assert len(card.data.materials[0].node_tree.nodes) == nodes  # inserted only once
    lod_crossfade.remove_crossfade(card, [*card.data.materials, None])
    tree = card.data.materials[0].node_tree
    assert len(tree.nodes) == nodes - 1
    assert [link.from_node.type for link in tree.links] == ["EMISSION"]
    assert not [key for key in card.keys() if key.startswith("farfield")] and not card.animation_data.drivers  # noqa: SIM118


def build_cloud(source, **settings):
    """Build a cloud with two levels from the new object `source`."""
    bpy.ops.farfield.billboards_build(**{"levels": 2, "nested_levels": True, "error": 6.0, "samples": 1, **settings})
    return source, clouds_in(bpy.context.scene)[0]


@pytest.mark.slow
def test_operator_adds_crossfade_and_show_level_removes_it(scene):
    box, cloud = build_cloud(blender_scenes.box("Würfel", emissive(RED)), error=20.0)
    box.modifiers.new("Subdivision", "SUBSURF")
    before = blender_scenes.count_data()
    assert not cloud.has_crossfade
    assert bpy.ops.farfield.billboards_crossfade(fade_range=50.0) == {"FINISHED"}
    (proxy,) = source_objects.find_source_proxies(cloud.collection)
    assert len(proxy.data.polygons) > len(box.data.polygons) and not proxy.modifiers
    assert cloud.has_crossfade and box.hide_render and not any(level.hide_render for level in cloud.levels)
    np.testing.assert_allclose(proxy[lod_crossfade.CROSSFADE], (0.0, cloud.errors[0], 0.5))
    np.testing.assert_allclose(cloud.levels[0][lod_crossfade.CROSSFADE], (*cloud.errors, 0.5))
    assert proxy.data.materials[0] != box.data.materials[0]
    assert not [node for node in box.data.materials[0].node_tree.nodes if node.type == "GROUP"]
    bpy.ops.farfield.billboards_crossfade()  # again, with another range
    assert len(source_objects.find_source_proxies(cloud.collection)) == 1 and cloud.levels[0][lod_crossfade.CROSSFADE][2] == pytest.approx(
        0.25
    )
    bpy.ops.farfield.billboards_show_level()
    assert not cloud.has_crossfade and not source_objects.find_source_proxies(cloud.collection)
    after = blender_scenes.count_data()
    assert {name: after[name] - before[name] for name in after} == dict.fromkeys(after, 0) | {"node_groups": 1}
    assert [item.hide_render for item in (box, *cloud.levels)].count(False) == 1


def test_every_face_of_a_proxy_keeps_its_material(scene):
    box = blender_scenes.box(material=emissive(RED))
    box.data.materials.append(emissive(BLUE))
    box.data.polygons[0].material_index = 1
    bpy.ops.farfield.billboards_build(levels=1, error=4.0, textures=False)
    bpy.ops.farfield.billboards_crossfade()
    (proxy,) = source_objects.find_source_proxies(clouds_in(scene)[0].collection)
    assert [polygon.material_index for polygon in proxy.data.polygons] == [polygon.material_index for polygon in box.data.polygons]
    assert proxy.data.materials[0] != proxy.data.materials[1]


@pytest.mark.slow
def test_coverage_is_preserved_while_fading(scene):
    _, cloud = build_cloud(blender_scenes.ball("Ball"), error=5.0)
    bpy.ops.farfield.billboards_crossfade(fade_range=100.0)
    scene.camera.data.type = "ORTHO"
    areas = []
    for pixel in (0.5 * cloud.errors[0], 1.5 * cloud.errors[0]):
        scene.camera.data.ortho_scale = pixel * SIDE
        areas.append(render(scene)[..., 3].sum() * pixel**2)
    assert areas[1] == pytest.approx(np.pi, rel=0.06) and areas[0] <= areas[1] * 1.06


def test_collection_instances_get_one_proxy_per_object(scene):
    parts = bpy.data.collections.new("Parts")
    for x in (-1.5, 1.5):
        box = blender_scenes.box(f"Box {x}", emissive(BLUE))
        box.location.x = x
        scene.collection.objects.unlink(box)
        parts.objects.link(box)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection, instance.location = "COLLECTION", parts, (0.0, 3.0, 0.0)
    scene.collection.objects.link(instance)
    instance.select_set(True)
    bpy.ops.farfield.billboards_build(levels=1, error=4.0, textures=False)
    (cloud,) = clouds_in(scene)
    bpy.ops.farfield.billboards_crossfade()
    proxies = source_objects.find_source_proxies(cloud.collection)
    assert sorted(tuple(item.matrix_world.translation) for item in proxies) == [(-1.5, 3.0, 0.0), (1.5, 3.0, 0.0)]
    assert instance.hide_render


def test_proxies_of_sheared_objects_are_where_their_sources_are(scene):
    box, parent = blender_scenes.box("Box", emissive(BLUE)), bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    box.parent, parent.scale, box.rotation_euler, box.location = parent, (3.0, 1.0, -1.0), (0.3, 0.8, 0.9), (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    collection = bpy.data.collections.new("Cloud")
    scene.collection.children.link(collection)
    expected = blender_scenes.read_objects(box).mesh
    source_objects.add_source_proxies([box], collection, bpy.context.evaluated_depsgraph_get())
    bpy.context.view_layer.update()
    found = blender_scenes.read_objects(*source_objects.find_source_proxies(collection)).mesh
    assert np.allclose(np.sort(found.corners.mean(axis=1), axis=0), np.sort(expected.corners.mean(axis=1), axis=0), atol=1e-5)
    assert signed_volume(found) == pytest.approx(signed_volume(expected)) and signed_volume(found) > 0.0


def signed_volume(mesh) -> float:
    """Volume of a closed mesh, positive when it is wound outwards."""
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_cloud_without_source_fades_between_its_levels(scene):
    box, cloud = build_cloud(blender_scenes.box(), textures=False)
    bpy.data.objects.remove(box)
    bpy.ops.farfield.billboards_crossfade()
    assert not source_objects.find_source_proxies(cloud.collection)
    assert cloud.levels[0][lod_crossfade.CROSSFADE][0] == 0.0


def test_poll_needs_a_camera(scene):
    build_cloud(blender_scenes.box(), textures=False)
    scene.camera = None
    assert not bpy.ops.farfield.billboards_crossfade.poll()


def test_fraction_starts_at_switch_distance():
    camera = Camera(np.zeros(3), 100, 0.5)
    start = camera.switch_distance(0.1)
    fractions = [crossfade_fraction(camera.pixel_size(start * factor), 0.1, 0.25) for factor in (0.9, 1.0, 1.125, 1.25, 2.0)]
    np.testing.assert_allclose(fractions, (0.0, 0.0, 0.5, 1.0, 1.0), atol=1e-9)
