"""Unwrapping in a real window: progress, Esc, the stretch overlay, and undo."""

import pytest

from gui.session_runner import assert_progress, run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_unwrap.py."""
    return run_gui_session("session_unwrap.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_esc_leaves_the_scene_unchanged(results):
    assert results["was_running"], "the unwrap had ended before Esc was pressed"
    assert results["cancelled"] == {"after": results["before"], "uv_maps": []}


def test_the_progress_increases_and_the_uv_map_is_valid(results):
    assert_progress(results["fractions"])
    assert results["uv_maps"] == ["Unwrap"]
    assert results["metrics"]["flips"] == results["metrics"]["overlaps"] == 0 and results["metrics"]["l2"] < 1.3


def test_the_button_toggles_the_stretch_overlay(results):
    assert results["overlay_shown"] and results["overlay_hidden"]


def test_the_uv_editor_has_the_panel(results):
    assert results["category"] == "Farfield"


def test_one_undo_removes_the_uv_map(results):
    assert results["uv_maps_after_undo"] == []
