"""Levels that are shown for a while: the right ones for the view, and everything as before afterwards."""

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge import viewers
from farfield.addon.bridge.lod_crossfade import CROSSFADE
from farfield.addon.bridge.texmesh.level_sets import (
    ERROR,
    LevelSet,
    NewLevel,
    add_collections,
    add_level_set,
    level_sets_in,
    remove_level_set,
)
from farfield.addon.bridge.texmesh.ring_overlay import MAX_LABELED, find_free_box, find_labeled_rings, find_rings
from farfield.addon.bridge.texmesh.temporary_visibility import STATE, resume_crossfades
from farfield.addon.core.geometry.cameras import Camera, distance_to_box
from farfield.addon.operators.texmesh import preview
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples")
ERRORS = (0.0, 0.01, 0.04)


@pytest.fixture
def levels() -> LevelSet:
    """Three levels of a ball, of scale 2, which cross-fade; the original is hidden."""
    ball = textured_ball(16, "Ball")
    ball.scale = (2.0, 2.0, 2.0)
    ball.location = (5.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    new = [NewLevel(ball.data.copy(), error, 0.0, 100.0 * error) for error in ERRORS]
    made = add_level_set(ball, new, *add_collections(ball, bpy.context.scene, ["Ball"]))
    bpy.context.view_layer.update()
    made.add_crossfade(bpy.context.scene, 0.1)
    ball.hide_viewport = ball.hide_render = True
    yield made
    preview.current.stop()


def view(distance: float) -> Camera:
    """A view of a width of 1000 pixels at a distance from the bounding box, along x."""
    return Camera(np.array([5.0 + 2.0 + distance, 0.0, 0.0]), 1000, 1.0)


def visibility() -> dict:
    return {
        item.name: (item.hide_viewport, item.hide_render, tuple(item.get(CROSSFADE, ())), STATE in item)
        for item in bpy.data.objects
        if item.type == "MESH"
    }


def visible() -> list[str]:
    return [name for name, (is_hidden, *_) in visibility().items() if not is_hidden]


def show(distance: float, now: float = 0.0) -> list[str]:
    preview.current.update(view(distance), bpy.context.scene, now)
    return visible()


def test_the_level_is_that_whose_error_is_a_pixel(levels):
    preview.current.follow_view(None)
    for number, error in enumerate(ERRORS[1:], 1):
        distance = view(1.0).switch_distance(2.0 * error)
        assert show(0.99 * distance) == [levels.levels[number - 1].name]
        assert show(1.01 * distance) == [levels.levels[number].name]
        assert preview.current.shown == {"Ball Levels": number}


def test_everything_is_as_before_afterwards(levels):
    levels.levels[2].hide_viewport = True
    before = visibility()
    preview.current.follow_view(None)
    show(1000.0)
    assert visibility() != before
    preview.current.stop()
    assert visibility() == before and not preview.current.is_running


def test_the_selection_goes_along_and_comes_back(levels):
    bpy.ops.object.select_all(action="DESELECT")
    objects = bpy.context.view_layer.objects
    objects.active = levels.levels[1]
    for item in levels.levels[1:]:
        item.select_set(True)
    preview.current.follow_view(None)
    show(0.0)
    assert bpy.context.active_object == levels.levels[0] and bpy.context.selected_objects == [levels.levels[0]]
    show(1000.0)
    assert bpy.context.active_object == levels.levels[2]
    preview.current.stop()
    assert objects.active == levels.levels[1] and {*levels.levels[1:]} == {*bpy.context.selected_objects}


def test_renders_are_not_changed(levels):
    before = [(item.hide_render, tuple(item[CROSSFADE])) for item in levels.levels]
    preview.current.follow_view(None)
    show(1000.0)
    resume_crossfades(bpy.data.objects)
    assert [(item.hide_render, tuple(item[CROSSFADE])) for item in levels.levels] == before


def test_a_cross_fade_shows_everywhere_meanwhile(levels):
    preview.current.follow_view(None)
    show(1.0)
    assert all(item[CROSSFADE][0] < 0.0 and item[CROSSFADE][1] > 1e29 for item in levels.levels)


def test_flicker_alternates_with_the_next_finer_level(levels):
    levels.show(2)
    preview.current.flicker(None, 0.5, bpy.context.scene)
    start = preview.current._started
    names = [show(0.0, start + seconds) for seconds in (0.1, 0.6, 1.1, 1.6)]
    assert names == [["Ball L2"], ["Ball L1"]] * 2
    preview.current.stop()
    assert visible() == ["Ball L2"]


def test_flicker_and_preview_end_separately(levels):
    assert bpy.ops.farfield.texmesh_preview() == {"FINISHED"}
    assert bpy.ops.farfield.texmesh_flicker() == {"FINISHED"}
    show(1000.0)
    assert bpy.ops.farfield.texmesh_preview() == {"FINISHED"}
    assert preview.current.flickers and not preview.current.follows_view and STATE in levels.levels[0]
    assert bpy.ops.farfield.texmesh_flicker() == {"FINISHED"}
    assert not preview.current.is_running and STATE not in levels.levels[0]


def test_what_a_user_shows_meanwhile_stays(levels):
    preview.current.follow_view(None)
    show(1000.0)
    bpy.context.view_layer.objects.active = levels.levels[0]
    assert bpy.ops.farfield.texmesh_show(level=1) == {"FINISHED"}
    show(1000.0)
    preview.current.stop()
    assert visible() == ["Ball L1"] and not any(CROSSFADE in item for item in levels.levels)


def test_a_level_that_a_user_chooses_shows_until_the_levels_cross_fade_again(levels):
    preview.current.follow_view(None)
    assert show(1000.0) == ["Ball L2"] and preview.current.follows(levels)
    assert bpy.ops.farfield.texmesh_show(level=1) == {"FINISHED"}
    assert show(1000.0) == show(0.0) == ["Ball L1"] and not preview.current.follows(levels)
    assert bpy.context.active_object == levels.levels[1] and not any(STATE in item for item in bpy.data.objects)
    assert bpy.ops.farfield.texmesh_show(level=-1) == {"FINISHED"}
    assert show(1000.0) == ["Ball"]
    assert bpy.ops.farfield.texmesh_crossfade() == {"FINISHED"}
    assert show(1000.0) == ["Ball L2"] and preview.current.follows(levels)


def test_preview_pressed_while_one_level_was_chosen_shows_levels_by_distance(levels):
    preview.start_for_crossfades(0)
    bpy.context.view_layer.objects.active = levels.levels[0]
    assert bpy.ops.farfield.texmesh_show(level=1) == {"FINISHED"}
    assert bpy.ops.farfield.texmesh_preview() == {"FINISHED"}
    assert show(1000.0) == ["Ball L2"] and show(0.0) == ["Ball L0"]
    preview.start_for_crossfades(0)
    assert show(1000.0) == ["Ball L2"]
    assert bpy.ops.farfield.texmesh_preview() == {"FINISHED"}
    assert visible() == ["Ball L1"] and not preview.current.is_running


def test_an_original_that_stays_visible_beside_its_levels_does_so_in_the_preview(levels):
    levels.hide_source(False)
    preview.start_for_crossfades(0)
    assert show(1000.0) == ["Ball", "Ball L2"]


def test_objects_that_a_user_selects_meanwhile_stay_selected(levels):
    bpy.ops.object.select_all(action="DESELECT")
    cube = textured_ball(8, "Cube")
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = levels.levels[0]
    levels.levels[0].select_set(True)
    preview.current.follow_view(None)
    show(1000.0)
    assert bpy.context.selected_objects == [levels.levels[2]]
    levels.levels[2].select_set(False)
    bpy.context.view_layer.objects.active = cube
    cube.select_set(True)
    preview.current.stop()
    assert bpy.context.selected_objects == [cube] and bpy.context.active_object == cube


def test_undo_shows_the_level_for_the_distance_again(levels):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    preview.start_for_crossfades(0)
    show(0.0)
    bpy.ops.ed.undo_push(message="near")
    bpy.ops.ed.undo_push(message="later")
    assert show(1000.0) == ["Ball L2"]
    bpy.ops.ed.undo()
    assert show(1000.0) == ["Ball L2"]
    (found,) = level_sets_in(bpy.context.scene)
    bpy.context.view_layer.objects.active = found.levels[2]
    assert bpy.ops.farfield.texmesh_remove() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="removed")
    assert show(1000.0) == ["Ball"]
    bpy.ops.ed.undo()
    assert show(1000.0) == ["Ball L2"]


def test_the_original_is_shown_when_levels_are_removed_meanwhile(levels):
    preview.current.follow_view(None)
    show(1000.0)
    bpy.context.view_layer.objects.active = levels.levels[0]
    assert bpy.ops.farfield.texmesh_remove() == {"FINISHED"}
    show(1000.0)
    preview.current.stop()
    assert visible() == ["Ball"] and not bpy.data.objects["Ball"].hide_render


def test_deleted_levels_do_no_harm(levels):
    preview.current.follow_view(None)
    show(1.0)
    bpy.data.objects.remove(levels.levels[1])
    show(1000.0)
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    preview.current.stop()
    assert not any(STATE in item for item in bpy.data.objects)


def test_undo_and_files_never_keep_what_was_shown(levels, tmp_path):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    before = visibility()
    preview.current.follow_view(None)
    show(1000.0)
    bpy.context.scene.frame_end = 77
    bpy.ops.ed.undo_push(message="meanwhile")  # with the state
    bpy.context.scene.frame_end = 78
    bpy.ops.ed.undo_push(message="later")
    preview.current.stop()
    bpy.ops.ed.undo()
    assert bpy.context.scene.frame_end == 77 and visibility() == before
    preview.current.follow_view(None)
    show(1000.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "levels.blend"), check_existing=False)
    show(1000.0)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "levels.blend"))
    assert not preview.current.is_running and visibility() == before


def test_a_file_that_was_saved_meanwhile_is_repaired(levels, tmp_path):
    before = visibility()
    preview.current.follow_view(None)
    show(1000.0)
    bpy.app.handlers.save_pre.remove(preview._before_save)  # as an autosave
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "autosave.blend"), check_existing=False)
    finally:
        bpy.app.handlers.save_pre.append(preview._before_save)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "autosave.blend"))
    assert visibility() == before


def test_rings_are_where_levels_switch(levels):
    camera = view(0.0)
    low, high, scale = levels.bounds()
    rings = find_rings(levels, camera)
    assert [number for number, _ in rings] == [1, 2] and scale == pytest.approx(2.0)
    for number, ring in rings:
        np.testing.assert_allclose(ring[:, 2], 0.5 * (low[2] + high[2]))
        for point in ring[::9]:
            distance = distance_to_box(point, low, high)
            assert camera.pixel_size(distance) == pytest.approx(scale * levels.levels[number][ERROR], rel=1e-6)
    assert find_rings(levels, Camera(np.zeros(3), 1000, 0.0, 5.0)) == []
    levels.levels[1][ERROR] = levels.levels[2][ERROR]
    assert [number for number, _ in find_rings(levels, camera)] == [2]


def test_rings_name_their_object_if_there_are_several(levels):
    def labels(active) -> list[str]:
        return [label for _, label, _ in find_labeled_rings(bpy.context.scene, active, view(0.0))]

    assert labels(None) == ["L1", "L2"]
    for index in range(MAX_LABELED):
        other = textured_ball(8, f"Rock {index}")
        new = [NewLevel(other.data.copy(), error, 0.0, 100.0 * error) for error in ERRORS[:2]]
        add_level_set(other, new, *add_collections(other, bpy.context.scene, [other.name]))
        if index == 0:
            assert labels(None) == ["Ball L1", "Ball L2", "Rock 0 L1"]
    assert labels(None) == [] and labels(levels.levels[1]) == ["Ball L1", "Ball L2"] and labels(other) == [f"{other.name} L1"]


def test_labels_of_rings_do_not_overlap():
    boxes = []
    for x, y in ((10.0, 100.0), (30.0, 95.0), (10.0, 108.0), (90.0, 100.0)):
        boxes.append(find_free_box(boxes, x, y, (40.0, 12.0)))
    assert boxes == [(10.0, 100.0, 50.0, 112.0), (30.0, 112.0, 70.0, 124.0), (10.0, 124.0, 50.0, 136.0), (90.0, 100.0, 130.0, 112.0)]


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_the_camera_of_a_viewport_has_the_pixel_size_of_its_matrix(kind):
    data = bpy.data.cameras.new("Camera")
    data.type, data.lens, data.ortho_scale = kind, 35.0, 7.0
    item = bpy.data.objects.new("Camera", data)
    bpy.context.collection.objects.link(item)

    class Region:
        view_matrix = mathutils.Matrix.Translation((1.0, 2.0, 3.0)).inverted()
        window_matrix = item.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=800, y=400)

    camera = viewers.viewport_camera(Region, 800)
    expected = 7.0 / 800 if kind == "ORTHO" else 36.0 / 35.0 * 10.0 / 800
    assert camera.pixel_size(10.0) == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(camera.position, [1.0, 2.0, 3.0], atol=1e-6)


def test_nothing_is_started_without_levels():
    with pytest.raises(RuntimeError, match="Make levels first"):
        bpy.ops.farfield.texmesh_preview()
    with pytest.raises(RuntimeError, match="Make levels first"):
        bpy.ops.farfield.texmesh_flicker()
    assert not level_sets_in(bpy.context.scene)


def test_removing_levels_in_a_preview_leaves_no_state(levels):
    preview.current.follow_view(None)
    show(1.0)
    remove_level_set(levels)
    assert STATE not in bpy.data.objects["Ball"]
