"""Operators of large terrain: load, update, follow, remove; undo, linked files, moved stores, paths."""

import shutil
import time
from dataclasses import replace

import bpy
import pytest

from farfield.addon.bridge.bdam.objects import STORE_KEY, SceneTerrain
from farfield.addon.core.bdam.store.structure import read_structure, write_structure
from farfield.addon.operators import follow_handlers, following, view_following
from farfield.addon.operators.bdam.operators import TOOL
from farfield.addon.operators.engine_cache import cache
from farfield.addon.operators.results import read_result
from small_terrain_stores import build_store, hills

pytestmark = pytest.mark.usefixtures("empty_scene")
LABEL = "Größe 山"  # not ASCII


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return build_store(tmp_path_factory.mktemp(LABEL) / "terrain", hills())


@pytest.fixture
def folder(original, tmp_path):
    """A copy of the store that may be moved."""
    return shutil.copytree(original, tmp_path / LABEL / "terrain")


@pytest.fixture
def camera():
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.0, -200.0, 300.0)
    camera.rotation_euler = (0.6, 0.0, 0.0)
    camera.data.clip_end = 1e5
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    bpy.context.view_layer.update()
    yield camera
    view_following.current.stop()


def load(folder, **values) -> SceneTerrain:
    before = {terrain.name for terrain in SceneTerrain.in_scene(bpy.context.scene)}
    assert bpy.ops.farfield.bdam_load(directory=str(folder), **{"tolerance": 4.0, "shading": "slope", **values}) == {"FINISHED"}
    (terrain,) = (terrain for terrain in SceneTerrain.in_scene(bpy.context.scene) if terrain.name not in before)
    return terrain


def signature(terrain: SceneTerrain) -> dict[str, int]:
    """The tiles and their numbers of triangles."""
    return {name: len(tile.data.polygons) for name, tile in terrain.tiles().items()}


def test_load_uses_the_backup_of_a_damaged_file_and_says_so(folder, camera):
    expected = signature(load(folder))
    for name in ("structure.bdam", "geometry.bdam"):
        content = bytearray((folder / name).read_bytes())
        content[-5] ^= 1
        (folder / name).write_bytes(content)
    terrain = load(folder)
    assert signature(terrain) == expected and len(terrain.warnings) == 2
    assert "structure.bdam" in terrain.warnings[0] and "geometry.bdam" in terrain.warnings[1]


def test_load_shows_the_terrain_as_the_camera_needs_it(folder, camera):
    terrain = load(folder)
    assert bpy.context.active_object == terrain.root and terrain.root[STORE_KEY] == str(folder)
    assert sum(signature(terrain).values()) == terrain.figures.triangles
    assert terrain.settings.tolerance == 4.0 and terrain.settings.shading == "slope"
    coarse = load(folder, tolerance=50.0)
    assert coarse.figures.triangles < terrain.figures.triangles


def test_the_store_of_the_panel_is_that_of_the_terrain(folder, camera):
    root = load(folder).root
    assert root.farfield_bdam_store_path == str(folder)
    root.farfield_bdam_store_path = "//terrain"
    assert root[STORE_KEY] == "//terrain" == root.farfield_bdam_store_path
    assert bpy.data.objects.new("Other", None).farfield_bdam_store_path == ""


def test_update_takes_the_settings_of_the_panel_and_the_current_view(folder, camera):
    terrain = load(folder)
    before = signature(terrain)
    bpy.context.scene.farfield_bdam_view.tolerance = 20.0
    bpy.context.scene.farfield_bdam_view.exaggeration = 2.0
    assert bpy.ops.farfield.bdam_update() == {"FINISHED"}
    assert signature(terrain) != before and terrain.settings.tolerance == 20.0 and terrain.settings.exaggeration == 2.0
    camera.location.z = 3000.0
    bpy.context.view_layer.update()
    far = terrain.figures.triangles
    bpy.ops.farfield.bdam_update()
    assert terrain.figures.triangles < far


def test_a_triangle_budget_is_kept_and_the_message_names_the_tolerance(folder, camera):
    terrain = load(folder, tolerance=0.1, triangle_budget=6000)
    assert terrain.figures.triangles <= 6000 and terrain.figures.tolerance > 0.1
    sentence = f"Triangle Budget 6,000 raises the tolerance to {terrain.figures.tolerance:.2f} pixels."
    assert sentence in read_result(bpy.context.scene, "bdam")
    assert terrain.figures.describe_budget() == sentence
    bpy.ops.farfield.bdam_update(tolerance=0.1, triangle_budget=0)
    assert terrain.figures.triangles > 6000 and terrain.figures.describe_budget() == ""
    assert not any("Triangle Budget" in sentence for sentence in read_result(bpy.context.scene, "bdam"))


def test_undo_restores_what_was_shown(folder, camera):
    bpy.ops.ed.undo_push(message="Start")
    terrain = load(folder)
    expected = signature(terrain)
    bpy.ops.ed.undo_push(message="Load")
    bpy.ops.farfield.bdam_update(tolerance=40.0)
    bpy.ops.ed.undo_push(message="Update")
    bpy.ops.ed.undo()
    (terrain,) = SceneTerrain.in_scene(bpy.context.scene)
    assert signature(terrain) == expected and terrain.settings.tolerance == 4.0
    following.recenter(terrain, TOOL.to_terrain(terrain, view_following.view_of_area(bpy.context.scene, None)))
    assert signature(terrain) == expected
    bpy.ops.ed.undo()
    assert SceneTerrain.in_scene(bpy.context.scene) == []


def test_undo_after_moves_refers_to_no_data_that_was_freed(folder, camera):
    load(folder)
    bpy.ops.ed.undo_push(message="Load")
    bpy.ops.ed.undo_push(message="Nothing")
    (terrain,) = SceneTerrain.in_scene(bpy.context.scene)
    expected = signature(terrain)
    for height in (3000.0, 100.0, 1500.0):  # moves that undo knows nothing of create and remove objects
        camera.location.z = height
        bpy.context.view_layer.update()
        following.recenter(terrain, TOOL.to_terrain(terrain, view_following.view_of_area(bpy.context.scene, None)))
    assert signature(terrain) != expected
    bpy.ops.ed.undo()
    meshes, objects = set(bpy.data.meshes), set(bpy.data.objects)
    (terrain,) = SceneTerrain.in_scene(bpy.context.scene)
    assert signature(terrain) == expected
    collection = terrain.root.users_collection[0]
    assert set(collection.objects) == {terrain.root, *terrain.tiles().values()} <= objects
    assert {tile.data for tile in terrain.tiles().values()} <= meshes


def test_the_terrain_follows_the_camera_in_every_frame(folder, camera):
    terrain = load(folder)
    for frame, height in ((1, 300.0), (10, 4000.0)):
        camera.location.z = height
        camera.keyframe_insert("location", frame=frame)
    setattr(terrain.root, follow_handlers.camera_property("bdam"), True)
    triangles = []
    for frame in (1, 5, 10, 1):
        bpy.context.scene.frame_set(frame)
        triangles.append(terrain.figures.triangles)
    assert triangles[0] > triangles[1] > triangles[2] and triangles[3] == triangles[0]
    assert bpy.context.scene.render.use_lock_interface


@pytest.mark.parametrize("kind", ["leaf_cells of 0", "a path that is too long", "nothing there"])
def test_a_terrain_of_a_stranger_costs_one_sentence_per_file_when_the_frame_changes(folder, camera, kind, capfd):
    terrain = load(folder)
    expected = signature(terrain)
    setattr(terrain.root, follow_handlers.camera_property("bdam"), True)
    cache.clear()
    if kind == "leaf_cells of 0":
        header, levels, _ = read_structure(folder)
        object.__setattr__(header, "leaf_cells", 0)  # a value that the file may hold
        write_structure(folder, header, levels)
    else:
        terrain.root[STORE_KEY] = "a" * 100_000 if "path" in kind else str(folder.with_name("none"))
    start = time.monotonic()
    for frame in range(1, 6):
        bpy.context.scene.frame_set(frame)
    assert time.monotonic() - start < 5.0 and signature(terrain) == expected
    printed = capfd.readouterr().err.splitlines()
    assert len(printed) == 1 and len(printed[0]) < 1200 and "defect" not in printed[0], printed
    with pytest.raises(RuntimeError, match=r"leaf_cells is 0|choose a shorter name|there is no folder"):
        bpy.ops.farfield.bdam_update()


def test_follow_view_runs_until_it_is_stopped(folder, camera):
    terrain = load(folder)
    assert bpy.ops.farfield.bdam_follow_view.poll()
    view_following.current.start(terrain, None, 0.05)
    before = terrain.figures.triangles
    camera.location = (0.0, 0.0, 2500.0)
    bpy.context.view_layer.update()
    (item,) = following.running()
    for _ in range(2000):
        assert view_following.current._timer() is not None
        if item.moves and terrain.figures.triangles < before:
            break
        time.sleep(0.005)  # as Blender's timers leave it to the thread, which is starved otherwise
    assert terrain.figures.triangles < before
    moves = item.moves
    for _ in range(50):
        view_following.current._timer()
    assert item.moves <= moves + 1, "standing still, nothing moves"
    assert not bpy.ops.farfield.bdam_load.poll() and bpy.ops.farfield.bdam_follow_view.poll()
    view_following.current.stop()


def test_the_terrain_is_right_when_its_engine_reads_ahead_between_moves(folder, camera):
    terrain = load(folder)
    view_following.current.start(terrain, None, 0.05)
    (item,) = following.running()
    for step in range(1, 5):
        camera.location = (100.0 * step, -50.0 * step, 800.0 - 100.0 * step)
        bpy.context.view_layer.update()
        moves, started = item.moves, time.monotonic()
        while item.moves == moves and time.monotonic() - started < 20.0:
            assert view_following.current._timer() is not None
            time.sleep(0.002)
        assert item.moves > moves and item._prefetch is not None
    item.pause()
    assert item._prefetch is None
    shown = sum(signature(terrain).values())
    assert view_following.current.stop() >= 4
    cache.clear()
    viewer = view_following.view_of_area(bpy.context.scene, None)
    following.recenter(terrain, replace(terrain.to_terrain_space(viewer), is_interactive=True))
    assert sum(signature(terrain).values()) == terrain.figures.triangles == shown


def test_a_store_that_moved_is_one_sentence_and_nothing_is_lost(folder, camera):
    terrain = load(folder)
    expected = signature(terrain)
    moved = folder.rename(folder.with_name("moved"))
    cache.clear()
    with pytest.raises(RuntimeError, match=r'The store of the terrain "Large Terrain" is missing: there is no folder ".*"; set Store'):
        bpy.ops.farfield.bdam_update()
    assert signature(terrain) == expected
    terrain.root[STORE_KEY] = str(moved)
    assert bpy.ops.farfield.bdam_update() == {"FINISHED"} and signature(terrain) == expected


def test_paths_are_relative_to_the_file_on_request(folder, camera, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    relative, absolute = load(folder), load(folder, use_relative_path=False)
    assert relative.root[STORE_KEY] == f"//{LABEL}/terrain" and absolute.root[STORE_KEY] == str(folder)
    bpy.ops.wm.save_mainfile()
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (tmp_path / "scene.blend").rename(moved / "scene.blend")
    (tmp_path / LABEL).rename(moved / LABEL)
    bpy.ops.wm.open_mainfile(filepath=str(moved / "scene.blend"))
    bpy.context.view_layer.objects.active = relative.root
    assert bpy.ops.farfield.bdam_update() == {"FINISHED"}
    bpy.context.view_layer.objects.active = absolute.root
    with pytest.raises(RuntimeError, match="is missing"):
        bpy.ops.farfield.bdam_update()


def test_a_path_relative_to_an_unsaved_file_is_refused(camera):
    with pytest.raises(RuntimeError, match="relative to a file that was never saved"):
        bpy.ops.farfield.bdam_load(directory="//terrain")


@pytest.mark.parametrize("kind", ["empty", "missing", "none"])
def test_a_folder_without_a_terrain_is_refused(tmp_path, kind, camera):
    (tmp_path / "empty").mkdir()
    directory = "" if kind == "none" else str(tmp_path / kind)
    sentence = {"empty": "is no terrain built by Farfield", "missing": "there is no folder", "none": "No folder is given"}[kind]
    with pytest.raises(RuntimeError, match=sentence):
        bpy.ops.farfield.bdam_load(directory=directory)
    assert SceneTerrain.in_scene(bpy.context.scene) == [] and not [mesh for mesh in bpy.data.meshes if mesh.users]


def test_a_linked_terrain_is_left_alone(folder, camera, tmp_path):
    terrain = load(folder)
    setattr(terrain.root, follow_handlers.camera_property("bdam"), True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "library.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (source, target):
        target.collections = [name for name in source.collections if name.startswith("Large Terrain")]
    bpy.context.scene.collection.children.link(target.collections[0])
    (linked,) = SceneTerrain.in_scene(bpy.context.scene)
    bpy.context.view_layer.objects.active = linked.root
    assert "linked from another file" in linked.read_only_reason
    for operator in (bpy.ops.farfield.bdam_update, bpy.ops.farfield.bdam_follow_view, bpy.ops.farfield.bdam_remove):
        assert not operator.poll()
    bpy.context.scene.frame_set(5)
    assert len(linked.tiles()) == linked.figures.tiles


def test_edit_mode_disables_the_operators(folder, camera):
    terrain = load(folder)
    bpy.context.view_layer.objects.active = next(iter(terrain.tiles().values()))
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.farfield.bdam_load.poll() and not bpy.ops.farfield.bdam_update.poll()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.farfield.bdam_update.poll(), "a tile stands for its terrain"


def test_remove_leaves_the_store_and_other_terrains(folder, camera):
    first, second = load(folder), load(folder)
    name, bpy.context.view_layer.objects.active = first.name, first.root
    assert bpy.ops.farfield.bdam_remove() == {"FINISHED"}
    assert read_result(bpy.context.scene, "bdam") == [f'"{name}" was removed.']
    assert SceneTerrain.in_scene(bpy.context.scene) == [second] and len(second.tiles()) == second.figures.tiles
    assert (folder / "structure.bdam").exists()
