"""Terrains that follow the view by a timer or the camera by a handler, and what ends or disturbs that."""

import json
import time

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.clipbox import objects as terrain_objects
from farfield.addon.core.errors import GeometryError, SettingsError
from farfield.addon.operators import follow_handlers as handlers
from farfield.addon.operators import following, long_work, view_following
from farfield.addon.operators.clipbox.operators import FARFIELD_OT_clipbox_follow_view
from farfield.addon.operators.engine_cache import cache
from farfield.addon.operators.view_following import current
from scene_terrain import SMALL, camera_at, create, geometry_bytes

EXHAUSTIVE = pytest.mark.exhaustive

pytestmark = pytest.mark.usefixtures("empty_scene")
MAX_SECONDS = 20.0


@pytest.fixture
def terrain():
    camera_at(0.0, 0.0, 20.0)
    created = create()
    yield created
    current.stop()


def move_camera(*position):
    bpy.context.scene.camera.location = position
    bpy.context.view_layer.update()


def run_timer(until):
    """Call the timer, as Blender's main loop would, until the condition holds or the timer ends; return whether it goes on."""
    started = time.monotonic()
    while not until():
        assert time.monotonic() - started < MAX_SECONDS
        if current._timer() is None:
            return False
        time.sleep(0.002)
    return True


class TestView:
    """*Follow View*."""

    def test_no_modal_operator_runs_so_that_blender_saves_automatically(self):
        assert not hasattr(FARFIELD_OT_clipbox_follow_view, "modal")

    def test_the_timer_moves_the_terrain_until_it_is_stopped(self, terrain):
        current.start(terrain, None, 0.05)
        assert bpy.app.timers.is_registered(current._timer) and current.terrain == terrain
        for step in (1.0, 2.0):
            move_camera(30.0 * step, 0.0, 20.0)
            assert run_timer(lambda step=step: terrain.viewer.tolist() == [30.0 * step, 0.0, 20.0])
        assert current.stop() == 2
        assert not bpy.app.timers.is_registered(current._timer) and not following.running() and current.terrain is None
        assert geometry_bytes(terrain) == geometry_bytes(create())

    def test_the_operator_stops_what_it_has_started(self, terrain):
        current.start(terrain, None, 0.05)
        bpy.context.view_layer.objects.active = None
        assert bpy.ops.farfield.clipbox_follow_view.poll(), "it can be stopped whatever is active"
        assert not bpy.ops.farfield.clipbox_create.poll()
        current.stop()
        assert not bpy.ops.farfield.clipbox_follow_view.poll() and bpy.ops.farfield.clipbox_create.poll()

    @pytest.mark.parametrize("accident", ["removed", pytest.param("renamed", marks=pytest.mark.exhaustive)])
    def test_it_ends_with_a_sentence_when_the_terrain_is_gone(self, terrain, accident, capsys):
        current.start(terrain, None, 0.05)
        if accident == "removed":
            terrain_objects.remove(terrain)
        else:
            terrain.root.name = "Hills"
        assert not run_timer(lambda: False)
        sentence = f'The terrain "{terrain.name}" was removed or renamed; it no longer follows the view.'
        assert current.error == sentence and capsys.readouterr().err.strip() == sentence
        assert current.terrain is None and not following.running()

    def test_it_ends_with_the_sentence_of_an_error(self, terrain, monkeypatch):
        def fail(_viewer):
            raise GeometryError("No more ground.")
            yield

        current.start(terrain, None, 0.05)
        monkeypatch.setattr(cache.get(terrain), "move", fail)
        before = geometry_bytes(terrain)
        move_camera(30.0, 0.0, 20.0)
        assert not run_timer(lambda: False) and current.error == "No more ground." and geometry_bytes(terrain) == before

    def test_a_defect_ends_it_as_well(self, terrain, monkeypatch):
        monkeypatch.setattr(view_following, "viewer_matrix", lambda *_: None)
        current.start(terrain, None, 0.05)
        assert current._timer() is None
        assert "defect" in current.error and ".log" in current.error
        assert current.terrain is None and not following.running() and bpy.ops.farfield.clipbox_create.poll()

    def test_it_ends_when_another_file_is_opened(self, terrain):
        current.start(terrain, None, 0.05)
        move_camera(30.0, 0.0, 20.0)
        current._timer()
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        assert current.terrain is None and not bpy.app.timers.is_registered(current._timer) and not following.running()

    def test_it_continues_after_undo(self, terrain):
        current.start(terrain, None, 0.05)
        move_camera(30.0, 0.0, 20.0)
        current._timer()
        handlers._after_undo()
        assert run_timer(lambda: terrain.viewer.tolist() == [30.0, 0.0, 20.0])

    @pytest.mark.slow
    def test_it_waits_while_something_uses_the_scene(self, terrain, monkeypatch):
        current.start(terrain, None, 0.05)
        move_camera(30.0, 0.0, 20.0)
        monkeypatch.setattr(long_work, "current_run", lambda: "a job")
        for _ in range(50):
            assert current._timer() is not None
        assert terrain.viewer.tolist() == [0.0, 0.0, 20.0]
        monkeypatch.undo()
        assert run_timer(lambda: terrain.viewer.tolist() == [30.0, 0.0, 20.0])

    def test_unregistering_ends_it(self, terrain):
        current.start(terrain, None, 0.05)
        handlers.unregister()
        try:
            assert not bpy.app.timers.is_registered(current._timer) and not following.running()
        finally:
            handlers.register()


class TestFastViewer:
    """Innermost boxes are left out while the viewer of a viewport is fast."""

    @pytest.fixture
    def fast(self, terrain):
        """The terrain, which follows a viewer with 100 voxels per second although each move takes 10 seconds."""
        current.start(terrain, None, 0.05)
        current._following._move_seconds = 10.0
        for step in range(10):
            current._following._path.append(time.perf_counter() - 0.02 * (10 - step), np.array([2.0 * (step - 10), 0.0, 20.0]))
        move_camera(3.0, 0.0, 20.0)
        assert run_timer(lambda: not terrain.is_complete)
        return terrain

    def test_they_are_shown_once_the_viewer_is_slow(self, fast):
        assert not any(name.startswith("0 ") for name in fast.blocks())
        assert run_timer(lambda: fast.is_complete) and any(name.startswith("0 ") for name in fast.blocks())
        current.stop()
        assert geometry_bytes(fast) == geometry_bytes(create())

    @pytest.mark.slow
    def test_they_are_shown_when_following_ends(self, fast):
        current.complete()
        current.stop()
        assert fast.is_complete and geometry_bytes(fast) == geometry_bytes(create())

    def test_renders_show_all_boxes(self, fast):
        current.stop()
        assert not fast.is_complete
        fast.root.farfield_clipbox_follow_camera = True
        bpy.context.scene.frame_set(2)
        assert fast.is_complete and geometry_bytes(fast) == geometry_bytes(create())

    def test_a_jump_is_no_speed(self):
        path = following.ViewerPath()
        for index, x in enumerate((0.0, 0.0, 0.0, 5000.0, 5000.0)):
            path.append(0.02 * index, np.array([x, 0.0, 0.0]))
        assert path.speed == 0.0
        for index in range(100):
            path.append(1.0 + 0.02 * index, np.array([2.0 * index, 0.0, 0.0]))
        assert path.speed == pytest.approx(100.0, rel=0.1) and path.last.tolist() == [198.0, 0.0, 0.0]


def test_handlers_that_another_add_on_has_removed_do_not_disturb(terrain):
    names = [name for name, _ in handlers.HANDLERS]
    before = {name: list(getattr(bpy.app.handlers, name)) for name in names}
    for name in names:
        getattr(bpy.app.handlers, name).clear()
    handlers.unregister()
    handlers.register()
    assert all(handler in getattr(bpy.app.handlers, name) for name, handler in handlers.HANDLERS)
    for name in names:
        getattr(bpy.app.handlers, name)[:] = before[name]


@pytest.mark.slow
def test_terrains_that_swap_names_keep_their_engines():
    camera_at(0.0, 0.0, 20.0)
    first = create()
    move_camera(400.0, 0.0, 20.0)
    second = create()
    names = first.name, second.name
    first.root.name = "Other"
    second.root.name, bpy.data.objects["Other"].name = names
    bpy.context.view_layer.update()
    for terrain in terrain_objects.SceneTerrain.in_scene(bpy.context.scene):
        following.recenter(terrain, terrain.viewer + mathutils.Vector((9.0, 0.0, 0.0)))
        move_camera(*terrain.viewer)
        assert geometry_bytes(terrain) == geometry_bytes(create())


SETTINGS, ORIGIN, VIEWER = terrain_objects.SETTINGS_KEY, terrain_objects.ORIGIN_KEY, terrain_objects.VIEWER_KEY


def with_setting(name, value):
    return json.dumps(SMALL | {name: value})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        (SETTINGS, with_setting("voxel_size", "a"), "Voxel Size must be a number"),
        (SETTINGS, with_setting("resolution", 64.5), "Resolution must be an integer, not 64.5"),
        pytest.param(SETTINGS, with_setting("boxes", True), "Boxes must be an integer, not True", marks=EXHAUSTIVE),
        (SETTINGS, with_setting("formula", 5), "Formula must be text, not 5"),
        pytest.param(SETTINGS, with_setting("terrain", ["sine"]), "Terrain must be text", marks=EXHAUSTIVE),
        pytest.param(SETTINGS, with_setting("source_color", None), "Source Color must be text, not None", marks=EXHAUSTIVE),
        (SETTINGS, with_setting("seed", 10**4000), "Seed|cannot be read"),
        (SETTINGS, with_setting("scale", float("nan")), "Scale must be a finite number"),
        pytest.param(SETTINGS, with_setting("new_setting", 1), "cannot be read", marks=EXHAUSTIVE),
        (SETTINGS, "[" * 10000, "cannot be read"),
        pytest.param(SETTINGS, "[1]", "cannot be read", marks=EXHAUSTIVE),
        pytest.param(SETTINGS, "no JSON", "cannot be read", marks=EXHAUSTIVE),
        (SETTINGS, 7, "cannot be read"),
        pytest.param(SETTINGS, {"voxel_size": 1.0}, "cannot be read", marks=EXHAUSTIVE),
        (ORIGIN, None, f'custom property "{ORIGIN}" .* is invalid'),
        pytest.param(ORIGIN, "here", f'custom property "{ORIGIN}" .* is invalid', marks=EXHAUSTIVE),
        pytest.param(VIEWER, [1.0, 2.0], f'custom property "{VIEWER}" .* is invalid', marks=EXHAUSTIVE),
        (VIEWER, [1.0, 2.0, float("inf")], f'custom property "{VIEWER}" .* is invalid'),
    ],
    ids=range(18),
)
def test_invalid_custom_properties_are_one_sentence(terrain, capfd, key, value, words):
    terrain.root.farfield_clipbox_follow_camera = True
    if value is None:
        del terrain.root[key]
    else:
        terrain.root[key] = value
    bpy.context.view_layer.objects.active = terrain.root
    before, collections = geometry_bytes(terrain), len(bpy.data.collections)
    for frame in (2, 3, 4):
        move_camera(90.0 * frame, 0.0, 20.0)
        bpy.context.scene.frame_set(frame)
    output = capfd.readouterr().err.strip()
    assert output.count("\n") == 0 and f'"{terrain.name}"' in output and len(output) < 400
    for operator, settings in ((bpy.ops.farfield.clipbox_follow_view, {}), (bpy.ops.farfield.clipbox_convert_to_mesh, {"collider": False})):
        assert operator.poll()
        with pytest.raises(RuntimeError, match=words):
            operator(**settings)
    assert geometry_bytes(terrain) == before and len(bpy.data.collections) == collections and not following.running()


def test_following_does_not_start_with_invalid_settings(terrain):
    terrain.root[SETTINGS] = "[1]"
    with pytest.raises(SettingsError, match="cannot be read"):
        current.start(terrain, None, 0.05)
    assert current.terrain is None and not following.running()


def test_an_origin_that_becomes_invalid_ends_following(terrain):
    current.start(terrain, None, 0.05)
    terrain.root[ORIGIN] = "here"
    assert not run_timer(lambda: False) and "is invalid" in current.error and not following.running()


def test_children_that_are_not_blocks_stay_unchanged(terrain):
    empty = bpy.data.objects.new("Empty", None)
    empty.parent, empty[terrain_objects.BLOCK_KEY] = terrain.root, "0 0 0 0"
    bpy.context.collection.objects.link(empty)
    block = next(iter(terrain.blocks().values()))
    block[terrain_objects.BLOCK_KEY] = 7
    assert terrain.material is not None
    following.recenter(terrain, terrain.viewer + mathutils.Vector((90.0, 0.0, 0.0)))
    assert empty.name in bpy.data.objects and terrain.viewer.tolist() == [90.0, 0.0, 20.0]
