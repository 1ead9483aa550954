"""The material shows in Cycles what the arrays say: texel by texel, from baked views and between them."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy
import mathutils

from bridge import blender_scenes
from farfield.addon.bridge.btf_clouds import plain_surface, take_off, texels_of_level, wear
from farfield.addon.bridge.btf_materials import AMBIENT, light_property, sun_property
from farfield.addon.bridge.btf_reading import baked_atlas
from farfield.addon.bridge.cloud_materials import FRONT_NORMAL, FRONT_SURFACE
from farfield.addon.bridge.fades import GROUP_NAME, fade, unfade
from farfield.addon.bridge.images import data_image
from farfield.addon.bridge.temporary import temporary_scene
from farfield.addon.core.btf.compression import Compressed
from farfield.addon.core.btf.factors import Factors
from farfield.addon.core.btf.lobes import Grazing, Lobes, Surface, glossy_lobe
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.btf.shadows import Shadows
from farfield.addon.core.btf.texels import View
from farfield.addon.core.direction_grids import DirectionGrid
from made_atlases import decoded, made_colour

SIDE, PIXELS = 8, 160  # texels along the card, pixels along the picture
BETWEEN = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
LAMP = np.array([0.05, -0.1, 1.0]) / np.linalg.norm([0.05, -0.1, 1.0])  # among views that are all above


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.fresh()


def plain_card(plain: bpy.types.Material | None = None) -> bpy.types.Object:
    """A card of 8 x 8 texels."""
    card = blender_scenes.card()
    card["farfield_atlas"] = [SIDE, SIDE]
    card.data.materials.append(plain)
    return card


def dressed(clusters: int, components: int, blend_texels: bool = False, lobes: Lobes | None = None) -> bpy.types.Object:
    """A card, opaque, in textures of random numbers that no light makes negative."""
    card = plain_card(None if lobes is None else plain_maps(lobes.surface.normals[0]))
    dress(card, clusters, components, blend_texels, lobes)
    return card


def dress(
    card: bpy.types.Object, clusters: int, components: int, blend_texels: bool = False, lobes: Lobes | None = None, shining: float = 0.0
):
    texels = texels_of_level(card)
    glow = np.full((len(texels), 3), shining, np.float32) if shining else None
    colour = made_colour(len(texels), clusters, components, views=16, lights=9)
    np.abs(colour.basis, out=colour.basis)
    alpha = Factors(np.ones((len(texels), 1), np.float32), np.ones((16, 1, 1), np.float32), colour.known)
    tints = np.tile(np.float32([0.7, 1.3, 1.1]), (len(texels), 1))  # equal, since they alone are filtered
    wear(card, texels, Compressed(lobes, tints, colour, alpha, glow), BtfSettings(views=16, lights=9, blend_texels=blend_texels))


def plain_maps(normal: np.ndarray) -> bpy.types.Material:
    """A material with one map, of the same `normal` everywhere."""
    made = blender_scenes.material("Plain")
    pixels = np.broadcast_to(np.append(0.5 * normal + 0.5, 1.0), (SIDE, SIDE, 4))
    texture = made.node_tree.nodes.new("ShaderNodeTexImage")
    texture.label, texture.image = FRONT_NORMAL, data_image("Normals", pixels, is_data=True)
    return made


def even_lobes(roughness: float, diffuse: float = 0.3, specular: float = 0.2, rim: float = 0.5) -> Lobes:
    """Lobes that are the same at all texels, leaning to one side."""
    normal = np.array([0.36, -0.16, 0.92]) / np.linalg.norm([0.36, -0.16, 0.92])
    count = SIDE * SIDE
    surface = Surface(np.tile(normal, (count, 1)).astype(np.float32), np.full(count, roughness, np.float32))
    hue = np.float32([1.0, 0.5, 0.25])
    return Lobes(surface, np.tile(diffuse * hue, (count, 1)), np.tile(specular * hue[::-1], (count, 1)), np.full(count, rim, np.float32))


def rendered(
    card: bpy.types.Object, direction: np.ndarray, samples: int, others: list[bpy.types.Object] | None = None
) -> tuple[np.ndarray, View]:
    """A Cycles picture (H, W, 4) of `card`, and `others` beside it, from `direction`, and the view it was taken from."""
    view = View(direction, np.zeros(3), PIXELS, 3.0 / PIXELS)
    with temporary_scene("Card") as work:
        for item in [card, *(others or [])]:
            work.scene.collection.objects.link(item)
        work.scene.render.engine, work.scene.render.film_transparent = "CYCLES", True
        cycles = work.scene.cycles
        cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = samples, False, False
        cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        work.scene.render.resolution_x = work.scene.render.resolution_y = PIXELS
        work.camera.data.type, work.camera.data.ortho_scale = "ORTHO", PIXELS * view.pixel
        work.camera.matrix_world = mathutils.Matrix(
            np.vstack([np.column_stack([view.right, view.up, direction, 4.0 * direction]), [0.0, 0.0, 0.0, 1.0]]).tolist()
        )
        return work.render(), view


def lit(card: bpy.types.Object, direction: np.ndarray) -> None:
    card[sun_property(0)], card[light_property(0)] = list(direction), [1.0, 1.0, 1.0]


def at_texels(picture: np.ndarray, view: View, card: bpy.types.Object) -> np.ndarray:
    """What `picture` shows of every texel (H, W, 4), at the pixel nearest to its middle."""
    texels = texels_of_level(card)
    return texels.image(picture[view.cells(texels.positions)])


@pytest.mark.parametrize(("clusters", "components"), [(3, 5), (32, 8)])
@pytest.mark.parametrize("between", [False, True], ids=["baked", "between"])
def test_texels_in_clusters_shine_as_the_arrays_say(clusters, components, between):
    card = dressed(clusters, components)
    atlas = baked_atlas(card)
    view, light = (BETWEEN, BETWEEN[[1, 0, 2]]) if between else (atlas.views.directions[5], atlas.lights.directions[3])
    lit(card, light)
    picture, taken = rendered(card, view, 1)
    expected = decoded(atlas, view, light)
    shown = at_texels(picture, taken, card)
    np.testing.assert_allclose(shown[..., :3], expected, rtol=0.01, atol=0.002)
    assert (shown[..., 3] == 1.0).all()


def test_texels_in_clusters_shine_under_the_dome():
    card = dressed(3, 5)
    atlas = baked_atlas(card)
    card[AMBIENT] = [0.5, 1.0, 0.0]
    view = atlas.views.directions[6]
    picture, taken = rendered(card, view, 1)
    dome = atlas.colour.basis[6].reshape(-1, 10, 3)[:, -1]
    expected = (atlas.colour.applied(dome) * atlas.tints * [0.5, 1.0, 0.0]).reshape(SIDE, SIDE, 3)
    np.testing.assert_allclose(at_texels(picture, taken, card)[..., :3], expected, rtol=0.01, atol=0.002)


def test_normals_are_looked_up_where_the_arrays_say():
    """Normals that turn along the card, a surface that stands out: seen aslant, both ways round, and on an instance that was turned."""
    card = plain_card(plain_maps(np.array([0.0, 0.0, 1.0])))
    card["farfield_error"] = 0.5
    texels = texels_of_level(card)
    slope = np.linspace(-0.6, 0.6, SIDE)
    turning = np.stack(np.broadcast_arrays(slope[None, :], slope[:, None], 1.0), axis=2)
    pixels = np.dstack([0.5 * turning / 1.5 + 0.5, np.ones((SIDE, SIDE))]).astype(np.float32)
    depths = np.broadcast_to(np.float32([0.5, 0.0, 0.75, 1.0]), (SIDE, SIDE, 4))
    nodes = card.data.materials[0].node_tree.nodes
    next(node for node in nodes if node.label == FRONT_NORMAL).image = data_image("Turning", pixels, is_data=True, half_floats=True)
    texture = nodes.new("ShaderNodeTexImage")
    texture.label, texture.image = FRONT_SURFACE, data_image("Depths", depths, is_data=True, half_floats=True)
    lobes = even_lobes(0.4, specular=2.0, rim=0.0)
    surface = plain_surface(card, texels)
    assert surface.relief is not None
    dress(card, 3, 5, lobes=replace(lobes, surface=replace(surface, roughness=lobes.surface.roughness)))
    atlas = baked_atlas(card)
    inner = np.s_[2:-2, 2:-2]
    turn = mathutils.Matrix.Rotation(0.7, 3, (0.2, 0.3, 1.0))
    for view, matrix in ((BETWEEN, np.eye(3)), (BETWEEN * [1, 1, -1], np.eye(3)), (BETWEEN, np.array(turn, float))):
        lit(card, matrix @ LAMP)
        card.matrix_world = mathutils.Matrix(matrix.tolist()).to_4x4()
        picture, taken = rendered(card, matrix @ view, 1)
        shown = picture[taken.cells(texels.positions @ matrix.T)].reshape(SIDE, SIDE, 4)[inner][..., :3]
        expected = decoded(atlas, view, LAMP)[inner]
        assert np.abs(shown - expected).mean() < 0.01 * expected.mean()
    flat = replace(atlas, lobes=replace(atlas.lobes, surface=replace(atlas.lobes.surface, relief=None)))
    assert np.abs(decoded(flat, BETWEEN, LAMP)[inner] - decoded(atlas, BETWEEN, LAMP)[inner]).mean() > 0.06 * expected.mean()


def test_a_dome_shines_on_lobes_as_the_arrays_say():
    openness = np.linspace(0.3, 1.5, SIDE**2).astype(np.float32)
    card = dressed(3, 5, lobes=replace(even_lobes(0.5), openness=openness, grazing=Grazing(0.7, 2.5)))
    atlas = baked_atlas(card)
    np.testing.assert_allclose(atlas.lobes.openness, openness, rtol=1e-3)
    card[AMBIENT] = [0.5, 1.0, 0.0]
    view = atlas.views.directions[6]
    picture, taken = rendered(card, view, 1)
    dome = atlas.colour.applied(atlas.colour.basis[6].reshape(-1, 10, 3)[:, -1]) * atlas.tints
    expected = ((dome + atlas.lobes.of_dome(view)) * [0.5, 1.0, 0.0]).reshape(SIDE, SIDE, 3)
    assert np.abs(at_texels(picture, taken, card)[..., :3] - expected).mean() < 0.01 * expected.mean()


def test_what_shines_by_itself_needs_no_lamp():
    card = plain_card()
    dress(card, 1, 4, shining=0.7)
    dark, taken = rendered(card, BETWEEN, 1)
    np.testing.assert_allclose(at_texels(dark, taken, card)[..., :3], 0.7, rtol=1e-3)
    lit(card, LAMP)
    with_lamp, _ = rendered(card, BETWEEN, 1)
    assert (at_texels(with_lamp, taken, card)[..., :3] > 0.7).all()


def test_one_set_of_components_shines_as_the_arrays_say():
    card = dressed(1, 12)
    atlas = baked_atlas(card)
    lit(card, atlas.lights.directions[3])
    picture, taken = rendered(card, atlas.views.directions[5], 1)
    expected = decoded(atlas, atlas.views.directions[5], atlas.lights.directions[3])
    shown = at_texels(picture, taken, card)[..., :3]
    # Between texels it is filtered, and the nearest pixel is not quite in the middle of its texel.
    assert np.abs(shown - expected).mean() < 0.04 * expected.mean()


@pytest.mark.parametrize("roughness", [0.15, 0.5])
@pytest.mark.parametrize("turned", [False, True], ids=["as baked", "turned"])
def test_lobes_shine_as_the_arrays_say(roughness, turned):
    """Seen from the front, and from behind where the normal turns round; and on an instance that was turned."""
    card = dressed(3, 5, lobes=even_lobes(roughness))
    atlas = baked_atlas(card)
    assert atlas.lobes.surface.roughness == pytest.approx(roughness, rel=1e-3)
    turn = mathutils.Matrix.Rotation(0.7 if turned else 0.0, 3, (0.2, 0.3, 1.0))
    for view in (BETWEEN, -BETWEEN):
        light = 2.0 * (view @ [0.36, -0.16, 0.92]) * np.array([0.36, -0.16, 0.92]) - view  # about where it mirrors
        light /= np.linalg.norm(light)
        lit(card, np.array(turn, float) @ light)
        card.matrix_world = turn.to_4x4()
        picture, taken = rendered(card, np.array(turn, float) @ view, 1)
        places = texels_of_level(card).positions @ np.array(turn, float).T
        shown = picture[taken.cells(places)].reshape(SIDE, SIDE, 4)[..., :3]
        expected = decoded(atlas, view, light)
        bare = np.maximum(expected.reshape(-1, 3) - atlas.lobes.of_suns(view, light[None])[:, 0], 0.0)
        assert expected.mean() > 1.05 * bare.mean(), "the lobes must be seen"
        np.testing.assert_allclose(shown, expected, rtol=0.03, atol=0.005)


def test_suns_reach_the_lobes_as_the_arrays_say():
    lobes = even_lobes(0.4)
    random = np.random.default_rng(3)
    angles = Factors(
        random.normal(size=(SIDE * SIDE, 5)).astype(np.float32), random.normal(0.0, 0.05, (64, 5, 1)).astype(np.float32), np.ones(1)
    )
    card = dressed(3, 5, lobes=replace(lobes, shadows=Shadows(DirectionGrid(8), angles)))
    atlas = baked_atlas(card)
    np.testing.assert_allclose(atlas.lobes.shadows.angles.weights, angles.weights, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(atlas.lobes.shadows.angles.basis, angles.basis, rtol=1e-3, atol=1e-3)
    lit(card, LAMP)
    picture, taken = rendered(card, BETWEEN, 1)
    reached = atlas.lobes.shadows.reached(LAMP[None])
    assert reached.min() < 0.1 and reached.max() > 0.9
    shown, expected = at_texels(picture, taken, card)[..., :3], decoded(atlas, BETWEEN, LAMP)
    # Weights of shadows are filtered, and the nearest pixel is not quite in the middle of its texel.
    assert np.abs(shown - expected).mean() < 0.04 * expected.mean()


def test_lobes_shine_under_the_dome():
    card = dressed(3, 5, lobes=even_lobes(0.4))
    atlas = baked_atlas(card)
    card[AMBIENT] = [1.0, 0.5, 2.0]
    view = atlas.views.directions[6]
    picture, taken = rendered(card, view, 1)
    rest = atlas.colour.applied(atlas.colour.basis[6].reshape(-1, 10, 3)[:, -1]) * atlas.tints
    expected = ((rest + atlas.lobes.of_dome(view)) * [1.0, 0.5, 2.0]).reshape(SIDE, SIDE, 3)
    np.testing.assert_allclose(at_texels(picture, taken, card)[..., :3], expected, rtol=0.01, atol=0.002)


def test_the_glossy_lobe_is_that_of_cycles():
    card = blender_scenes.card()
    made = blender_scenes.material("Glossy")
    tree = made.node_tree
    shader = tree.nodes.new("ShaderNodeBsdfAnisotropic")
    shader.distribution, shader.inputs["Roughness"].default_value, shader.inputs["Color"].default_value = "GGX", 0.5, (1.0, 1.0, 1.0, 1.0)
    tree.links.new(shader.outputs[0], next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL").inputs["Surface"])
    card.data.materials.append(made)
    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy, lamp.angle = 1.0, 0.0
    sun = bpy.data.objects.new("Sun", lamp)
    sun.rotation_euler = mathutils.Vector(LAMP).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    for view in (BETWEEN, np.array([0.0, 0.0, 1.0]), np.array([0.9, 0.1, 0.42]) / np.linalg.norm([0.9, 0.1, 0.42])):
        picture, taken = rendered(card, view, 16, [sun])
        shown = picture[taken.cells(np.zeros((1, 3)))][0, 0]
        expected = glossy_lobe(np.array([[0.0, 0.0, 1.0]]), view, LAMP[None], np.array([0.5]))[0][0, 0]
        assert shown == pytest.approx(expected, rel=0.02)


def test_blended_texels_are_those_around_in_the_mean():
    card = dressed(4, 4, blend_texels=True)
    atlas = baked_atlas(card)
    lit(card, atlas.lights.directions[3])
    view = atlas.views.directions[5]
    assert view[2] > 0.5
    picture, taken = rendered(card, view, 12)
    pure = decoded(atlas, view, atlas.lights.directions[3])
    texels = texels_of_level(card)
    halfway = 0.5 * (texels.positions.reshape(SIDE, SIDE, 3)[:, 1:] + texels.positions.reshape(SIDE, SIDE, 3)[:, :-1])
    shown = picture[taken.cells(halfway.reshape(-1, 3))][:, :3].reshape(SIDE, SIDE - 1, 3)
    mean = 0.5 * (pure[:, 1:] + pure[:, :-1])
    apart = np.abs(pure[:, 1:] - pure[:, :-1]).mean()
    assert np.abs(shown - mean).mean() < 0.2 * apart, "one of the two alone would be half their distance off"
    assert np.abs(shown.mean() - mean.mean()) < 0.02 * mean.mean()


def test_clusters_come_back_out_of_the_material():
    card = dressed(3, 5)
    atlas, meant = baked_atlas(card), made_colour(SIDE * SIDE, 3, 5, views=16, lights=9)
    np.testing.assert_array_equal(atlas.colour.labels, meant.labels)
    np.testing.assert_allclose(atlas.colour.weights, meant.weights, atol=5e-4)
    assert atlas.colour.clusters == 3 and atlas.colour.basis.shape == (16, 15, 30)


@pytest.mark.parametrize("shown_from", ["above", "below"])
def test_the_shadow_has_the_silhouette_that_the_lamp_sees(shown_from):
    """A card that is there only for those above it, or only for those below, between a sun above and a ground."""
    card = dressed(1, 4)
    views = baked_atlas(card).views
    there = (views.directions[:, 2] > 0.0) == (shown_from == "above")
    texels = texels_of_level(card)
    known = np.ones(len(texels), bool)
    alpha = Factors(np.ones((len(texels), 1), np.float32), there.astype(np.float32)[:, None, None], known)
    colour = made_colour(len(texels), 1, 4, views=16, lights=9)
    wear(card, texels, Compressed(None, np.ones((len(texels), 3), np.float32), colour, alpha), BtfSettings(views=16, lights=9))
    card.location.z = 1.0
    ground = blender_scenes.card()
    ground.data.transform(mathutils.Matrix.Scale(5.0, 4))
    ground.data.materials.append(blender_scenes.material("White", (1.0, 1.0, 1.0), 1.0))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = mathutils.Vector(LAMP).to_track_quat("Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)
    card[sun_property(0)] = list(LAMP)  # and no light: the card stays black
    beside = np.array([-0.2, 0.6, 0.77]) / np.linalg.norm([-0.2, 0.6, 0.77])
    picture, view = rendered(card, beside, 16, [ground, sun])
    shaded, open_ground = np.array([0.5, 0.9, 0.0]), np.array([1.3, 0.3, 0.0])
    shade, light = picture[view.cells(np.stack([shaded, open_ground]))][:, :3].mean(axis=1)
    assert light > 0.1
    assert shade == pytest.approx(0.0, abs=0.02) if shown_from == "above" else shade == pytest.approx(light, rel=0.1)


def test_relightable_textures_fade_where_the_plain_maps_did():
    card = plain_card(blender_scenes.material("Plain"))
    fade(card, 0.01, 0.02, 0.5)
    dress(card, 1, 3)
    assert fading_nodes(card) == 1
    take_off(card)
    assert card.data.materials[0].name == "Plain" and fading_nodes(card) == 1
    unfade(card, card.data.materials)
    assert fading_nodes(card) == 0


def fading_nodes(card: bpy.types.Object) -> int:
    nodes = card.data.materials[0].node_tree.nodes
    return sum(node.type == "GROUP" and node.node_tree.name.startswith(GROUP_NAME) for node in nodes)
