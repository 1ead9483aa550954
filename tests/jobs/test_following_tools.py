"""Terrains of a tool that is registered for the test follow: fills and changes in several steps, errors, undo, two tools at once."""

import json
import time
from dataclasses import dataclass
from queue import SimpleQueue
from typing import ClassVar

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.geometry import mesh_pool
from farfield.addon.bridge.terrain_roots import TerrainRoot
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.viewers import Viewer
from farfield.addon.core.jobs.progress import Progress
from farfield.addon.operators import follow_handlers, following, view_following
from farfield.addon.operators.engine_cache import cache
from farfield.addon.operators.following import Following, recenter

STEP_SECONDS = 0.004
VERTICES, TRIANGLES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[0, 1, 2]])


@dataclass(frozen=True)
class Settings:
    """count: number of tiles."""

    count: int = 3


@dataclass(frozen=True)
class Tiles(TerrainRoot):
    """A terrain of tiles at the height of the viewer."""

    tool: ClassVar[str] = "tiles"
    settings_type = Settings

    def heights(self):
        return sorted(child.data.vertices[0].co.z for child in self.root.children)


@dataclass(frozen=True)
class OtherTiles(Tiles):
    """Terrain of another tool."""

    tool: ClassVar[str] = "other_tiles"


class TileEngine:
    """The update is the number of tiles that have changed; an engine that was invalidated changes all."""

    def __init__(self, settings):
        self.settings, self.finished_blocks, self.shown, self.completes = settings, SimpleQueue(), None, 0

    def move(self, viewer):
        if viewer.position[0] < 0.0:
            raise GeometryError("There is no terrain in the west.")
        self.finished_blocks = SimpleQueue()
        self.completes += self.shown is None
        for index in range(self.settings.count):
            yield Progress(index / self.settings.count, "Moving")
            self.finished_blocks.put((index, viewer.position[2]))
        self.shown = viewer
        return self.settings.count

    def is_settled_at(self, viewer):
        return self.shown is not None and viewer.is_same(self.shown)

    def invalidate(self):
        self.shown = None


class TileChange:
    """Every tile is filled in two steps, and all are shown in three."""

    def __init__(self, terrain, tool):
        self.terrain, self.tool, self.pending = terrain, tool, mesh_pool.PendingMeshes(tool.identifier, "Tile")

    def fill(self, key, block):
        time.sleep(STEP_SECONDS)
        yield
        time.sleep(STEP_SECONDS)
        if block == 13.0:
            raise GeometryError("Thirteen is not a height.")
        self.pending.fill(key, VERTICES + [0.0, 0.0, block], TRIANGLES)

    def show(self, update):
        assert update == len(self.pending.names)
        for _ in range(2):
            time.sleep(STEP_SECONDS)
            yield
        children = {child["index"]: child for child in self.terrain.root.children}
        for key in self.pending.names:
            if key in children:
                mesh_pool.mark_spare(children[key].data, self.tool.identifier)
                children[key].data = self.pending.claim(key)
            else:
                self.terrain.add_child("Tile", self.pending.claim(key))["index"] = key


class TileTool:
    """See `FollowTool`."""

    def __init__(self, terrain_type):
        self.identifier, self.terrain_type = terrain_type.tool, terrain_type

    def scene_terrains(self, scene):
        return self.terrain_type.in_scene(scene)

    def create_engine(self, terrain):
        return TileEngine(terrain.settings)

    def is_engine_of(self, engine, terrain):
        return engine.settings == terrain.settings

    def to_terrain(self, terrain, viewer):
        return terrain.to_terrain_space(viewer)

    def is_shown_at(self, terrain, viewer):
        return False

    def start_change(self, terrain, engine):
        return TileChange(terrain, self)


@pytest.fixture
def tools(empty_scene):
    registered = [TileTool(Tiles), TileTool(OtherTiles)]
    for tool in registered:
        follow_handlers.register_tool(tool)
    yield registered
    for tool in registered:
        follow_handlers.unregister_tool(tool)


@pytest.fixture
def terrain(tools):
    return create(Tiles)


def create(terrain_type, origin=(0.0, 0.0, 0.0)):
    terrain = terrain_type.create(bpy.context.scene, "Tiles", np.array(origin), Settings(), 1.0)
    bpy.context.view_layer.update()
    return terrain


def viewer_at(x, z):
    viewer = view_following.view_of_area(bpy.context.scene, None)
    return viewer.transform(np.eye(4), np.array([x, 0.0, z]) - viewer.position)


def tick_until_shown(run, viewer, max_seconds=0.02):
    ticks = 0
    while not run.tick(viewer, max_seconds):
        ticks += 1
        time.sleep(0.001)
    return ticks


def test_tiles_switch_all_at_once(terrain):
    run = Following(terrain)
    tick_until_shown(run, viewer_at(0.0, 5.0))
    seen = set()
    while not run.tick(viewer_at(0.0, 6.0), 0.001):
        seen.add(tuple(terrain.heights()))
        time.sleep(0.001)
    assert seen == {(5.0, 5.0, 5.0)} and terrain.heights() == [6.0, 6.0, 6.0]
    assert run.moves == 2 and run.is_settled(viewer_at(0.0, 6.0)) and not run.is_settled(viewer_at(0.0, 7.0))
    run.close()


def test_long_fills_and_changes_take_several_ticks(terrain):
    run = Following(terrain)
    assert tick_until_shown(run, viewer_at(0.0, 5.0), max_seconds=1.5 * STEP_SECONDS) >= 3 * 2 + 2, "one step per tick"
    assert run.longest_tick >= STEP_SECONDS
    run.close()


def test_the_update_of_the_scene_after_a_change_is_timed(terrain):
    run = Following(terrain)
    tick_until_shown(run, viewer_at(0.0, 5.0))
    assert run.longest_evaluation == 0.0
    bpy.context.view_layer.update()
    first = run.longest_evaluation
    assert first > 0.0
    run.record_evaluation(9.0)
    assert run.longest_evaluation == first, "nothing was shown since"
    run.close()


@pytest.mark.parametrize(("viewer", "sentence"), [((-1.0, 5.0), "no terrain in the west"), ((0.0, 13.0), "Thirteen is not")])
def test_after_an_error_the_next_change_is_complete(terrain, viewer, sentence):
    run = Following(terrain)
    tick_until_shown(run, viewer_at(0.0, 5.0))
    engine = cache.get(terrain)
    with pytest.raises(GeometryError, match=sentence):
        tick_until_shown(run, viewer_at(*viewer))
    assert terrain.heights() == [5.0, 5.0, 5.0] and engine.completes == 1
    tick_until_shown(run, viewer_at(0.0, 6.0))
    assert terrain.heights() == [6.0, 6.0, 6.0] and engine.completes == 2
    with pytest.raises(GeometryError, match=sentence):
        recenter(terrain, viewer_at(*viewer))
    recenter(terrain, viewer_at(0.0, 7.0))
    assert terrain.heights() == [7.0, 7.0, 7.0] and engine.completes == 3
    run.close()


def test_a_change_that_undo_interrupts_is_repeated_completely(terrain):
    run = Following(terrain)
    engine = cache.get(terrain)
    for _ in range(200):
        run.tick(viewer_at(0.0, 5.0), 0.5 * STEP_SECONDS)
        if engine.shown is not None and engine.finished_blocks.empty():
            break
        time.sleep(0.001)
    run.tick(viewer_at(0.0, 5.0), 0.5 * STEP_SECONDS)
    follow_handlers._after_undo()
    assert not terrain.root.children and engine.shown is None
    tick_until_shown(run, viewer_at(0.0, 5.0))
    assert terrain.heights() == [5.0, 5.0, 5.0] and engine.completes == 2
    run.close()


def test_blocks_of_an_earlier_move_are_not_filled(terrain):
    engine = cache.get(terrain)
    engine.finished_blocks.put(("stale", 1.0))
    run = Following(terrain)
    tick_until_shown(run, viewer_at(0.0, 5.0))
    assert terrain.heights() == [5.0, 5.0, 5.0]
    run.close()


def test_an_engine_is_replaced_when_the_settings_change(terrain):
    first = cache.get(terrain)
    assert cache.get(terrain) is first
    terrain.root[Tiles.settings_key()] = json.dumps({"count": 4})
    assert cache.get(terrain) is not first and cache.get(terrain).settings.count == 4


def test_terrains_follow_the_camera_in_every_frame(terrain):
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    for frame in (1, 5):
        camera.location.z = 2.0 * frame
        camera.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    assert not terrain.root.children
    terrain.root.farfield_tiles_follow_camera = True
    assert scene.render.use_lock_interface
    scene.frame_set(5)
    assert terrain.heights() == [10.0, 10.0, 10.0]


def test_two_tools_do_not_mix(tools, terrain):
    other = create(OtherTiles)
    runs = Following(terrain), Following(other)
    for height, run in enumerate(runs):
        tick_until_shown(run, viewer_at(0.0, float(height)))
    assert terrain.heights() == [0.0, 0.0, 0.0] and other.heights() == [1.0, 1.0, 1.0] and len(cache) == 2
    assert Tiles.of_object(other.root) is None and OtherTiles.of_object(other.root.children[0]) == other
    follow_handlers.unregister_tool(tools[1])
    try:
        assert following.running() == runs[:1] and len(cache) == 1
    finally:
        follow_handlers.register_tool(tools[1])


def test_the_view_follows_terrains_of_any_tool(terrain):
    view_following.current.start(terrain, None, 0.05)
    bpy.context.scene.cursor.location.z = 3.0
    started = time.monotonic()
    while not terrain.root.children:
        assert view_following.current._timer() is not None and time.monotonic() - started < 20.0
        time.sleep(0.002)
    assert view_following.current.stop() == 1 and terrain.heights() == [3.0, 3.0, 3.0]


def test_viewers_in_terrain_space(tools):
    terrain = create(Tiles, origin=(1e8, 0.25, 0.0))
    terrain.root.matrix_world = mathutils.Matrix.LocRotScale((10.0, 0.0, 0.0), mathutils.Euler((0.0, 0.0, np.pi / 2)), (2.0, 2.0, 2.0))
    bpy.context.view_layer.update()
    world = viewer_at(10.0, 8.0)
    viewer = terrain.to_terrain_space(world)
    assert isinstance(viewer, Viewer) and viewer.projection == world.projection
    np.testing.assert_allclose(viewer.position, [1e8, 0.25, 4.0], atol=1e-5)
    np.testing.assert_array_equal(viewer.position, terrain.viewer_position(world.matrix))
    assert viewer.scale_range == pytest.approx((2.0, 2.0))
