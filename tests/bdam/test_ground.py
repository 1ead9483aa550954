"""Objects, vertices and points that are put on large terrain: exactly on the ground, whatever their parents and the root's transforms."""

import re
import shutil

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.bdam.objects import STORE_KEY, SceneTerrain
from farfield.addon.bridge.geometry.mesh_arrays import read_positions
from farfield.addon.bridge.placing import find_base
from farfield.addon.core.bdam.ground.heights import HeightQuery
from farfield.addon.core.bdam.store.terrain_store import GEOMETRY_FILE, GEOMETRY_KIND, TerrainStore
from farfield.addon.core.files.blocks import HEADER_SIZE, BlockReader
from small_terrain_stores import build_store, hills

pytest.importorskip("zstandard")
pytestmark = pytest.mark.usefixtures("empty_scene")
SIZE, EXAGGERATION = 97, 2.0
HOLE = 20, 70  # sample in the middle of a hole, x and y
TOLERANCE = 2e-3  # meters: single precision at a distance of a kilometer, through several matrices


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    heights = hills(SIZE, SIZE)
    heights[HOLE[1] - 5 : HOLE[1] + 6, HOLE[0] - 5 : HOLE[0] + 6] = np.nan
    return build_store(tmp_path_factory.mktemp("stores") / "terrain", heights)


@pytest.fixture
def terrain(folder):
    return load(folder)


def load(folder) -> SceneTerrain:
    before = set(SceneTerrain.in_scene(bpy.context.scene))
    values = {"tolerance": 3.0, "shading": "slope", "exaggeration": EXAGGERATION, "use_relative_path": False}
    assert bpy.ops.farfield.bdam_load(directory=str(folder), **values) == {"FINISHED"}
    (terrain,) = set(SceneTerrain.in_scene(bpy.context.scene)) - before
    return terrain


def transform_root(terrain: SceneTerrain) -> mathutils.Matrix:
    """Move, rotate and scale a terrain; return the matrix of its root."""
    terrain.root.matrix_world = mathutils.Matrix.LocRotScale((40.0, -70.0, 25.0), mathutils.Euler((0.3, -0.2, 0.8)), (0.5, 0.5, 0.75))
    bpy.context.view_layer.update()
    return terrain.root.matrix_world.copy()


def add_cube(location=(0.0, 0.0, 0.0), parent=None, size=2.0) -> bpy.types.Object:
    """A cube whose origin is at a corner, in world space."""
    mesh = bpy.data.meshes.new("Cube")
    corners = [(x, y, z) for x in (0.0, size) for y in (0.0, size) for z in (-size, 0.0)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return add(bpy.data.objects.new("Cube", mesh), location, parent)


def add(item: bpy.types.Object, location=(0.0, 0.0, 0.0), parent=None) -> bpy.types.Object:
    bpy.context.scene.collection.objects.link(item)
    item.parent = parent
    bpy.context.view_layer.update()
    matrix = item.matrix_world.copy()
    matrix.translation = location
    item.matrix_world = matrix
    bpy.context.view_layer.update()
    return item


def select(*items: bpy.types.Object) -> None:
    bpy.ops.object.select_all(action="DESELECT")
    for item in items:
        item.select_set(True)


def drop(*items: bpy.types.Object, **values) -> str:
    """Put selected objects on the ground and return the message."""
    select(*items)
    result = bpy.ops.farfield.bdam_drop(**values)
    bpy.context.view_layer.update()
    assert result == {"FINISHED"}
    return result


def ground_below(terrain: SceneTerrain, folder, points) -> tuple[np.ndarray, np.ndarray]:
    """The ground (N, 3) in world space along the Z axis of the root, and normals, computed directly."""
    points, matrix = np.atleast_2d(points), np.array(terrain.root.matrix_world, np.float64)
    local = (points - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T + terrain.origin
    with TerrainStore(folder) as store:
        heights, normals = HeightQuery(store).find(local[:, :2])
    local[:, 2] = EXAGGERATION * heights
    normals = normals / [1.0, 1.0, EXAGGERATION] @ np.linalg.inv(matrix[:3, :3])
    return (local - terrain.origin) @ matrix[:3, :3].T + matrix[:3, 3], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def position(item) -> np.ndarray:
    return np.array(item.matrix_world.translation, np.float64)


@pytest.mark.parametrize("is_transformed", [False, True])
def test_origins_are_on_the_ground_along_the_axis_of_the_root(terrain, folder, is_transformed):
    if is_transformed:
        transform_root(terrain)
    items = [add_cube((30.0 * index, 30.0 - 20.0 * index, 300.0 - 150.0 * index)) for index in range(4)]
    starts = np.array([position(item) for item in items])
    bases = np.array([np.array(item.matrix_basis.to_3x3()) for item in items])
    drop(*items)
    expected, _ = ground_below(terrain, folder, starts)
    assert np.allclose([position(item) for item in items], expected, atol=TOLERANCE)
    assert np.array_equal([np.array(item.matrix_basis.to_3x3()) for item in items], bases)


def test_bottoms_of_bounding_boxes_are_on_the_ground(terrain, folder):
    item = add_cube((100.0, 50.0, 500.0), size=8.0)
    item.rotation_euler = (0.4, 0.2, 0.1)
    bpy.context.view_layer.update()
    up = np.array([0.0, 0.0, 1.0])
    base = find_base(item, np.array(item.matrix_world), up, True)
    drop(item, target="bottoms", offset=0.5)
    corners = np.array([item.matrix_world @ mathutils.Vector(corner) for corner in item.bound_box])
    expected, _ = ground_below(terrain, folder, base)
    assert corners[:, 2].min() == pytest.approx(expected[0, 2] + 0.5, abs=TOLERANCE)
    assert np.allclose(corners.mean(axis=0)[:2], base[:2], atol=TOLERANCE)


@pytest.mark.parametrize("target", ["origins", "bottoms"])
def test_objects_are_aligned_to_the_normal_and_stay_if_repeated(terrain, folder, target):
    transform_root(terrain)
    item = add_cube((80.0, 20.0, 400.0))
    item.scale = (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    up = np.array(terrain.root.matrix_world)[:3, 2]
    up /= np.linalg.norm(up)
    base = find_base(item, np.array(item.matrix_world), up, target == "bottoms")
    expected, normals = ground_below(terrain, folder, base)
    drop(item, target=target, align_to_normal=True)
    matrix = np.array(item.matrix_world)
    assert np.allclose(matrix[:3, 2] / np.linalg.norm(matrix[:3, 2]), normals[0], atol=1e-5)
    assert np.allclose(find_base(item, matrix, normals[0], target == "bottoms"), expected[0], atol=TOLERANCE)
    assert np.allclose(np.linalg.norm(matrix[:3, :3], axis=0), [1.0, 2.0, 3.0], atol=1e-4)
    if target == "origins":
        drop(item, target=target, align_to_normal=True)
        assert np.allclose(np.array(item.matrix_world), matrix, atol=TOLERANCE)


def test_children_and_parents_are_each_put_on_their_own_ground(terrain, folder):
    empty = add(bpy.data.objects.new("Empty", None), (-100.0, -60.0, 300.0))
    empty.rotation_euler, empty.scale = (0.0, 0.5, 1.0), (2.0, 1.0, 3.0)
    bpy.context.view_layer.update()
    child = add_cube((60.0, 90.0, 10.0), empty)
    grandchild = add_cube((-30.0, 120.0, 800.0), child)
    items = [grandchild, empty, child]
    starts = np.array([position(item) for item in items])
    drop(*items)
    assert np.allclose([position(item) for item in items], ground_below(terrain, folder, starts)[0], atol=TOLERANCE)


def test_an_object_below_the_root_of_the_terrain_can_be_put_on_it(terrain, folder):
    transform_root(terrain)
    item = add_cube((40.0, -60.0, 200.0), terrain.root)
    expected, _ = ground_below(terrain, folder, position(item))
    drop(item, *terrain.tiles().values(), terrain.root)
    assert np.allclose(position(item), expected[0], atol=TOLERANCE)
    assert position(terrain.root)[0] == pytest.approx(40.0)


def test_objects_outside_and_over_holes_stay(terrain, capsys):
    inside, outside = add_cube((0.0, 0.0, 50.0)), add_cube((1e5, 0.0, 50.0))
    hole = add_cube((10.0 * (HOLE[0] - SIZE // 2), 10.0 * (HOLE[1] - SIZE // 2), 50.0))
    drop(inside, outside, hole)
    assert "Put 1 object on the ground. Skipped 2 objects: outside of the terrain or over holes." in capsys.readouterr().out
    assert position(outside).tolist() == [1e5, 0.0, 50.0] and position(hole)[2] == 50.0
    select(outside)
    with pytest.raises(RuntimeError, match="above or below"):
        bpy.ops.farfield.bdam_drop()


def test_coarser_patches_are_used_instead_of_damaged_ones_and_reported(folder, tmp_path, capsys):
    copy = shutil.copytree(folder, tmp_path / "damaged")
    with BlockReader(copy / GEOMETRY_FILE, GEOMETRY_KIND) as reader:
        ends = HEADER_SIZE + np.cumsum(reader.sizes)
    with TerrainStore(folder) as store:
        leaves = slice(int(store.links.starts[-2]), None)
        coarse = store.levels[-2].errors.max()
    terrain = load(copy)
    content = bytearray((copy / GEOMETRY_FILE).read_bytes())
    for end in ends[leaves].tolist():
        content[end - 1] ^= 1
    (copy / GEOMETRY_FILE).write_bytes(content)
    item = add_cube((10.0, 30.0, 0.0))  # at a sample, where errors are measured
    expected, _ = ground_below(terrain, folder, position(item))
    drop(item)
    assert abs(position(item)[2] - expected[0, 2]) <= EXAGGERATION * coarse + TOLERANCE
    assert re.search(r"Put 1 object on the ground. Used coarser patches in 1 damaged place. The patch \d+/\d+ in", capsys.readouterr().out)


def test_locked_objects_are_counted(terrain, capsys):
    item = add_cube((0.0, 0.0, 5000.0))
    constraint = item.constraints.new("LIMIT_LOCATION")
    constraint.use_min_z, constraint.min_z = True, 4000.0
    drop(item)
    assert "Put 0 objects" in capsys.readouterr().out


def test_what_is_shown_may_be_the_ground(terrain):
    item = add_cube((33.0, 77.0, 500.0))
    drop(item, surface="shown")
    hits = []
    for tile in terrain.tiles().values():
        origin = tile.matrix_world.inverted() @ mathutils.Vector((33.0, 77.0, 5000.0))
        is_hit, location, *_ = tile.ray_cast(origin, mathutils.Vector((0.0, 0.0, -1.0)))
        hits += [tile.matrix_world @ location] if is_hit else []
    assert hits and position(item)[2] == pytest.approx(hits[0].z, abs=TOLERANCE)
    before = position(item)[2]
    drop(item, surface="finest")
    assert 0.0 < abs(position(item)[2] - before) < 30.0


def test_vertices_are_put_on_the_ground(terrain, folder):
    transform_root(terrain)
    mesh = bpy.data.meshes.new("Path")
    random = np.random.default_rng(2)
    mesh.from_pydata(np.append(random.uniform(-100.0, 100.0, (50, 3)), [[1e5, 0.0, 0.0]], axis=0).tolist(), [], [])
    item = add(bpy.data.objects.new("Path", mesh), (30.0, -60.0, 10.0))
    item.rotation_euler = (0.1, 0.2, 0.3)
    bpy.context.view_layer.update()
    matrix, before = np.array(item.matrix_world), read_positions(mesh)
    drop(item, target="points", offset=1.0)
    assert np.array_equal(np.array(item.matrix_world), matrix) and np.array_equal(read_positions(mesh)[-1], before[-1])
    up = np.array(terrain.root.matrix_world)[:3, 2]
    expected, _ = ground_below(terrain, folder, before.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3])
    found = read_positions(mesh) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.allclose(found[:-1], expected[:-1] + up / np.linalg.norm(up), atol=TOLERANCE)


def test_point_clouds_are_put_on_the_ground(terrain, folder):
    points = np.random.default_rng(4).uniform(-200.0, 200.0, (20, 3)).astype(np.float32)
    mesh = bpy.data.meshes.new("Cloud")
    mesh.from_pydata(points.tolist(), [], [])
    item = add(bpy.data.objects.new("Cloud", mesh))
    bpy.context.view_layer.objects.active = item
    select(item)
    assert bpy.ops.object.convert(target="POINTCLOUD") == {"FINISHED"}
    (item,) = bpy.context.selected_objects
    assert item.type == "POINTCLOUD"
    drop(item, target="points")
    found = np.empty(60, np.float32)
    item.data.attributes["position"].data.foreach_get("vector", found)
    assert np.allclose(found.reshape(-1, 3), ground_below(terrain, folder, points)[0], atol=TOLERANCE)


def test_data_that_cannot_be_moved_is_named(terrain, capsys):
    mesh_object, empty = add_cube(), add(bpy.data.objects.new("Empty", None))
    twin, keyed = add(bpy.data.objects.new("Twin", mesh_object.data)), add_cube()
    keyed.shape_key_add(name="Basis")
    with pytest.raises(RuntimeError, match=r"neither mesh nor point cloud.*Select meshes"):
        drop(empty, target="points")
    with pytest.raises(RuntimeError, match=r"Skipped 2 objects: data that other objects share\. Skipped 1 object: shape keys\."):
        drop(mesh_object, twin, keyed, target="points")
    drop(mesh_object, twin, keyed, empty)


def test_it_can_be_undone(terrain):
    item = add_cube((10.0, 20.0, 700.0))
    name = item.name
    bpy.ops.ed.undo_push(message="before")
    drop(item)
    bpy.ops.ed.undo_push(message="after")
    assert position(bpy.data.objects[name])[2] != 700.0
    bpy.ops.ed.undo()
    assert position(bpy.data.objects[name])[2] == 700.0


def test_bad_input_is_explained(folder, tmp_path):
    item = add_cube()
    select(item)
    with pytest.raises(RuntimeError, match="Add a large terrain first"):
        bpy.ops.farfield.bdam_drop()
    copy = shutil.copytree(folder, tmp_path / "moved")
    terrain = load(copy)
    bpy.ops.object.select_all(action="DESELECT")
    with pytest.raises(RuntimeError, match="Select the objects"):
        bpy.ops.farfield.bdam_drop()
    with pytest.raises(RuntimeError, match="Nothing else than the terrain is selected"):
        drop(terrain.root)
    for scale in (0.0, np.inf, np.nan):
        terrain.root.scale = (1.0, 1.0, scale)
        with pytest.raises(RuntimeError, match="scale of zero, or a transform that is not finite"):
            drop(item)
    terrain.root.scale = (1.0, 1.0, 1.0)
    terrain.root[STORE_KEY] = str(tmp_path / "missing")
    with pytest.raises(RuntimeError, match="missing"):
        drop(item)
    drop(item, surface="shown")


def test_of_several_terrains_the_selected_one_is_used(terrain, folder):
    other = load(folder)
    other.root.location.z = 1000.0
    bpy.context.view_layer.update()
    item = add_cube((12.0, 34.0, 0.0))
    with pytest.raises(RuntimeError, match="2 terrains"):
        drop(item)
    expected, _ = ground_below(other, folder, position(item))
    drop(item, other.root)
    assert np.allclose(position(item), expected[0], atol=TOLERANCE)
