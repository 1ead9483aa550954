"""Frozen terrain: ordinary objects with the same triangles and colors, in the same place, fine enough for a whole camera path."""

import shutil

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.bdam.freezing import PROPERTY_PREFIX
from farfield.addon.bridge.bdam.materials import TEXTURE_KEY
from farfield.addon.bridge.bdam.objects import SceneTerrain
from farfield.addon.bridge.geometry.mesh_arrays import read_loop_vertices, read_positions
from farfield.addon.bridge.viewers import camera_viewer
from farfield.addon.core.bdam.settings import FreezeSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.extraction import CutSettings, extract_union_cut
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators import follow_handlers
from farfield.addon.operators.bdam.freeze import FreezePathJob
from small_terrain_stores import CELL_SIZE, add_texture, build_store, colors, hills
from watertight import open_edges

pytest.importorskip("PIL")
pytestmark = pytest.mark.usefixtures("empty_scene")
SIZE = 129
EXTENT = 0.5 * CELL_SIZE * (SIZE - 1)
FRAMES = range(1, 6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return add_texture(build_store(tmp_path_factory.mktemp("stores") / "terrain", hills(SIZE, SIZE)), colors(2048))


@pytest.fixture
def camera():
    """A camera that flies over the terrain in FRAMES and looks down."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = FRAMES[0], FRAMES[-1]
    for frame in FRAMES:
        camera.location = (-400.0 + 150.0 * frame, 200.0 - 100.0 * frame, 350.0)
        camera.keyframe_insert("location", frame=frame)
    camera.data.clip_end = 1e5
    scene.frame_set(2)
    return camera


def load(folder, **values) -> SceneTerrain:
    values = {"tolerance": 4.0, "shading": "slope", "use_relative_path": False, **values}
    assert bpy.ops.farfield.bdam_load(directory=str(folder), **values) == {"FINISHED"}
    (terrain,) = SceneTerrain.in_scene(bpy.context.scene)
    return terrain


def geometry(objects) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) in world space and triangles (T, 3) of several objects, not welded."""
    bpy.context.view_layer.update()
    vertices, triangles, count = [], [], 0
    for item in objects:
        matrix, positions = np.array(item.matrix_world, np.float64), read_positions(item.data).astype(np.float64)
        vertices.append(positions @ matrix[:3, :3].T + matrix[:3, 3])
        triangles.append(read_loop_vertices(item.data).reshape(-1, 3) + count)
        count += len(positions)
    return np.concatenate(vertices), np.concatenate(triangles)


def centroids(objects) -> np.ndarray:
    vertices, triangles = geometry(objects)
    found = vertices[triangles].mean(axis=1)
    return found[np.lexsort(np.round(found, 2).T)]


def frozen() -> list[bpy.types.Object]:
    return list(bpy.data.collections["Frozen Terrain"].objects)


def assert_independent(objects) -> None:
    """Nothing of Farfield is in objects, their data and their materials."""
    for item in objects:
        materials = [material for material in item.data.materials if material is not None]
        assert item.parent is None and materials
        assert not [key for block in (item, item.data, *materials) for key in block.keys() if key.startswith(PROPERTY_PREFIX)]  # noqa: SIM118
        assert not [node for material in materials for node in material.node_tree.nodes if getattr(node, "object", None) is not None]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shading", "joined"),
    [
        *(("texture", False), ("slope", True)),
        *(
            pytest.param(*values, marks=pytest.mark.exhaustive)
            for values in (("texture", True), ("slope", False), ("height", True), ("height", False), ("level", False))
        ),
    ],
)
def test_frozen_objects_have_the_triangles_and_materials_of_the_terrain(folder, camera, joined, shading):
    terrain = load(folder, shading=shading, exaggeration=2.0)
    terrain.root.matrix_world = mathutils.Matrix.LocRotScale((5.0, 6.0, 7.0), mathutils.Euler((0.0, 0.0, 0.7)), (2.0, 2.0, 1.0))
    tiles = list(terrain.tiles().values())
    expected, count, images = centroids(tiles), len(tiles), {node.image for node in image_nodes(tiles)}
    assert bpy.ops.farfield.bdam_freeze(joined=joined, keep_terrain=True) == {"FINISHED"}
    objects = frozen()
    assert len(objects) == (1 if joined else count) and terrain.root is not None and len(terrain.tiles()) == count
    assert np.allclose(centroids(objects), expected, atol=0.02)
    assert_independent(objects)
    assert all(item.shadow_terminator_geometry_offset == 1.0 for item in (*tiles, *objects)), "no dark notches under a low light"
    assert {node.image for node in image_nodes(objects)} == images and bool(images) == (shading == "texture")
    assert all(not item.data.validate() for item in objects)
    if shading == "texture":
        assert all(item.data.uv_layers for item in objects)


def image_nodes(objects) -> list[bpy.types.ShaderNodeTexImage]:
    materials = {material for item in objects for material in item.data.materials}
    return [node for material in materials for node in material.node_tree.nodes if node.type == "TEX_IMAGE"]


@pytest.mark.slow
def test_the_terrain_is_removed_unless_kept_and_images_stay(folder, camera):
    terrain = load(folder, shading="texture")
    assert bpy.ops.farfield.bdam_freeze() == {"FINISHED"}
    assert terrain.root is None and not SceneTerrain.in_scene(bpy.context.scene)
    nodes = image_nodes(frozen())
    assert nodes and all(node.image is not None and node.image.packed_file is not None for node in nodes)
    assert not [material for material in bpy.data.materials if TEXTURE_KEY in material and material.users]


@pytest.mark.slow
@pytest.mark.parametrize("shading", ["texture", "slope"])
def test_a_camera_path_is_frozen_within_the_tolerance_in_every_frame(folder, camera, shading):
    terrain = load(folder, shading=shading, tolerance=2.0)
    terrain.root.location = (30.0, -20.0, 10.0)
    bpy.context.view_layer.update()
    assert bpy.ops.farfield.bdam_freeze_path(joined=True, keep_terrain=True) == {"FINISHED"}
    (item,) = frozen()
    assert_independent([item])
    viewers = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        viewers.append(terrain.to_terrain_space(camera_viewer(bpy.context.scene, camera)))
    with TerrainStore(folder) as store:
        cut = run_to_end(extract_union_cut(store, viewers, CutSettings(2.0)))
        count = sum(int(store.levels[level].counts[row, 1]) for level, row in zip(cut.levels, cut.rows, strict=True))
    assert len(item.data.polygons) == count if shading == "slope" else len(item.data.polygons) >= count
    vertices, triangles = geometry([item])
    edges, local = open_edges(triangles), (vertices[:, :2] - [30.0, -20.0]) / EXTENT
    on_border = [(np.abs(np.abs(axis[edges]) - 1.0) < 1e-5).all(axis=1) for axis in local.T]
    assert len(edges) and (on_border[0] | on_border[1]).all()


def test_a_camera_path_over_a_damaged_store_is_frozen_without_holes(folder, camera, tmp_path, capsys):
    copy = shutil.copytree(folder, tmp_path / "terrain")
    for path in (copy / "geometry.bdam", copy / "textures" / "textures.tiles"):
        content = bytearray(path.read_bytes())
        for position in range(len(content) // 3, len(content) * 9 // 10, len(content) // 10):
            content[position] ^= 1
        path.write_bytes(content)
    load(copy, shading="texture")
    assert bpy.ops.farfield.bdam_freeze_path(joined=True) == {"FINISHED"}
    assert "is damaged" in capsys.readouterr().out
    vertices, triangles = geometry(frozen())
    edges, local = open_edges(triangles), vertices[:, :2] / EXTENT
    on_border = [(np.abs(np.abs(axis[edges]) - 1.0) < 1e-5).all(axis=1) for axis in local.T]
    assert len(edges) and (on_border[0] | on_border[1]).all()


def test_the_frame_and_followers_are_restored(folder, camera):
    terrain = load(folder)
    setattr(terrain.root, follow_handlers.camera_property("bdam"), True)
    bpy.context.scene.frame_set(3, subframe=0.25)
    before = {name: len(item.data.polygons) for name, item in terrain.tiles().items()}
    assert bpy.ops.farfield.bdam_freeze_path(keep_terrain=True) == {"FINISHED"}
    assert bpy.context.scene.frame_current == 3 and bpy.context.scene.frame_subframe == pytest.approx(0.25)
    assert follow_handlers.follows_camera(terrain)
    assert {name: len(item.data.polygons) for name, item in terrain.tiles().items()} == before


def test_cancelling_changes_nothing(folder, camera):
    terrain = load(folder)
    counts = [len(items) for items in (bpy.data.objects, bpy.data.meshes, bpy.data.materials)]
    job = FreezePathJob(terrain, folder, terrain.settings, FreezeSettings(), list(FRAMES))
    steps = job.scene_steps(run_to_end(job.core_steps()))
    labels = set()
    for step in steps:
        labels.add(step.label)
        if step.label == "Reading patches":
            break
    steps.close()
    assert labels == {"Reading the camera", "Choosing patches", "Measuring errors", "Reading patches"}
    assert bpy.context.scene.frame_current == 2 and terrain.root is not None
    assert [len(items) for items in (bpy.data.objects, bpy.data.meshes, bpy.data.materials)] == counts


def test_frames_can_be_chosen(folder, camera, capsys):
    load(folder)
    assert bpy.ops.farfield.bdam_freeze_path(scene_frame_range=False, first_frame=1, last_frame=4, frame_step=2, keep_terrain=True) == {
        "FINISHED"
    }
    assert "Good for 3 frames." in capsys.readouterr().out  # 1, 3 and the last one
    with pytest.raises(RuntimeError, match="Last Frame, 1, is before First Frame, 4"):
        bpy.ops.farfield.bdam_freeze_path(scene_frame_range=False, first_frame=4, last_frame=1)


def test_bad_input_is_explained(folder, camera):
    with pytest.raises(RuntimeError, match="Select a large terrain"):
        bpy.ops.farfield.bdam_freeze()
    terrain = load(folder)
    bpy.context.scene.camera = None
    with pytest.raises(RuntimeError, match="needs an active camera"):
        bpy.ops.farfield.bdam_freeze_path()
    bpy.data.batch_remove(list(terrain.tiles().values()))
    with pytest.raises(RuntimeError, match="shows nothing; press Update"):
        bpy.ops.farfield.bdam_freeze()


def test_freezing_can_be_undone(folder, camera):
    terrain = load(folder)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.farfield.bdam_freeze() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert terrain.root is not None and terrain.tiles() and "Frozen Terrain" not in bpy.data.collections
