"""A baked cloud looks like its source, from views that were not baked, and under rotated Sun lights."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy
import mathutils

from bridge import blender_scenes
from bridge.bakes import bake_in_this_process, open_cloud
from farfield.addon.bridge.billboards.level_objects import PBR_MATERIAL, read_level_texels
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.bridge.btf.levels.decode import read_relightable_texture
from farfield.addon.bridge.btf.levels.emission_levels import link_suns, raise_transparent_bounces
from farfield.addon.core.btf.reflectance.disc_lights import disc_radius
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.geometry.directions import DirectionGrid
from farfield.addon.operators.btf.estimates import EstimateCache
from farfield.addon.operators.results import read_result
from lib import scene_files
from lib.studio import bounding_sphere, open_studio

BAKE = {
    "model": "emission",
    "views_per_side": 4,
    "lights_per_side": 4,
    "samples": 4,
    "components": 4,
    "alpha_components": 4,
    "shadows_per_side": 4,
    "shadow_components": 4,
    "executor": "serial",  # starting processes would take longer than their renders
}
QUICK_BAKE = {**BAKE, "views_per_side": 2, "lights_per_side": 2, "samples": 1}


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.reset_scene()


def build_ball_cloud() -> SceneCloud:
    """Build the cloud of a diffuse red ball, which is selected."""
    ball = blender_scenes.ball(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 1.0))
    bpy.context.view_layer.objects.active = ball
    ball.select_set(True)
    bpy.ops.farfield.billboards_build(error=5.0, levels=1, samples=2, solid_parts="quads")
    return clouds_in(bpy.context.scene)[0]


@pytest.fixture(scope="module")
def cloud_file(extension, tmp_path_factory) -> Path:
    """A file with this cloud."""
    blender_scenes.reset_scene()
    build_ball_cloud()
    path = tmp_path_factory.mktemp("cloud") / "cloud.blend"
    scene_files.save_scene(path)
    return path


@pytest.fixture
def cloud(cloud_file) -> SceneCloud:
    """The cloud of a diffuse red ball, which is selected."""
    return open_cloud(cloud_file)


def create_sun(direction) -> bpy.types.Object:
    """Create a Sun light of 2 W/m2 that shines from `direction`."""
    light = bpy.data.lights.new("Test Sun", "SUN")
    light.energy, light.color = 2.0, (1.0, 0.5, 1.0)
    sun = bpy.data.objects.new("Test Sun", light)
    sun.rotation_euler = mathutils.Vector(direction).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    return sun


def render_source_and_cloud(cloud, sun, direction) -> tuple[np.ndarray, np.ndarray]:
    """Render the source and the cloud under `sun` only, from `direction`, at the pixel size of the cloud's error."""
    sources, level = cloud.sources, cloud.levels[0]
    center, radius = bounding_sphere(sources)
    pixel_size = cloud.errors[0]
    with open_studio([*sources, level], 8) as studio:
        work = studio.work
        work.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
        for item in list(work.scene.collection.objects):
            if item.type == "LIGHT":
                work.scene.collection.objects.unlink(item)
        work.scene.collection.objects.link(sun)
        unit = np.array(direction) / np.linalg.norm(direction)
        return tuple(studio.render(visible, unit, center, pixel_size, int(2.2 * radius / pixel_size)) for visible in (sources, [level]))


@pytest.mark.slow
def test_matches_the_source_under_a_rotated_sun(cloud):
    cloud = bake_in_this_process(cloud, **{**QUICK_BAKE, "lights_per_side": 4})
    sun = create_sun((0.3, -0.8, 0.5))
    link_suns(cloud.levels[0], [sun], (0.0, 0.0, 0.0))
    means = []
    for index in (1, 6):  # baked light directions, so that only the view is interpolated
        sun.rotation_euler = mathutils.Vector(DirectionGrid(4).directions[index]).to_track_quat("Z", "Y").to_euler()
        bpy.context.view_layer.update()
        source, baked = render_source_and_cloud(cloud, sun, (0.5, -0.8, 0.3))
        inside = source[..., 3] > 0.99
        brightness = source[inside][:, :3].mean()
        assert np.abs(source - baked)[inside][:, :3].mean() < 0.15 * brightness + 0.01
        assert baked[inside][:, :3].mean(axis=0) == pytest.approx(source[inside][:, :3].mean(axis=0), rel=0.12, abs=0.005)
        means.append(brightness)
        assert (baked[..., 3] > 0.5).sum() == pytest.approx((source[..., 3] > 0.5).sum(), rel=0.08)
    assert abs(means[0] - means[1]) > 0.02, "the test needs two different lightings"


@pytest.mark.slow
def test_a_wall_casts_sharp_shadows_between_the_baked_suns():
    ground, wall = blender_scenes.card("Ground"), blender_scenes.box("Wall")
    ground.scale = (2.0, 2.0, 1.0)
    wall.scale, wall.location.z = (1.0, 0.1, 0.5), 0.5
    ground.select_set(True)
    bpy.ops.farfield.billboards_build(error=5.0, levels=1, samples=1, combine_selected=True)
    (cloud,) = clouds_in(bpy.context.scene)
    cloud = bake_in_this_process(cloud, **{**QUICK_BAKE, "shadows_per_side": 9, "shadow_components": 8, "upper_hemisphere": True})
    texels, texture = read_level_texels(cloud.levels[0]), read_relightable_texture(cloud.levels[0])
    positions = texels.positions
    is_flat = np.abs(positions[:, 2]) < 1e-3
    is_beside_wall = np.maximum(np.abs(positions[:, 0]) - 1.0, np.abs(positions[:, 1]) - 0.1) > 0.15
    rows = (texels.pixels[:, 1] * texels.texture_size[0] + texels.pixels[:, 0])[is_flat & is_beside_wall]
    positions = positions[is_flat & is_beside_wall]
    assert len(positions) > 500
    for light in ([0.3, -0.6, 0.7], [-0.5, 0.5, 0.6], [0.1, 0.75, 0.5]):
        light = np.array(light) / np.linalg.norm(light)
        steps = np.linspace(0.0, 1.0 / light[2], 200)[:, None]  # along the ray until it is above the wall
        expected = []
        for position in positions:
            ray = position + steps * light
            expected.append(not ((np.abs(ray[:, 0]) < 1.0) & (np.abs(ray[:, 1]) < 0.1)).any())
        visibility = texture.lobes.shadows.visibility(light[None], rows)[:, 0]
        expected = np.array(expected)
        assert 0.02 < (~expected).mean() < 0.5
        assert visibility[~expected].mean() < 0.3 and visibility[expected].mean() > 0.95


def test_a_quick_bake_of_an_emissive_ball(cloud):
    """Emission does not depend on the lights, rays pass through all quads, no other data is left, and the PBR materials are restored."""
    shader = blender_scenes.shader_of(bpy.data.materials["Red"])
    shader.inputs["Emission Color"].default_value, shader.inputs["Emission Strength"].default_value = (0.2, 0.4, 1.0, 1.0), 0.5
    level, scene = cloud.levels[0], bpy.context.scene
    pbr_name = level.data.materials[0].name
    scene.cycles.transparent_max_bounces = 1
    counts = len(bpy.data.scenes), len(bpy.data.lights), len(bpy.data.worlds)
    assert bpy.ops.farfield.btf_bake(**{**QUICK_BAKE, "shadows_per_side": 0}) == {"FINISHED"}
    assert (len(bpy.data.scenes), len(bpy.data.lights), len(bpy.data.worlds)) == counts
    assert 2 < scene.cycles.transparent_max_bounces <= len(level.data.polygons) + 8
    scene.cycles.transparent_max_bounces = 999
    raise_transparent_bounces(cloud.collection, 3)
    assert scene.cycles.transparent_max_bounces == 999
    assert level[PBR_MATERIAL] == pbr_name and level.data.materials[0].name != pbr_name
    sun = scene.farfield_btf.sun_1 = create_sun((0.3, -0.8, 0.5))
    assert bpy.ops.farfield.btf_link_suns() == {"FINISHED"}
    assert len(level.animation_data.drivers) == 6
    for energy in (0.0, 4.0):
        sun.data.energy = energy
        source, baked = render_source_and_cloud(cloud, sun, (0.5, -0.8, 0.3))
        inside = source[..., 3] > 0.99
        if energy == 0.0:
            np.testing.assert_allclose(baked[inside][:, :3].mean(axis=0), [0.1, 0.2, 0.5], rtol=0.05)
        assert baked[inside][:, :3].mean(axis=0) == pytest.approx(source[inside][:, :3].mean(axis=0), rel=0.2)
    assert bpy.ops.farfield.btf_restore_pbr() == {"FINISHED"}
    assert read_result(bpy.context.scene, "btf")[0].endswith("has its PBR materials again.")
    assert level.data.materials[0].name == pbr_name
    assert len(level.animation_data.drivers) == 0
    assert not [key for key in tuple(level.keys()) if key.startswith(("farfield_sun", "farfield_ambient"))]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda source: bpy.data.objects.remove(source), "are missing"),
        (lambda source: setattr(source, "location", (1.0, 0.0, 0.0)), "edited or moved"),
        (lambda source: source.data.vertices[0].co.__setitem__(0, 9.0), "edited or moved"),
    ],
    ids=["removed", "moved", "edited"],
)
def test_a_cloud_with_changed_sources_is_rejected(cloud, change, message):
    bpy.context.view_layer.objects.active = cloud.levels[0]
    change(cloud.sources[0])
    with pytest.raises(RuntimeError, match=message):
        bpy.ops.farfield.btf_bake(**BAKE)


@pytest.mark.parametrize(("side", "upper"), [(8, False), (8, True), (3, True)])
def test_suns_cover_the_sphere_or_its_upper_half_once(side, upper):
    width = 2.0 * disc_radius(BtfSettings(lights_per_side=side, upper_hemisphere=upper).sun_solid_angle)
    disc = 2.0 * np.pi * (1.0 - np.cos(0.5 * width))
    assert side**2 * disc == pytest.approx((2.0 if upper else 4.0) * np.pi)


class TestEstimateCache:
    """The measured pace of a cloud's bake belongs to its collection."""

    settings = BtfSettings(views_per_side=2, lights_per_side=2, executor="serial")

    def test_a_measured_bake_sets_the_pace(self, cloud):
        cache = EstimateCache()
        first = cache.estimate(cloud, self.settings).seconds
        cache.remember_pace(cloud, self.settings, 3.0 * first)
        assert cache.estimate(cloud, self.settings).seconds == pytest.approx(3.0 * first)
        cache.clear()
        assert cache.estimate(cloud, self.settings).seconds == pytest.approx(first)

    def test_a_renamed_cloud_keeps_its_pace(self, cloud):
        cache = EstimateCache()
        cache.remember_pace(cloud, self.settings, 100.0)
        cache._last_pace = 1.0  # another cloud was baked since
        cloud.collection.name = "Renamed"
        assert cache.estimate(cloud, self.settings).seconds == pytest.approx(100.0)

    @pytest.mark.slow
    def test_a_deleted_cloud_is_evicted(self, cloud):
        cache = EstimateCache()
        cache.remember_pace(cloud, self.settings, 100.0)
        bpy.data.collections.remove(cloud.collection)
        box = blender_scenes.box()
        bpy.context.view_layer.objects.active = box
        box.select_set(True)
        bpy.ops.farfield.billboards_build(error=4.0, levels=1, samples=1)
        cache.estimate(clouds_in(bpy.context.scene)[0], self.settings)
        assert not cache._paces
