"""Photo textures in a real window: the file browser, overlays, coverage, progress, Esc, the texture, and undo."""

import pytest

from gui.session_runner import assert_progress, run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_photos.py."""
    return run_gui_session("session_photos.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_the_file_browser_imports_cameras_without_loading_photographs(results):
    assert results["browser_opened"] and results["cameras"] == [str(index) for index in range(5)]
    assert results["loaded"] == []


def test_esc_while_overlays_of_an_import_are_drawn_says_that_the_cameras_stay(results):
    message = "Cancelled; no overlay was drawn. The imported cameras stay."
    assert results["overlays_cancelled"] == [[message], 5, []]


def test_overlays_follow_the_import(results):
    assert results["overlays"] == [f"{index}.png Overlay" for index in range(5)]


def test_the_button_toggles_the_coverage(results):
    assert results["coverage_shown"] and results["coverage_hidden"]


def test_the_mesh_stays_selected(results):
    assert results["selected"] == ["Wall"]


def test_esc_leaves_the_scene_unchanged(results):
    assert results["was_running"], "the merge had ended before Esc was pressed"
    assert results["cancelled"] == results["before"]


def test_the_progress_increases_and_the_texture_is_right(results):
    assert_progress(results["fractions"])
    assert results["uv_maps"] == ["Unwrap"] and results["error_of_texture"] < 0.02


def test_one_undo_removes_texture_and_uv_map(results):
    assert results["after_undo"] == results["before"]
