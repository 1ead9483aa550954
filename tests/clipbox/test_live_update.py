"""Live update: the terrain is rebuilt once its settings have changed, without an operator."""

import time

import bpy
import pytest

from farfield.addon.bridge.clipbox.edits import mark
from farfield.addon.bridge.clipbox.objects import SceneTerrain
from farfield.addon.core.errors import SettingsError
from farfield.addon.operators.clipbox import live_update

pytestmark = pytest.mark.usefixtures("extension", "empty_scene")
MAX_SECONDS = 20.0


@pytest.fixture
def terrain(monkeypatch):
    """A flat terrain that is updated live, at once."""
    monkeypatch.setattr(live_update, "PAUSE", 0.0)
    group = bpy.context.scene.farfield_clipbox
    group.terrain, group.formula, group.boxes, group.resolution = "formula", "-z", 3, 32
    bpy.ops.farfield.clipbox_create()
    assert bpy.ops.farfield.clipbox_live_update() == {"FINISHED"}
    yield SceneTerrain.in_scene(bpy.context.scene)[0]
    live_update.current.stop()


def wait(condition) -> bool:
    """Let the timer run until a condition is true."""
    end = time.monotonic() + MAX_SECONDS
    while time.monotonic() < end:
        live_update.current.advance()
        if condition():
            return True
        time.sleep(0.005)
    return False


def meshes(terrain) -> set[int]:
    return {block.data.session_uid for block in terrain.blocks().values()}


def changes_soon(terrain) -> bool:
    """Return whether a few ticks of the timer change the terrain."""
    before = meshes(terrain)
    for _ in range(20):
        live_update.current.advance()
    return meshes(terrain) != before


def test_nothing_happens_without_a_change(terrain):
    assert not changes_soon(terrain)


def test_a_changed_setting_rebuilds_the_terrain(terrain):
    bpy.context.scene.farfield_clipbox.formula = "4 - z"
    assert wait(lambda: terrain.settings.formula == "4 - z")
    assert terrain.material.name in {block.data.materials[0].name for block in terrain.blocks().values()}


def test_a_change_during_a_build_starts_another_one(terrain):
    group = bpy.context.scene.farfield_clipbox
    group.formula = "5 - z"
    live_update.current.advance()
    live_update.current.advance()
    group.formula = "6 - z"
    seen = []
    assert wait(lambda: seen.append(terrain.settings.formula) or terrain.settings.formula == "6 - z")
    assert "5 - z" not in seen


@pytest.mark.slow
def test_an_edit_that_moves_rebuilds_the_terrain(terrain):
    ball = bpy.data.objects.new("Ball", None)
    bpy.context.scene.collection.objects.link(ball)
    ball.empty_display_size = 5.0
    mark(ball, "ADD")
    bpy.context.view_layer.update()
    before = meshes(terrain)
    assert wait(lambda: meshes(terrain) != before)


def test_invalid_settings_are_reported_and_the_next_change_is_built(terrain):
    group = bpy.context.scene.farfield_clipbox
    group.formula = "1 +"
    before = meshes(terrain)
    with pytest.raises(SettingsError, match="syntax error"):
        wait(lambda: False)
    assert meshes(terrain) == before
    for _ in range(5):
        live_update.current.advance()
    group.formula = "3 - z"
    assert wait(lambda: terrain.settings.formula == "3 - z")


def test_it_ends_with_the_terrain_and_before_another_file(terrain):
    assert bpy.ops.farfield.clipbox_live_update() == {"FINISHED"} and live_update.current.terrain is None
    assert bpy.ops.farfield.clipbox_live_update() == {"FINISHED"}
    bpy.data.objects.remove(terrain.root)
    assert live_update.current._tick() is None and live_update.current.terrain is None


def test_undo_rebuilds_the_terrain(terrain):
    bpy.ops.ed.undo_push(message="Before")
    bpy.data.objects.new("Mine", None)
    bpy.ops.ed.undo_push(message="After")
    assert not changes_soon(terrain)
    before = meshes(terrain)
    bpy.ops.ed.undo()
    assert wait(lambda: meshes(terrain) and meshes(terrain).isdisjoint(before))
