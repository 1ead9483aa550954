"""The experiment with judges: trials, answers, the threshold, and nothing temporary that stays."""

import json

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.texmesh.level_sets import FIGURES, LevelSet, NewLevel, add_collections, add_level_set, remove_level_set
from farfield.addon.bridge.texmesh.trial_objects import MARK
from farfield.addon.core.errors import FarfieldError, GeometryError, SettingsError
from farfield.addon.core.geometry.cameras import Camera
from farfield.addon.core.texmesh.perception.recorded_answers import read_answers
from farfield.addon.operators.texmesh import calibration
from farfield.addon.operators.texmesh.calibration import handle_event
from farfield.addon.operators.texmesh.calibration_run import ANSWERS, CalibrationRun, stored_answers
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene")
TRIANGLES = (480, 120, 60, 30)
FRACTIONS = (0.04, 0.09, 0.16)
VIEW = mathutils.Matrix.Translation((3.0, 4.0, 5.0))
CAMERA = Camera(np.array([3.0, 4.0, 5.0]), 1000, 0.7)


@pytest.fixture
def levels() -> LevelSet:
    """Four levels of a ball with figures, as the operator makes them."""
    ball = textured_ball(8, "Ball")
    new = [NewLevel(ball.data.copy(), 0.004 * number, 0.0, 0.0) for number in range(4)]
    made = add_level_set(ball, new, *add_collections(ball, bpy.context.scene, ["Ball"]))
    figures = {
        "levels": [{"triangles": count} for count in TRIANGLES],
        "candidates": [{"triangles": count, "pixel_size": 0.004 * number} for number, count in enumerate(TRIANGLES)],
        "weber_fractions": FRACTIONS,
        "features": [1] * 21,
        "ranges": [1.0] * 21,
    }
    made.collection[FIGURES] = json.dumps(figures)
    bpy.context.view_layer.update()
    yield made
    calibration.end_calibration()


@pytest.fixture
def run(levels) -> CalibrationRun:
    """A calibration that has just started, as the operator does."""
    calibration._run = CalibrationRun(bpy.context.scene, levels, 67.0)
    place(calibration._run)
    return calibration._run


def place(run: CalibrationRun) -> None:
    run.place(VIEW, CAMERA, (1000, 700), 0.1, 0.5)
    bpy.context.view_layer.update()


def scene_data() -> dict:
    return {kind: sorted(item.name for item in getattr(bpy.data, kind)) for kind in ("objects", "meshes", "collections", "materials")}


def temporary() -> list[bpy.types.Object]:
    return [item for collection in bpy.data.collections if collection.get(MARK) for item in collection.objects]


def press(run: CalibrationRun, key: str) -> set[str]:
    return handle_event(run, key, "PRESS")


def test_original_and_level_are_side_by_side_in_front_of_the_viewer(run, levels):
    original, level, backdrop = temporary()
    assert original.data == levels.levels[0].data and level.data == levels.levels[run.trial.level].data
    inverse = VIEW.inverted()
    left, right, behind = (inverse @ item.matrix_world @ mathutils.Vector((0.0, 0.0, 0.0)) for item in (original, level, backdrop))
    assert left.x == pytest.approx(-right.x) and left.x < 0.0 and left.z == pytest.approx(right.z)
    assert behind.z < 2.0 * left.z < 0.0
    assert all(item.hide_render for item in temporary())


def test_nearer_is_larger(run):
    run.distance *= 2.0  # the start may be the nearest distance at which both fit into the image
    place(run)
    before, scale = run.distance, temporary()[1].scale.x
    for _ in range(3):
        press(run, "WHEELUPMOUSE")
    place(run)
    assert run.distance < before and temporary()[1].scale.x == pytest.approx(scale * before / run.distance, rel=1e-4)
    for _ in range(3):
        press(run, "DOWN_ARROW")
    assert run.distance == pytest.approx(before)


def test_distances_stay_where_the_objects_can_be_judged(run):
    for key in ("WHEELUPMOUSE", "WHEELDOWNMOUSE"):
        for _ in range(400):
            press(run, key)
        place(run)
        assert 0.0 < run.distance < 1e4
        assert temporary()[0].scale.x > 0.0


def test_answers_are_recorded_with_their_stimuli(run, levels):
    for number in range(5):
        trial, distance = run.trial, run.distance
        assert press(run, "RET") == {"RUNNING_MODAL"}
        record = stored_answers(bpy.context.scene)[number]
        assert record.name == "Ball" and record.stimulus == pytest.approx(FRACTIONS[trial.level - 1])
        assert (record.answer.level, record.answer.accepted_distance) == (trial.level, distance)
        place(run)
        assert temporary()[1].data == levels.levels[run.trial.level].data
    assert sorted(record.answer.level for record in stored_answers(bpy.context.scene)[:3]) == [1, 2, 3]


def test_esc_ends_with_or_without_answers(run):
    assert press(run, "ESC") == {"CANCELLED"}
    press(run, "RET")
    assert press(run, "ESC") == {"FINISHED"}
    assert handle_event(run, "ESC", "RELEASE") == {"RUNNING_MODAL"} and press(run, "A") == {"RUNNING_MODAL"}


def test_nothing_temporary_stays(levels):
    before = scene_data()
    calibration._run = CalibrationRun(bpy.context.scene, levels, 67.0)
    place(calibration._run)
    press(calibration._run, "RET")
    assert scene_data() != before
    calibration.end_calibration()
    assert scene_data() == before


def test_undo_saving_and_other_files_end_it(run, levels, tmp_path):
    path = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, check_existing=False)
    assert calibration._run is None and not temporary()
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    bpy.context.scene.frame_end = 99
    bpy.ops.ed.undo_push(message="after")
    calibration._run = CalibrationRun(bpy.context.scene, levels, 67.0)
    bpy.ops.ed.undo()
    assert calibration._run is None and not temporary()
    bpy.ops.wm.open_mainfile(filepath=path)
    assert not temporary()


def test_what_a_saved_file_holds_is_removed(run, tmp_path):
    bpy.app.handlers.save_pre.remove(calibration._before_change)  # as an autosave
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "autosave.blend"), check_existing=False)
    finally:
        bpy.app.handlers.save_pre.append(calibration._before_change)
    assert temporary()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "autosave.blend"))
    assert not temporary() and not any(mesh.name.startswith("Farfield") for mesh in bpy.data.meshes)


def test_removed_levels_and_objects_are_named(run, levels):
    bpy.data.objects.remove(temporary()[0])
    with pytest.raises(GeometryError, match="were removed; start it again"):
        place(run)
    remove_level_set(levels)
    with pytest.raises(GeometryError, match="levels were removed"):
        press(run, "RET")


@pytest.mark.parametrize("damage", ["figures", "answers", "level"])
def test_damaged_input_is_refused_before_anything_is_created(levels, damage):
    if damage == "figures":
        levels.collection[FIGURES] = "{}"
    elif damage == "answers":
        bpy.context.scene[ANSWERS] = "{}"
    else:
        bpy.data.objects.remove(levels.levels.pop())
    with pytest.raises(FarfieldError):
        CalibrationRun(bpy.context.scene, levels, 67.0)
    assert not temporary()


def test_an_orthographic_viewer_is_refused(levels):
    run = CalibrationRun(bpy.context.scene, levels, 67.0)
    with pytest.raises(SettingsError, match="perspective"):
        run.place(VIEW, Camera(np.zeros(3), 1000, 0.0, 5.0), (1000, 700), 0.1, 0.0)
    run.close()


def test_answers_become_settings_and_are_exchanged_as_files(run, tmp_path):
    for _ in range(30):
        place(run)
        is_noticed = FRACTIONS[run.trial.level - 1] > 0.1
        for _ in range(4):
            press(run, "WHEELDOWNMOUSE" if is_noticed else "WHEELUPMOUSE")
        run.distance *= 1.0 if is_noticed else 0.9
        press(run, "RET")
    calibration.end_calibration()
    assert bpy.ops.farfield.texmesh_use_threshold() == {"FINISHED"}
    assert 0.09 < bpy.context.scene.farfield_texmesh.weber_threshold < 0.16
    records = read_answers(bpy.context.scene[ANSWERS])
    ratios = [record.answer.accepted_distance / record.expected_distance for record in records]
    assert bpy.context.scene.farfield_texmesh.distance_factor == pytest.approx(np.clip(np.median(ratios), 0.1, 10.0))
    for _ in range(2):  # the same answers count once
        assert bpy.ops.farfield.texmesh_save_answers(filepath=str(tmp_path / "answers.json")) == {"FINISHED"}
        assert bpy.ops.farfield.texmesh_add_answers(filepath=str(tmp_path / "answers.json")) == {"FINISHED"}
        assert read_answers(bpy.context.scene[ANSWERS]) == records
    assert bpy.ops.farfield.texmesh_clear_answers() == {"FINISHED"} and ANSWERS not in bpy.context.scene
    for operator in (bpy.ops.farfield.texmesh_use_threshold, bpy.ops.farfield.texmesh_clear_answers):
        assert not operator.poll()


def test_without_a_window_there_is_no_judge(levels):
    bpy.context.view_layer.objects.active = levels.levels[0]
    with pytest.raises(RuntimeError, match="needs a judge"):
        bpy.ops.farfield.texmesh_calibrate("INVOKE_DEFAULT")
    bpy.context.view_layer.objects.active = None
    with pytest.raises(RuntimeError, match="Make levels first"):
        bpy.ops.farfield.texmesh_calibrate()


def test_damaged_answers_can_be_cleared(levels):
    bpy.context.scene[ANSWERS] = 5
    with pytest.raises(RuntimeError, match="clear them"):
        bpy.ops.farfield.texmesh_use_threshold()
    assert bpy.ops.farfield.texmesh_clear_answers() == {"FINISHED"}
