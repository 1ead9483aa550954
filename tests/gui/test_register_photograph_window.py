"""Registering a photograph by clicks in a real window: pairs, Esc, Backspace, the camera, and undo."""

import pytest

from gui.session_runner import run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_register_photograph.py."""
    return run_gui_session("session_register_photograph.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_the_panel_says_what_to_open(results):
    texts, _, reason = results["without_view"]
    assert reason == "Open a 3D Viewport next to the Image Editor"
    assert reason in " ".join(texts)


def test_the_button_is_pressed_and_the_panel_says_where_to_click_while_pairs_are_added(results):
    texts = {name: " ".join(results[name][0]) for name in ("idle", "started", "clicked_photograph", "clicked_mesh", "after_esc")}
    assert [results[name][1][0] for name in texts] == [False, True, True, True, False]
    first = "Click a point in the photograph, then the same point on the mesh. Enter: Finish, Esc: Cancel"
    assert first in texts["started"] and first in texts["clicked_mesh"]
    assert "Click the same point on the mesh. Enter" in texts["clicked_photograph"]
    assert "Click" not in texts["idle"] + texts["after_esc"]


def test_the_pressed_button_finishes(results):
    assert results["toggled"] == [True, False]


def test_esc_discards_the_new_pairs(results):
    assert results["pairs_before_esc"] == 1
    assert results["pairs_after_esc"] == 0


def test_clicks_in_any_order_make_pairs_and_backspace_removes_the_last(results):
    assert results["pairs_with_incomplete"] == 13
    assert results["pairs"] == 12
    assert max(results["point_errors"]) < 0.05
    assert max(results["position_errors"]) < 2.0


def test_the_camera_is_where_the_photograph_was_taken(results):
    assert results["cameras"] == ["Aufnahme ü"]
    assert results["distance"] < 0.3
    assert max(results["residuals"]) < 4.0


def test_undo_removes_the_camera_and_keeps_the_pairs(results):
    assert results["cameras_after_undo"] == []
    assert results["pairs_after_undo"] == 12
