"""Leaves that an opacity map cuts out of cards become opaque pieces of the same color that cover as much."""

import bpy
import numpy as np
import pytest

from distance_scenes import add_camera, scattered, square
from farfield.addon.bridge.distance.foliage import find_foliage, simplify_foliage
from farfield.addon.bridge.distance.opacity_maps import create_opaque, read_opacity_map
from farfield.addon.bridge.geometry.mesh_arrays import read_attribute, read_positions
from farfield.addon.bridge.geometry.meshes import read_mesh
from farfield.addon.bridge.imaging.images import create_image
from farfield.addon.bridge.shading.surface_reader import read_surface
from farfield.addon.compat import enable_nodes
from farfield.addon.core.distance import DistanceSettings
from farfield.addon.core.distance.cutouts import MAX_PIECES, SIDE, Cutouts, find_cutouts, place_pieces
from farfield.addon.core.geometry.mesh import face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.distance.job import prepare
from farfield.addon.operators.job_run import run_job

pytestmark = pytest.mark.usefixtures("empty_scene")
COUNT = 400
CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
UVS = np.tile(CORNERS[[[0, 1, 2], [0, 2, 3]]], (COUNT, 1, 1))


def left_half(uvs: np.ndarray) -> np.ndarray:
    return (uvs[:, 0] < 0.5).astype(float)


def cards(is_double: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray, Cutouts]:
    """Return squares with a side of 1 whose left half is opaque."""
    part, quad = square(1.0)
    vertices, triangles = scattered(part, np.concatenate([quad, quad[:, ::-1]]) if is_double else quad, COUNT)
    uvs = np.tile(np.concatenate([UVS[:2], UVS[:2, ::-1]]), (COUNT, 1, 1)) if is_double else UVS
    owners = np.repeat(np.arange(COUNT), len(triangles) // COUNT)
    read = lambda rows, weights: left_half(np.einsum("nk,nkc->nc", weights, uvs[rows]))  # noqa: E731
    return vertices, triangles, uvs, find_cutouts(vertices, triangles, owners, np.ones(COUNT, bool), read)


@pytest.mark.slow
@pytest.mark.parametrize("is_double", [False, True])
def test_pieces_stand_in_leaves_and_cover_as_much(is_double):
    vertices, triangles, uvs, cutouts = cards(is_double)
    assert cutouts.areas == pytest.approx(np.log(2.0), rel=0.1) and cutouts.areas.mean() == pytest.approx(np.log(2.0), rel=0.03)
    assert (cutouts.is_double == is_double).all()
    ranks = np.random.default_rng(0).permutation(COUNT) / COUNT
    for pixel_size in (0.06, 0.2, 1.0):
        points = cutouts.choose(pixel_size, ranks)
        pieces = place_pieces(vertices, triangles, uvs[cutouts.triangles[points]], cutouts, points, pixel_size)
        areas, normals = face_areas_and_normals(pieces.positions)
        assert len(areas) == cutouts.count_triangles(pixel_size, ranks) == len(points) * (2 if is_double else 1)
        assert areas == pytest.approx((SIDE * pixel_size) ** 2)
        assert areas.sum() == pytest.approx(cutouts.areas.sum() * (2 if is_double else 1), rel=0.03)
        in_map = np.einsum("nck,nki->nci", pieces.weights, uvs[pieces.sources])
        assert left_half(in_map.mean(axis=1)).all() and np.ptp(in_map, axis=1).max() < 2.1e-3
        own = face_areas_and_normals(vertices[triangles[pieces.sources]])[1]
        assert np.einsum("ni,ni->n", normals, own) == pytest.approx(np.where(pieces.is_back, -1.0, 1.0))


def test_near_cards_stay_and_coarser_levels_have_only_points_of_finer_ones():
    _, _, _, cutouts = cards()
    ranks = np.arange(COUNT) / COUNT
    limit = np.sqrt(cutouts.areas[0] / MAX_PIECES) / SIDE
    assert not cutouts.is_replaced(0.9 * limit).any() and cutouts.is_replaced(1.1 * limit).all()
    fine, coarse = (set(cutouts.choose(size, ranks).tolist()) for size in (0.1, 0.7))
    assert 0 < len(coarse) < COUNT and coarse < fine


def test_nearly_opaque_cards_are_not_cut_out():
    part, quad = square(1.0)
    vertices, triangles = scattered(part, quad, COUNT)
    owners = np.repeat(np.arange(COUNT), 2)
    cutouts = find_cutouts(vertices, triangles, owners, np.ones(COUNT, bool), lambda rows, _: np.ones(len(rows)))
    assert not cutouts.areas.any() and not cutouts.is_replaced(1.0).any()


def leaf_material(is_mixed: bool = False) -> bpy.types.Material:
    """Return a material that shows the left half of cards in red, and nothing of the right half, whose color is green."""
    pixels = np.zeros((4, 8, 4), np.float32)
    pixels[:, :4, (0, 3)] = 1.0
    pixels[:, 4:, 1] = 1.0
    material = bpy.data.materials.new("Leaf")
    enable_nodes(material)
    tree = material.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = create_image("Leaf", pixels, is_data=False)
    shader, output = tree.nodes["Principled BSDF"], tree.nodes["Material Output"]
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    if is_mixed:
        mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
        tree.links.new(texture.outputs["Alpha"], mix.inputs[0])
        tree.links.new(clear.outputs[0], mix.inputs[1])
        tree.links.new(shader.outputs[0], mix.inputs[2])
        tree.links.new(mix.outputs[0], output.inputs["Surface"])
    else:
        tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    return material


@pytest.mark.parametrize("is_mixed", [False, True])
def test_an_opacity_map_is_read_and_left_out(is_mixed):
    material = leaf_material(is_mixed)
    opacity = read_opacity_map(material)
    assert opacity.sample(np.array([(0.2, 0.5), (0.8, 0.5), (1.2, 7.5)])).tolist() == [1.0, 0.0, 1.0]
    copy = create_opaque(material)
    assert read_surface(copy).is_opaque and not read_surface(material).is_opaque
    assert copy.surface_render_method == "DITHERED"
    assert read_surface(copy).color.textures[0].image == read_surface(material).color.textures[0].image
    assert read_opacity_map(copy) is None


def test_opacity_that_is_more_than_an_image_stays():
    material = leaf_material()
    noise = material.node_tree.nodes.new("ShaderNodeTexNoise")
    material.node_tree.links.new(noise.outputs[0], material.node_tree.nodes["Principled BSDF"].inputs["Alpha"])
    assert read_opacity_map(material) is None


def add_tree_of_cards() -> tuple[bpy.types.Object, np.ndarray]:
    """Add cards of leaves, and return their object and its vertices (V, 3)."""
    part, quad = square(1.0)
    vertices, triangles = scattered(part, quad, COUNT)
    mesh = bpy.data.meshes.new("Tree")
    mesh.from_pydata(vertices.tolist(), [], triangles.tolist())
    mesh.uv_layers.new(name="Karte").data.foreach_set("uv", UVS.ravel())
    mesh.materials.append(leaf_material())
    item = bpy.data.objects.new("Tree", mesh)
    bpy.context.scene.collection.objects.link(item)
    return item, vertices


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [8, 32])
def test_a_limit_of_bounces_that_darkens_cards_is_named(bounces):
    add_camera()
    item, _ = add_tree_of_cards()
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.transparent_max_bounces = "CYCLES", bounces
    message = run_to_end(run_job(prepare(scene, [item], DistanceSettings(min_triangles=10, billboard_cloud=False))))
    assert ("With 8 Max Transparent Bounces of Cycles, cards of leaves are darker" in message) is (bounces == 8)
    assert scene.cycles.transparent_max_bounces == bounces


def test_levels_of_a_tree_of_cards_are_opaque_from_some_distance_on():
    add_camera()
    item, vertices = add_tree_of_cards()
    scene = bpy.context.scene
    depsgraph = bpy.context.evaluated_depsgraph_get()
    foliage = find_foliage(read_mesh(item.evaluated_get(depsgraph), depsgraph))
    assert foliage.transparent_triangles == 2 * COUNT
    levels = run_to_end(simplify_foliage(item, foliage, scene))
    assert len(levels) >= 2 and not any(level.transparent for level in levels)
    for level in levels:
        used = {level.mesh.materials[polygon.material_index].name for polygon in level.mesh.polygons}
        assert used == {"Leaf Opaque"} and level.triangles == len(level.mesh.polygons)
        assert read_attribute(level.mesh.attributes["Karte"])[:, 0].max() < 0.51, "only the red half is shown"
        low, high = read_positions(level.mesh).min(axis=0), read_positions(level.mesh).max(axis=0)
        assert low == pytest.approx(vertices.min(axis=0), abs=2.0) and high == pytest.approx(vertices.max(axis=0), abs=2.0)
