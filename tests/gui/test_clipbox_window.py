"""Terrain in a real window: progress, Esc, following the view, conversion to meshes, undo."""

import pytest

from gui.session_runner import assert_progress, run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_clipbox.py."""
    return run_gui_session("session_clipbox.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_esc_leaves_the_scene_unchanged(results):
    assert results["was_running"], "the terrain was finished before Esc was pressed"
    assert results["cancelled"] == {"after": results["before"], "terrains": []}


def test_the_progress_increases_and_a_terrain_is_created(results):
    assert_progress(results["fractions"])
    assert len(results["terrains"]) == 1 and results["active"] == results["terrains"][0]


def test_it_follows_the_view_until_the_button_is_pressed_again(results):
    assert (results["followings"], results["followings_after_stop"]) == (1, 0)
    assert results["modal_operators"] == [], "Blender would not save automatically"
    assert results["moves_after_undo"] > results["moves"] > 1, "undo does not end it"
    assert results["last_viewer"] != results["first_viewer"]
    assert results["distance_to_view"] < 8.0


def test_it_is_updated_live_and_undo_is_too(results):
    assert results["blocks_after_undo"] > 100 and not results["is_live"]


def test_it_is_converted_and_undo_restores_it(results):
    assert results["converted"] == ["Ground"] and results["terrains_after_conversion"] == []
    assert results["terrains_after_undo"] == results["terrains"]
