"""A baked cloud shines as its original does, from views that were not baked, under suns that turn."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy
import mathutils

from bridge import blender_scenes
from farfield.addon.bridge.btf_capture import sun_angle
from farfield.addon.bridge.btf_clouds import PLAIN_MATERIAL, let_through, light_with, texels_of_level
from farfield.addon.bridge.btf_reading import baked_atlas
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.operators.billboards_clouds import clouds_in
from studio import bounds, studio

BAKE = {"views": 16, "lights": 16, "samples": 4, "components": 8, "alpha_components": 8, "shadows": 64}


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.fresh()


@pytest.fixture
def cloud():
    """A glossless red ball, its cloud, selected."""
    ball = blender_scenes.ball(made=blender_scenes.material("Red", (0.8, 0.2, 0.1), 1.0))
    bpy.context.view_layer.objects.active = ball
    ball.select_set(True)
    bpy.ops.farfield.billboards_build(error=4.0, levels=1, samples=4)
    return clouds_in(bpy.context.scene)[0]


def sun(direction) -> bpy.types.Object:
    """A sun of 2 W/m2 from `direction`."""
    lamp = bpy.data.lights.new("Test Sun", "SUN")
    lamp.energy, lamp.color = 2.0, (1.0, 0.5, 1.0)
    made = bpy.data.objects.new("Test Sun", lamp)
    made.rotation_euler = mathutils.Vector(direction).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(made)
    return made


def pictures(cloud, lamp, direction) -> tuple[np.ndarray, np.ndarray]:
    """Original and cloud under `lamp` alone, from `direction`, a pixel an error."""
    sources, level = cloud.sources, cloud.levels[0]
    center, radius = bounds(sources)
    pixel = cloud.errors[0]
    with studio([*sources, level], 32) as room:
        work = room._work
        work.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
        for item in list(work.scene.collection.objects):
            if item.type == "LIGHT":
                work.scene.collection.objects.unlink(item)
        work.scene.collection.objects.link(lamp)
        unit = np.array(direction) / np.linalg.norm(direction)
        return tuple(room.picture(shown, unit, center, pixel, int(2.2 * radius / pixel)) for shown in (sources, [level]))


def test_it_looks_like_the_original_under_a_sun_that_turns(cloud):
    assert bpy.ops.farfield.btf_bake(**BAKE) == {"FINISHED"}
    lamp = sun((0.3, -0.8, 0.5))
    light_with(cloud.levels[0], [lamp], (0.0, 0.0, 0.0))
    means = []
    for number in (1, 6):  # suns that were baked, so that the view alone is interpolated
        lamp.rotation_euler = mathutils.Vector(DirectionGrid(4).directions[number]).to_track_quat("Z", "Y").to_euler()
        bpy.context.view_layer.update()
        original, baked = pictures(cloud, lamp, (0.5, -0.8, 0.3))
        inside = original[..., 3] > 0.99
        brightness = original[inside][:, :3].mean()
        assert np.abs(original - baked)[inside][:, :3].mean() < 0.15 * brightness + 0.01
        assert baked[inside][:, :3].mean(axis=0) == pytest.approx(original[inside][:, :3].mean(axis=0), rel=0.12, abs=0.005)
        means.append(brightness)
        assert (baked[..., 3] > 0.5).sum() == pytest.approx((original[..., 3] > 0.5).sum(), rel=0.08)
    assert abs(means[0] - means[1]) > 0.02, "the two suns must differ for the test to say something"


def test_a_wall_shades_the_ground_sharply_under_suns_between_those_of_the_bake():
    ground, wall = blender_scenes.card("Ground"), blender_scenes.box("Wall")
    ground.scale = (3.0, 3.0, 1.0)
    wall.scale, wall.location.z = (1.0, 0.1, 0.5), 0.5
    ground.select_set(True)
    bpy.ops.farfield.billboards_build(error=3.0, levels=1, samples=1, together=True)
    (cloud,) = clouds_in(bpy.context.scene)
    assert bpy.ops.farfield.btf_bake(**{**BAKE, "views": 4, "lights": 4, "samples": 1, "shadows": 256, "upper_hemisphere": True}) == {
        "FINISHED"
    }
    texels, atlas = texels_of_level(cloud.levels[0]), baked_atlas(cloud.levels[0])
    places = texels.positions
    flat = np.abs(places[:, 2]) < 1e-3
    beside = np.maximum(np.abs(places[:, 0]) - 1.0, np.abs(places[:, 1]) - 0.1) > 0.15
    rows = (texels.pixels[:, 1] * texels.size[0] + texels.pixels[:, 0])[flat & beside]
    places = places[flat & beside]
    assert len(places) > 500
    for light in ([0.3, -0.6, 0.7], [-0.5, 0.5, 0.6], [0.1, 0.75, 0.5]):
        light = np.array(light) / np.linalg.norm(light)
        steps = np.linspace(0.0, 1.0 / light[2], 200)[:, None]  # along the ray until it is above the wall
        expected = []
        for place in places:
            ray = place + steps * light
            expected.append(not ((np.abs(ray[:, 0]) < 1.0) & (np.abs(ray[:, 1]) < 0.1)).any())
        reached = atlas.lobes.shadows.reached(light[None], rows)[:, 0]
        expected = np.array(expected)
        assert 0.02 < (~expected).mean() < 0.5
        assert reached[~expected].mean() < 0.3 and reached[expected].mean() > 0.95


def test_what_shines_by_itself_does_not_follow_the_lamps(cloud):
    shader = blender_scenes.shader_of(bpy.data.materials["Red"])
    shader.inputs["Emission Color"].default_value, shader.inputs["Emission Strength"].default_value = (0.2, 0.4, 1.0, 1.0), 0.5
    assert bpy.ops.farfield.btf_bake(**{**BAKE, "views": 4, "shadows": 0}) == {"FINISHED"}
    lamp = sun((0.3, -0.8, 0.5))
    for energy in (0.0, 4.0):
        lamp.data.energy = energy
        light_with(cloud.levels[0], [lamp], (0.0, 0.0, 0.0))
        original, baked = pictures(cloud, lamp, (0.5, -0.8, 0.3))
        inside = original[..., 3] > 0.99
        if energy == 0.0:
            np.testing.assert_allclose(baked[inside][:, :3].mean(axis=0), [0.1, 0.2, 0.5], rtol=0.05)
        assert baked[inside][:, :3].mean(axis=0) == pytest.approx(original[inside][:, :3].mean(axis=0), rel=0.2)


def test_it_goes_back_to_the_plain_maps(cloud):
    level = cloud.levels[0]
    plain = level.data.materials[0].name
    bpy.ops.farfield.btf_bake(**{**BAKE, "views": 4, "lights": 4, "samples": 1})
    assert level[PLAIN_MATERIAL] == plain and level.data.materials[0].name != plain
    lamp = sun((0.0, 0.0, 1.0))
    bpy.context.scene.farfield_btf.sun_1 = lamp
    assert bpy.ops.farfield.btf_light() == {"FINISHED"}
    assert len(level.animation_data.drivers) == 6
    assert bpy.ops.farfield.btf_plain() == {"FINISHED"}
    assert level.data.materials[0].name == plain
    assert len(level.animation_data.drivers) == 0
    assert not [key for key in tuple(level.keys()) if key.startswith(("farfield_sun", "farfield_light", "farfield_ambient"))]


def test_rays_may_pass_all_quads(cloud):
    scene = bpy.context.scene
    scene.cycles.transparent_max_bounces = 1
    bpy.ops.farfield.btf_bake(**{**BAKE, "views": 4, "lights": 4, "samples": 1})
    assert 2 < scene.cycles.transparent_max_bounces <= len(cloud.levels[0].data.polygons) + 8
    scene.cycles.transparent_max_bounces = 999
    let_through(cloud.collection, 3)
    assert scene.cycles.transparent_max_bounces == 999


def test_nothing_of_the_bake_is_left_in_the_scene(cloud):
    scenes, lights, worlds = len(bpy.data.scenes), len(bpy.data.lights), len(bpy.data.worlds)
    bpy.ops.farfield.btf_bake(**{**BAKE, "views": 4, "lights": 4, "samples": 1})
    assert (len(bpy.data.scenes), len(bpy.data.lights), len(bpy.data.worlds)) == (scenes, lights, worlds)


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lambda source: bpy.data.objects.remove(source), "is gone"),
        (lambda source: setattr(source, "location", (1.0, 0.0, 0.0)), "edited or moved"),
        (lambda source: source.data.vertices[0].co.__setitem__(0, 9.0), "edited or moved"),
    ],
    ids=["removed", "moved", "edited"],
)
def test_a_cloud_whose_original_is_another_is_refused(cloud, harm, words):
    bpy.context.view_layer.objects.active = cloud.levels[0]
    harm(cloud.sources[0])
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.farfield.btf_bake(**BAKE)


def test_a_number_that_is_no_square_is_refused(cloud):
    with pytest.raises(RuntimeError, match="no square number; take 36 or 49"):
        bpy.ops.farfield.btf_bake(**{**BAKE, "views": 40})


@pytest.mark.parametrize(("lights", "upper"), [(64, False), (64, True), (9, True)])
def test_suns_cover_the_sphere_or_its_upper_half_once(lights, upper):
    width = sun_angle(BtfSettings(lights=lights, upper_hemisphere=upper))
    disc = 2.0 * np.pi * (1.0 - np.cos(0.5 * width))
    assert lights * disc == pytest.approx((2.0 if upper else 4.0) * np.pi)
