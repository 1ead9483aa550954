"""Large terrain in a scene: tiles as objects that meet exactly, with their normals, textures and materials."""

import shutil
from dataclasses import replace

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.bdam import materials
from farfield.addon.bridge.bdam import objects as terrain_objects
from farfield.addon.bridge.bdam.materials import LEVEL_ATTRIBUTE, TEXTURE_KEY, USED_KEY, mark_used, remove_unused
from farfield.addon.bridge.bdam.objects import SceneTerrain, TerrainChange
from farfield.addon.bridge.geometry.mesh_arrays import read_attribute, read_loop_vertices, read_positions, read_uvs
from farfield.addon.bridge.geometry.mesh_pool import spare_meshes
from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store import curvature
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.viewers import Projection, Viewer
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.bdam.job import ShowJob
from small_terrain_stores import add_texture, build_store, colors, hills

pytest.importorskip("PIL")
pytestmark = pytest.mark.usefixtures("empty_scene")
SIZE = 129


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return add_texture(build_store(tmp_path_factory.mktemp("stores") / "terrain", hills(SIZE, SIZE)), colors(2048))


def viewer_at(x: float, y: float, z: float) -> Viewer:
    """A viewer that looks down."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return Viewer(matrix, Projection("perspective", (-0.5, 0.5, -0.4, 0.4), (640, 512), 1.0, 1e5))


def show(terrain: SceneTerrain, engine: BdamEngine, viewer: Viewer) -> int:
    """Move an engine and show the result, as following does; return the number of meshes that were filled."""
    change = TerrainChange(terrain, engine)
    update = run_to_end(engine.move(viewer))
    count = engine.finished_blocks.qsize()
    while not engine.finished_blocks.empty():
        for _ in change.fill(*engine.finished_blocks.get_nowait()):
            pass
    for _ in change.show(update):
        pass
    bpy.context.view_layer.update()
    return count


def create(folder, viewer=None, **values) -> tuple[SceneTerrain, BdamEngine]:
    engine = BdamEngine(folder, ViewSettings(**{"tolerance": 4.0, **values}))
    terrain = terrain_objects.create_root(bpy.context.scene, str(folder), engine)
    show(terrain, engine, viewer or viewer_at(100.0, 100.0, 600.0))
    return terrain, engine


def world_positions(terrain: SceneTerrain) -> np.ndarray:
    """All vertices (V, 3) of all tiles in world space, float64."""
    return np.concatenate(
        [read_positions(tile.data).astype(np.float64) + np.array(tile.matrix_world.translation) for tile in terrain.tiles().values()]
    )


@pytest.mark.slow
def test_vertices_are_samples_of_the_field_at_their_place(folder):
    heights = hills(SIZE, SIZE)
    for exaggeration in (1.0, 2.5):
        terrain, _ = create(folder, exaggeration=exaggeration)
        positions = world_positions(terrain)
        columns, rows = np.rint(positions[:, 0] / 10.0 + SIZE // 2).astype(int), np.rint(positions[:, 1] / 10.0 + SIZE // 2).astype(int)
        assert np.abs(positions[:, 0] - 10.0 * (columns - SIZE // 2)).max() < 1e-3
        assert np.abs(positions[:, 2] - exaggeration * heights[rows, columns]).max() < 0.012 * exaggeration


@pytest.mark.slow
def test_tiles_meet_exactly(folder):
    terrain, _ = create(folder, tolerance=0.5)
    assert len(terrain.tiles()) > 4
    triangles = 0
    edges = []
    for tile in terrain.tiles().values():
        positions = read_positions(tile.data).astype(np.float64) + np.array(tile.location)
        corners = positions[read_loop_vertices(tile.data)].reshape(-1, 3, 3)
        triangles += len(corners)
        edges += [corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]
    edges = np.concatenate(edges).reshape(-1, 6)
    _, counts = np.unique(np.concatenate([edges, edges[:, [3, 4, 5, 0, 1, 2]]]), axis=0, return_counts=True)
    half = 10.0 * (SIZE // 2)
    is_single = counts == 1
    single = np.unique(np.concatenate([edges, edges[:, [3, 4, 5, 0, 1, 2]]]), axis=0)[is_single].reshape(-1, 2, 3)
    is_outer = (np.abs(single[:, :, 0]) == half).all(axis=1) | (np.abs(single[:, :, 1]) == half).all(axis=1)
    assert counts.max() == 2 and is_outer.all()
    assert triangles == terrain.figures.triangles


def test_a_tile_has_normals_levels_and_a_uv_map_into_its_texture(folder):
    terrain, engine = create(folder)
    store = TerrainStore(folder)
    for tile in terrain.tiles().values():
        mesh = tile.data
        (material,) = mesh.materials
        normals = read_attribute(mesh.attributes["custom_normal"])
        assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5) and (normals[:, 2] > 0.0).all()
        levels = read_attribute(mesh.attributes[LEVEL_ATTRIBUTE])
        assert levels.min() >= 0 and levels.max() <= store.tree.leaf_level
        number = int(material[TEXTURE_KEY].rpartition("#")[2])
        level, (i, j) = int(store.textures.index.levels[number]), store.textures.index.tiles[number].tolist()
        cells = read_positions(mesh)[read_loop_vertices(mesh)][:, :2].astype(np.float64) + np.array(tile.location)[:2]
        cells = cells / 10.0 + SIZE // 2
        expected = (4.0 + 504.0 * (cells * 2.0**level / store.tree.side - [i, j])) / 512.0
        assert np.abs(read_uvs(mesh.uv_layers["UVMap"]) - expected).max() < 1e-5
    assert engine.figures == terrain.figures


def test_textures_are_packed_as_they_are_stored(folder):
    terrain, _ = create(folder)
    store = TerrainStore(folder)
    for tile in terrain.tiles().values():
        material = tile.data.materials[0]
        (node,) = (node for node in material.node_tree.nodes if node.type == "TEX_IMAGE")
        coded = store.textures.read_coded(int(material[TEXTURE_KEY].rpartition("#")[2]))
        assert node.image.packed_file.data == coded.color and tuple(node.image.size) == (512, 512)


def test_alpha_of_a_texture_is_connected(tmp_path):
    image = np.dstack([colors(512), np.full((512, 512), 255, np.uint8)])
    image[100:200, 100:300, 3] = 0
    for image_format in ("jpeg", "raw"):
        folder = add_texture(build_store(tmp_path / image_format, hills(65, 65)), image, image_format)
        terrain, _ = create(folder)
        materials = {tile.data.materials[0] for tile in terrain.tiles().values()}
        groups = [node for material in materials for node in material.node_tree.nodes if node.type == "GROUP"]
        assert any(group.inputs["Alpha"].is_linked for group in groups)
        images = [node.image for material in materials for node in material.node_tree.nodes if node.type == "TEX_IMAGE"]
        assert all(tuple(image.size) == (512, 512) for image in images), "Blender can read them"
        shutil.rmtree(folder)


@pytest.mark.parametrize("shading", ["slope", "height", "level"])
def test_other_shadings_have_one_material_that_keeps_its_changes(folder, shading):
    terrain, engine = create(folder, shading=shading)
    (material,) = {tile.data.materials[0] for tile in terrain.tiles().values()}
    material.name = "Changed by Hand"
    show(terrain, engine, viewer_at(-300.0, 200.0, 300.0))
    assert {tile.data.materials[0].name for tile in terrain.tiles().values()} == {"Changed by Hand"}
    assert not bpy.data.images


def test_a_move_fills_only_changed_tiles_and_reuses_meshes(folder):
    terrain, engine = create(folder)
    assert show(terrain, engine, viewer_at(100.0, 100.0, 600.0)) == 0
    for step in range(12):
        show(terrain, engine, viewer_at(100.0 - 50.0 * step, 100.0 + 20.0 * step, 500.0))
    assert len(bpy.data.meshes) <= 2 * 64
    unused = [item for item in bpy.data.materials if TEXTURE_KEY in item and not item.users]
    assert len(unused) <= 64
    remove_unused(0, 1000)
    assert {item.name for item in bpy.data.images} == {
        node.image.name for tile in terrain.tiles().values() for node in tile.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE"
    }


def test_materials_with_damaged_properties_can_be_removed(folder):
    create(folder)
    for value in (float("inf"), "text", [1.0, 2.0], -1, 2**31 - 1, None):
        material = bpy.data.materials.new("Unused")
        material[TEXTURE_KEY] = "tile"
        if value is not None:
            material[USED_KEY] = value
    mark_used([bpy.data.materials["Unused"]])
    assert 0 < bpy.data.materials["Unused"][USED_KEY] < 2**31 - 1
    remove_unused(0, 1000)
    assert not [item for item in bpy.data.materials if item.name.startswith("Unused")]


def test_a_rotated_and_scaled_root_is_the_same_view(folder):
    terrain, engine = create(folder)
    matrix = mathutils.Matrix.LocRotScale((500.0, -20.0, 7.0), mathutils.Euler((0.3, 0.5, 1.0)), (2.0, 0.5, 3.0))
    viewer = viewer_at(100.0, 100.0, 600.0)
    expected = terrain.tiles().keys(), terrain.figures.triangles
    terrain.root.matrix_world = matrix
    bpy.context.view_layer.update()
    moved = viewer.transform(np.array(matrix))
    assert np.allclose(terrain.to_terrain_space(moved).matrix, viewer.matrix, atol=1e-3)
    show(terrain, engine, terrain.to_terrain_space(moved))
    assert (terrain.tiles().keys(), terrain.figures.triangles) == expected


def test_deleted_tiles_come_back(folder):
    terrain, engine = create(folder)
    expected = set(terrain.tiles())
    bpy.data.objects.remove(next(iter(terrain.tiles().values())))
    show(terrain, engine, viewer_at(100.0, 100.0, 600.0))
    show(terrain, engine, viewer_at(100.0, 100.0, 600.0))
    assert set(terrain.tiles()) == expected


def test_several_terrains_have_their_own_tiles_and_materials_of_shadings(folder):
    (first, _), (second, _) = create(folder, shading="height"), create(folder, shading="height")
    assert first.name != second.name and first.tiles().keys() == second.tiles().keys()
    assert not {tile.name for tile in first.tiles().values()} & {tile.name for tile in second.tiles().values()}
    materials = [{tile.data.materials[0].name for tile in terrain.tiles().values()} for terrain in (first, second)]
    assert materials == [{"Large Terrain Height"}, {"Large Terrain.001 Height"}]
    terrain_objects.remove(first)
    assert len(SceneTerrain.in_scene(bpy.context.scene)) == 1 and len(second.tiles()) == second.figures.tiles


def test_removing_a_terrain_leaves_nothing(folder):
    terrain, engine = create(folder)
    engine.settings = ViewSettings(shading="level")
    show(terrain, engine, viewer_at(0.0, 0.0, 500.0))
    terrain_objects.remove(terrain)
    assert not bpy.data.objects and not bpy.data.images and not bpy.data.materials and not bpy.data.collections
    assert not [mesh for mesh in bpy.data.meshes if mesh.users]


def test_undo_before_tiles_are_shown_leaves_nothing_behind(folder):
    job = ShowJob(BdamEngine(folder, ViewSettings(tolerance=4.0)), viewer_at(100.0, 100.0, 600.0), str(folder))
    steps = job.scene_steps(run_to_end(job.core_steps()))
    next(step for step in steps if step.label == "Showing meshes")
    bpy.data.batch_remove(spare_meshes(terrain_objects.POOL))  # as before undo
    with pytest.raises(GeometryError, match="Undo has removed"):
        next(steps)
    assert not bpy.data.objects and job.terrain is None


def test_curvature_lowers_the_ground_and_keeps_its_colors(folder, monkeypatch):
    """Materials by height add what curvature has taken away; without it, terrains have other materials."""
    monkeypatch.setattr(curvature, "EARTH_RADIUS", 4000.0)
    monkeypatch.setattr(materials, "EARTH_RADIUS", 4000.0)
    flat, _ = create(folder, shading="height")
    curved, engine = create(folder, shading="height", curvature=True, exaggeration=2.0)
    heights = hills(SIZE, SIZE)
    positions = world_positions(curved)
    columns, rows = (np.rint(positions[:, axis] / 10.0 + SIZE // 2).astype(int) for axis in range(2))
    drop = (positions[:, :2] ** 2).sum(axis=1) / 8000.0
    assert np.abs(positions[:, 2] - 2.0 * (heights[rows, columns] - drop)).max() < 0.03 and drop.max() > 90.0
    shown = [next(iter(terrain.tiles().values())).data.materials[0] for terrain in (flat, curved)]
    labels = [{node.label: node for node in materials.find_surface(material).nodes} for material in shown]
    assert "Curvature" not in labels[0]
    product = labels[1]["Curvature"].outputs["Value"].links[0].to_node
    assert product.inputs[1].default_value == pytest.approx(2.0 / 8000.0)
    engine.settings = replace(engine.settings, shading="level")
    assert curved.ensure_material("level", engine) != shown[1]
