"""The relightable material renders in Cycles what `RelightableTexture` computes, per texel, from baked and interpolated views."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy
import mathutils

from bridge import blender_scenes
from farfield.addon.bridge.billboards.cloud_materials import FRONT_COLOR, FRONT_NORMAL, FRONT_ROUGHNESS_METALLIC_DEPTH
from farfield.addon.bridge.billboards.level_objects import read_level_texels
from farfield.addon.bridge.btf.levels.decode import read_relightable_texture
from farfield.addon.bridge.btf.levels.emission_levels import assign_relightable_material, read_texel_surface, restore_pbr_material
from farfield.addon.bridge.btf.materials.emission_material import AMBIENT, sun_color_property, sun_direction_property
from farfield.addon.bridge.imaging.images import create_image
from farfield.addon.bridge.lod_crossfade import GROUP_NAME, add_crossfade, remove_crossfade
from farfield.addon.bridge.rendering.render_scene import render_scene
from farfield.addon.core.btf.compression import CompressedTextures
from farfield.addon.core.btf.factorization.factors import Factors
from farfield.addon.core.btf.reflectance.lobes import GrazingFresnel, Lobes, TexelSurface, specular_lobe
from farfield.addon.core.btf.reflectance.shadows import Shadows
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.geometry.cameras import OrthographicView
from farfield.addon.core.geometry.directions import DirectionGrid
from image_data import pixel_of
from random_textures import decode_radiance, random_color_factors

SIDE, PIXELS = 8, 160  # texels along the card, pixels along the image
BETWEEN = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
SUN = np.array([0.05, -0.1, 1.0]) / np.linalg.norm([0.05, -0.1, 1.0])  # near views above the card


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.reset_scene()


def create_card(pbr_material: bpy.types.Material | None = None) -> bpy.types.Object:
    """Create a card of 8 x 8 texels."""
    card = blender_scenes.card()
    card["farfield_atlas"], card["farfield_error"] = [SIDE, SIDE], 0.5
    card.data.materials.append(pbr_material)
    return card


def create_relightable_card(clusters: int, components: int, blend_texels: bool = False, lobes: Lobes | None = None) -> bpy.types.Object:
    """Create an opaque card with random textures whose radiance is never negative."""
    card = create_card(None if lobes is None else create_pbr_material(lobes.surface.normals[0]))
    assign_random_textures(card, clusters, components, blend_texels, lobes)
    return card


def assign_random_textures(
    card: bpy.types.Object,
    clusters: int,
    components: int,
    blend_texels: bool = False,
    lobes: Lobes | None = None,
    emission_radiance: float = 0.0,
):
    texels = read_level_texels(card)
    emission = np.full((len(texels), 3), emission_radiance, np.float32) if emission_radiance else None
    color = random_color_factors(len(texels), clusters, components, views=16, lights=9)
    np.abs(color.basis, out=color.basis)
    alpha = Factors(np.ones((len(texels), 1), np.float32), np.ones((16, 1, 1), np.float32), color.known)
    chromaticity = np.tile(np.float32([0.7, 1.3, 1.1]), (len(texels), 1))  # uniform, since only this texture is filtered
    assign_relightable_material(
        card,
        texels,
        CompressedTextures(lobes, chromaticity, color, alpha, emission),
        BtfSettings(views_per_side=4, lights_per_side=3, blend_texels=blend_texels),
    )


def create_pbr_material(normal: np.ndarray) -> bpy.types.Material:
    """Create a material with one map, a uniform `normal`."""
    material = blender_scenes.create_material("PBR")
    pixels = np.broadcast_to(np.append(0.5 * normal + 0.5, 1.0), (SIDE, SIDE, 4))
    image_node = material.node_tree.nodes.new("ShaderNodeTexImage")
    image_node.label, image_node.image = FRONT_NORMAL, create_image("Normals", pixels, is_data=True)
    return material


def uniform_lobes(roughness: float, diffuse: float = 0.3, f0: float = 0.2, f90_minus_f0: float = 0.5) -> Lobes:
    """Return lobes that are the same at all texels, with a tilted normal."""
    normal = np.array([0.36, -0.16, 0.92]) / np.linalg.norm([0.36, -0.16, 0.92])
    count = SIDE * SIDE
    surface = TexelSurface(np.tile(normal, (count, 1)).astype(np.float32), np.full(count, roughness, np.float32))
    base_color = np.float32([1.0, 0.5, 0.25])
    return Lobes(
        surface,
        np.tile(diffuse * base_color, (count, 1)),
        np.tile(f0 * base_color[::-1], (count, 1)),
        np.full(count, f90_minus_f0, np.float32),
    )


def render(
    card: bpy.types.Object,
    direction: np.ndarray,
    samples: int,
    others: list[bpy.types.Object] | None = None,
    options: dict[str, int] | None = None,
) -> tuple[np.ndarray, OrthographicView]:
    """Render `card` and `others` with Cycles from `direction`; return the image (H, W, 4) and its view. options: of the render settings."""
    view = OrthographicView(direction, np.zeros(3), PIXELS, 3.0 / PIXELS)
    with render_scene("Card") as work:
        for item in [card, *(others or [])]:
            work.scene.collection.objects.link(item)
        work.scene.render.engine, work.scene.render.film_transparent = "CYCLES", True
        cycles = work.scene.cycles
        cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = samples, False, False
        cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        work.scene.render.resolution_x = work.scene.render.resolution_y = PIXELS
        for name, value in (options or {}).items():
            setattr(work.scene.render, name, value)
        work.camera.data.type, work.camera.data.ortho_scale = "ORTHO", PIXELS * view.pixel_size
        work.camera.matrix_world = mathutils.Matrix(
            np.vstack([np.column_stack([view.right, view.up, direction, 4.0 * direction]), [0.0, 0.0, 0.0, 1.0]]).tolist()
        )
        return work.render(), view


def set_sun(card: bpy.types.Object, direction: np.ndarray) -> None:
    card[sun_direction_property(0)], card[sun_color_property(0)] = list(direction), [1.0, 1.0, 1.0]


def sample_texels(image: np.ndarray, view: OrthographicView, card: bpy.types.Object) -> np.ndarray:
    """Return the color of `image` at every texel (H, W, 4), at the pixel nearest to its center."""
    texels = read_level_texels(card)
    return texels.to_image(image[pixel_of(view, texels.positions)])


@pytest.mark.parametrize(
    ("clusters", "components", "between"),
    [(3, 5, True), *(pytest.param(*case, marks=pytest.mark.exhaustive) for case in ((3, 5, False), (32, 8, True), (32, 8, False)))],
)
def test_clustered_texels_match_the_arrays(clusters, components, between):
    card = create_relightable_card(clusters, components)
    texture = read_relightable_texture(card)
    view, light = (BETWEEN, BETWEEN[[1, 0, 2]]) if between else (texture.views.directions[5], texture.lights.directions[3])
    set_sun(card, light)
    image, render_view = render(card, view, 1)
    expected = decode_radiance(texture, view, light)
    rendered = sample_texels(image, render_view, card)
    np.testing.assert_allclose(rendered[..., :3], expected, rtol=0.01, atol=0.002)
    assert (rendered[..., 3] == 1.0).all()


@pytest.mark.skipif("use_texture_cache" not in bpy.types.RenderSettings.bl_rna.properties, reason="Blender has it from 5.2 on")
def test_the_texture_cache_of_cycles_does_not_filter_packed_tables(tmp_path, monkeypatch):
    """A pixel shows several texels, for which the cache would read a coarser level of each table."""
    monkeypatch.setattr(bpy.context.preferences.filepaths, "texture_cache_directory", str(tmp_path))
    card = create_relightable_card(3, 5)
    set_sun(card, SUN)
    sets = [{"use_texture_cache": value, "use_auto_generate_texture_cache": value, "resolution_percentage": 2} for value in (False, True)]
    plain, cached = (render(card, BETWEEN, 4, options=options)[0] for options in sets)
    assert plain[..., :3].max() > 0.05 and np.array_equal(plain, cached)
    assert not list(tmp_path.iterdir())


def test_clustered_texels_match_the_arrays_under_uniform_lighting():
    card = create_relightable_card(3, 5)
    texture = read_relightable_texture(card)
    card[AMBIENT] = [0.5, 1.0, 0.0]
    view = texture.views.directions[6]
    image, render_view = render(card, view, 1)
    dome = texture.color.basis[6].reshape(-1, 10, 3)[:, -1]
    expected = (texture.color.reconstruct(dome) * texture.chromaticity * [0.5, 1.0, 0.0]).reshape(SIDE, SIDE, 3)
    np.testing.assert_allclose(sample_texels(image, render_view, card)[..., :3], expected, rtol=0.01, atol=0.002)


@pytest.mark.slow
def test_parallax_mapping_matches_the_arrays():
    """The normal and depth vary over the card; it is seen obliquely, from both sides, and on a rotated object."""
    card = create_card(create_pbr_material(np.array([0.0, 0.0, 1.0])))
    texels = read_level_texels(card)
    tilts = np.linspace(-0.6, 0.6, SIDE)
    scaled_normals = np.stack(np.broadcast_arrays(tilts[None, :], tilts[:, None], 1.0), axis=2)
    pixels = np.dstack([0.5 * scaled_normals / 1.5 + 0.5, np.ones((SIDE, SIDE))]).astype(np.float32)
    depths = np.broadcast_to(np.float32([0.5, 0.0, 0.75, 1.0]), (SIDE, SIDE, 4))
    nodes = card.data.materials[0].node_tree.nodes
    next(node for node in nodes if node.label == FRONT_NORMAL).image = create_image(
        "Varying Normals", pixels, is_data=True, half_floats=True
    )
    for label, values in ((FRONT_ROUGHNESS_METALLIC_DEPTH, depths), (FRONT_COLOR, np.ones_like(depths))):
        image_node = nodes.new("ShaderNodeTexImage")
        image_node.label, image_node.image = label, create_image(label, values, is_data=True, half_floats=True)
    lobes = uniform_lobes(0.4, f0=2.0, f90_minus_f0=0.0)
    surface = read_texel_surface(card, texels)
    assert surface.parallax is not None
    assign_random_textures(card, 3, 5, lobes=replace(lobes, surface=replace(surface, roughness=lobes.surface.roughness)))
    texture = read_relightable_texture(card)
    inner = np.s_[2:-2, 2:-2]
    rotation = mathutils.Matrix.Rotation(0.7, 3, (0.2, 0.3, 1.0))
    for view, matrix in ((BETWEEN, np.eye(3)), (BETWEEN * [1, 1, -1], np.eye(3)), (BETWEEN, np.array(rotation, float))):
        set_sun(card, matrix @ SUN)
        card.matrix_world = mathutils.Matrix(matrix.tolist()).to_4x4()
        image, render_view = render(card, matrix @ view, 1)
        rendered = image[pixel_of(render_view, texels.positions @ matrix.T)].reshape(SIDE, SIDE, 4)[inner][..., :3]
        expected = decode_radiance(texture, view, SUN)[inner]
        assert np.abs(rendered - expected).mean() < 0.01 * expected.mean()
    without_parallax = replace(texture, lobes=replace(texture.lobes, surface=replace(texture.lobes.surface, parallax=None)))
    assert (
        np.abs(decode_radiance(without_parallax, BETWEEN, SUN)[inner] - decode_radiance(texture, BETWEEN, SUN)[inner]).mean()
        > 0.06 * expected.mean()
    )


def test_sky_visibility_and_grazing_reflectance_match_the_arrays():
    sky_visibility = np.linspace(0.3, 1.5, SIDE**2).astype(np.float32)
    card = create_relightable_card(
        3, 5, lobes=replace(uniform_lobes(0.5), sky_visibility=sky_visibility, dome_fresnel=GrazingFresnel(0.7, 2.5))
    )
    texture = read_relightable_texture(card)
    np.testing.assert_allclose(texture.lobes.sky_visibility, sky_visibility, rtol=1e-3)
    card[AMBIENT] = [0.5, 1.0, 0.0]
    view = texture.views.directions[6]
    image, render_view = render(card, view, 1)
    dome = texture.color.reconstruct(texture.color.basis[6].reshape(-1, 10, 3)[:, -1]) * texture.chromaticity
    expected = ((dome + texture.lobes.radiance_under_dome(view)) * [0.5, 1.0, 0.0]).reshape(SIDE, SIDE, 3)
    assert np.abs(sample_texels(image, render_view, card)[..., :3] - expected).mean() < 0.01 * expected.mean()


def test_emission_needs_no_light():
    card = create_card()
    assign_random_textures(card, 1, 4, emission_radiance=0.7)
    dark, render_view = render(card, BETWEEN, 1)
    np.testing.assert_allclose(sample_texels(dark, render_view, card)[..., :3], 0.7, rtol=1e-3)
    set_sun(card, SUN)
    with_sun, _ = render(card, BETWEEN, 1)
    assert (sample_texels(with_sun, render_view, card)[..., :3] > 0.7).all()


def test_one_set_of_components_matches_the_arrays():
    card = create_relightable_card(1, 12)
    texture = read_relightable_texture(card)
    set_sun(card, texture.lights.directions[3])
    image, render_view = render(card, texture.views.directions[5], 1)
    expected = decode_radiance(texture, texture.views.directions[5], texture.lights.directions[3])
    rendered = sample_texels(image, render_view, card)[..., :3]
    # The textures are filtered between texels, and the nearest pixel is not exactly at the center of its texel.
    assert np.abs(rendered - expected).mean() < 0.04 * expected.mean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("roughness", "is_rotated"),
    [(0.15, False), (0.5, True), *(pytest.param(*case, marks=pytest.mark.exhaustive) for case in ((0.15, True), (0.5, False)))],
)
def test_lobes_match_the_arrays(roughness, is_rotated):
    """The card is seen from the front, from the back, where the normal is flipped, and on a rotated object."""
    card = create_relightable_card(3, 5, lobes=uniform_lobes(roughness))
    texture = read_relightable_texture(card)
    assert texture.lobes.surface.roughness == pytest.approx(roughness, rel=1e-3)
    rotation = mathutils.Matrix.Rotation(0.7 if is_rotated else 0.0, 3, (0.2, 0.3, 1.0))
    for view in (BETWEEN, -BETWEEN):
        light = 2.0 * (view @ [0.36, -0.16, 0.92]) * np.array([0.36, -0.16, 0.92]) - view  # near the mirror direction
        light /= np.linalg.norm(light)
        set_sun(card, np.array(rotation, float) @ light)
        card.matrix_world = rotation.to_4x4()
        image, render_view = render(card, np.array(rotation, float) @ view, 1)
        positions = read_level_texels(card).positions @ np.array(rotation, float).T
        rendered = image[pixel_of(render_view, positions)].reshape(SIDE, SIDE, 4)[..., :3]
        expected = decode_radiance(texture, view, light)
        without_lobes = np.maximum(expected.reshape(-1, 3) - texture.lobes.radiance_under_suns(view, light[None])[:, 0], 0.0)
        assert expected.mean() > 1.05 * without_lobes.mean(), "the lobes must be visible"
        np.testing.assert_allclose(rendered, expected, rtol=0.03, atol=0.005)


def test_sun_visibility_matches_the_arrays():
    lobes = uniform_lobes(0.4)
    random = np.random.default_rng(3)
    angles = Factors(
        random.normal(size=(SIDE * SIDE, 5)).astype(np.float32), random.normal(0.0, 0.05, (64, 5, 1)).astype(np.float32), np.ones(1)
    )
    card = create_relightable_card(3, 5, lobes=replace(lobes, shadows=Shadows(DirectionGrid(8), angles)))
    texture = read_relightable_texture(card)
    np.testing.assert_allclose(texture.lobes.shadows.angles.weights, angles.weights, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(texture.lobes.shadows.angles.basis, angles.basis, rtol=1e-3, atol=1e-3)
    set_sun(card, SUN)
    image, render_view = render(card, BETWEEN, 1)
    visibility = texture.lobes.shadows.visibility(SUN[None])
    assert visibility.min() < 0.1 and visibility.max() > 0.9
    rendered, expected = sample_texels(image, render_view, card)[..., :3], decode_radiance(texture, BETWEEN, SUN)
    # Shadow weights are filtered, and the nearest pixel is not exactly at the center of its texel.
    assert np.abs(rendered - expected).mean() < 0.04 * expected.mean()


def test_lobes_match_the_arrays_under_uniform_lighting():
    card = create_relightable_card(3, 5, lobes=uniform_lobes(0.4))
    texture = read_relightable_texture(card)
    card[AMBIENT] = [1.0, 0.5, 2.0]
    view = texture.views.directions[6]
    image, render_view = render(card, view, 1)
    residual = texture.color.reconstruct(texture.color.basis[6].reshape(-1, 10, 3)[:, -1]) * texture.chromaticity
    expected = ((residual + texture.lobes.radiance_under_dome(view)) * [1.0, 0.5, 2.0]).reshape(SIDE, SIDE, 3)
    np.testing.assert_allclose(sample_texels(image, render_view, card)[..., :3], expected, rtol=0.01, atol=0.002)


def test_the_specular_lobe_is_that_of_cycles():
    card = blender_scenes.card()
    material = blender_scenes.create_material("Glossy")
    tree = material.node_tree
    shader = tree.nodes.new("ShaderNodeBsdfAnisotropic")
    shader.distribution, shader.inputs["Roughness"].default_value, shader.inputs["Color"].default_value = "GGX", 0.5, (1.0, 1.0, 1.0, 1.0)
    tree.links.new(shader.outputs[0], next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL").inputs["Surface"])
    card.data.materials.append(material)
    light_data = bpy.data.lights.new("Sun", "SUN")
    light_data.energy, light_data.angle = 1.0, 0.0
    sun = bpy.data.objects.new("Sun", light_data)
    sun.rotation_euler = mathutils.Vector(SUN).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    for view in (BETWEEN, np.array([0.0, 0.0, 1.0]), np.array([0.9, 0.1, 0.42]) / np.linalg.norm([0.9, 0.1, 0.42])):
        image, render_view = render(card, view, 16, [sun])
        rendered = image[pixel_of(render_view, np.zeros((1, 3)))][0, 0]
        expected = specular_lobe(np.array([[0.0, 0.0, 1.0]]), view, SUN[None], np.array([0.5]))[0][0, 0]
        assert rendered == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_the_mean_of_blended_texels_is_bilinear():
    card = create_relightable_card(4, 4, blend_texels=True)
    texture = read_relightable_texture(card)
    set_sun(card, texture.lights.directions[3])
    view = texture.views.directions[5]
    assert view[2] > 0.5
    image, render_view = render(card, view, 12)
    unblended = decode_radiance(texture, view, texture.lights.directions[3])
    texels = read_level_texels(card)
    halfway = 0.5 * (texels.positions.reshape(SIDE, SIDE, 3)[:, 1:] + texels.positions.reshape(SIDE, SIDE, 3)[:, :-1])
    rendered = image[pixel_of(render_view, halfway.reshape(-1, 3))][:, :3].reshape(SIDE, SIDE - 1, 3)
    mean = 0.5 * (unblended[:, 1:] + unblended[:, :-1])
    contrast = np.abs(unblended[:, 1:] - unblended[:, :-1]).mean()
    assert np.abs(rendered - mean).mean() < 0.2 * contrast, "without blending, the error would be half the contrast"
    assert np.abs(rendered.mean() - mean.mean()) < 0.02 * mean.mean()


def test_clusters_are_read_back_from_the_material():
    card = create_relightable_card(3, 5)
    texture, expected = read_relightable_texture(card), random_color_factors(SIDE * SIDE, 3, 5, views=16, lights=9)
    np.testing.assert_array_equal(texture.color.labels, expected.labels)
    np.testing.assert_allclose(texture.color.weights, expected.weights, atol=5e-4)
    assert texture.color.clusters == 3 and texture.color.basis.shape == (16, 15, 30)


@pytest.mark.slow
@pytest.mark.parametrize("visible_from", ["above", "below"])
def test_shadows_have_the_silhouette_seen_from_the_light(visible_from):
    """A card that is only visible from above, or only from below, casts a shadow of a Sun above on the ground."""
    card = create_relightable_card(1, 4)
    views = read_relightable_texture(card).views
    is_visible = (views.directions[:, 2] > 0.0) == (visible_from == "above")
    texels = read_level_texels(card)
    known = np.ones(len(texels), bool)
    alpha = Factors(np.ones((len(texels), 1), np.float32), is_visible.astype(np.float32)[:, None, None], known)
    color = random_color_factors(len(texels), 1, 4, views=16, lights=9)
    assign_relightable_material(
        card,
        texels,
        CompressedTextures(None, np.ones((len(texels), 3), np.float32), color, alpha),
        BtfSettings(views_per_side=4, lights_per_side=3),
    )
    card.location.z = 1.0
    ground = blender_scenes.card()
    ground.data.transform(mathutils.Matrix.Scale(5.0, 4))
    ground.data.materials.append(blender_scenes.create_material("White", (1.0, 1.0, 1.0), 1.0))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = mathutils.Vector(SUN).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    card[sun_direction_property(0)] = list(SUN)  # without a color, so the card stays black
    direction = np.array([-0.2, 0.6, 0.77]) / np.linalg.norm([-0.2, 0.6, 0.77])
    image, view = render(card, direction, 4, [ground, sun])
    shaded, open_ground = np.array([0.5, 0.9, 0.0]), np.array([1.3, 0.3, 0.0])
    shade, light = image[pixel_of(view, np.stack([shaded, open_ground]))][:, :3].mean(axis=1)
    assert light > 0.1
    assert shade == pytest.approx(0.0, abs=0.02) if visible_from == "above" else shade == pytest.approx(light, rel=0.1)


def test_relightable_materials_keep_the_cross_fade():
    card = create_card(blender_scenes.create_material("PBR"))
    add_crossfade(card, 0.01, 0.02, 0.5)
    assign_random_textures(card, 1, 3)
    assert count_crossfade_nodes(card) == 1
    restore_pbr_material(card)
    assert card.data.materials[0].name == "PBR" and count_crossfade_nodes(card) == 1
    remove_crossfade(card, card.data.materials)
    assert count_crossfade_nodes(card) == 0


def count_crossfade_nodes(card: bpy.types.Object) -> int:
    nodes = card.data.materials[0].node_tree.nodes
    return sum(node.type == "GROUP" and node.node_tree.name.startswith(GROUP_NAME) for node in nodes)
