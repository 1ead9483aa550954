"""Restoring an image in a real window: painting the mask, progress, Esc, the outline, before and after, undo and redo."""

import pytest

from gui.session_runner import NARROW_WINDOW, assert_progress, run_gui_session

pytestmark = pytest.mark.gui
NAME = "Mauer ü"


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_restore.py."""
    return run_gui_session("session_restore.py", tmp_path_factory, NARROW_WINDOW)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_create_mask_opens_it_for_painting(results):
    assert results["mask"] == {"name": f"{NAME} mask", "mode": "PAINT"}


def test_the_brush_is_a_small_part_of_the_image(results):
    assert results["brush"] == pytest.approx(0.04, rel=0.1)


def test_strokes_mark_the_scratch_in_white(results):
    assert results["covered"] > 0.95 and results["painted"] < 0.35


def test_the_outline_follows_the_strokes(results):
    assert results["segments"] > 4


def test_undo_shows_the_mask_in_paint_mode_where_restore_was_pressed_with_it(results):
    result, mask = [f"{NAME} restored", "VIEW"], [f"{NAME} mask", "PAINT"]
    assert results["shown_with_mask"] == [result, mask, result, mask]


def test_esc_leaves_the_file_unchanged(results):
    assert results["was_running"], "the restoration had ended before Esc was pressed"
    assert results["cancelled"] == results["before"]


def test_the_progress_increases_and_the_result_is_shown_and_used(results):
    assert_progress(results["fractions"])
    assert results["shown"] == results["used"] == f"{NAME} restored"


def test_only_the_scratch_has_changed(results):
    assert results["outside_unchanged"] and results["original_unchanged"]
    assert results["scratch"] == pytest.approx(results["wall"], abs=0.1)


def test_before_and_after(results):
    assert (results["after_first_toggle"], results["after_second_toggle"]) == (NAME, f"{NAME} restored")
    assert results["outline_hidden"]


def test_one_undo_removes_the_result(results):
    assert f"{NAME} restored" not in results["after_undo"]["images"] and results["after_undo"]["used"] == NAME


def test_the_editor_shows_the_photograph_after_undo_and_the_result_after_redo(results):
    assert results["after_undo"]["shown"] == NAME
    assert results["after_redo"] == {"shown": f"{NAME} restored", "used": f"{NAME} restored"} and results["same_pixels_after_redo"]


def test_restore_replaces_its_result_and_undo_brings_it_back(results):
    name = f"{NAME} restored"
    assert results["replaced"]["images"].count(name) == 1 and f"{name}.001" not in results["replaced"]["images"]
    assert results["replaced"]["shown"] == results["replaced"]["used"] == name
    assert results["former_is_back"] == {"shown": name, "same": True}


def test_undo_and_redo_step_through_several_results(results):
    first, second = f"{NAME} restored", f"{NAME} restored.001"
    assert results["variants"] == [second, first, NAME, first, second]
