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
