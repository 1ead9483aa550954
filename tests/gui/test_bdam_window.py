"""Large terrain in a real window: load, follow the view, undo, remove."""

import pytest

from gui.session_runner import run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_bdam.py."""
    return run_gui_session("session_bdam.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_the_terrain_is_loaded_and_framed(results):
    assert 1 <= results["loaded"]["tiles"] <= 64 and results["loaded"]["triangles"] > 0
    assert results["loaded"]["clip_end"] > 2000.0, "it is larger than the clipping range of a new viewport"


def test_it_follows_the_view_until_the_button_is_pressed_again(results):
    assert results["moves"] > 1 and len(set(results["triangles"])) > 1
    assert results["tiles"][0] == results["tiles"][1] <= 64
    assert results["modal_operators"] == [], "Blender would not save automatically"
    assert results["moves_while_standing"] == 0 and results["followings_after_stop"] == 0


def test_undo_does_not_end_it(results):
    assert results["tiles_after_undo"][0] == results["tiles_after_undo"][1] > 0


def test_it_is_removed_and_undo_restores_it(results):
    assert results["after_removal"] == [0, 0] and results["terrains_after_undo"] == 1
