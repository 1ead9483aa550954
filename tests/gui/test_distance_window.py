"""Making a scene distance-ready in a real window: the analysis, progress, Esc, the originals, and undo."""

import json

import pytest

from gui.session_runner import assert_progress, run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_distance.py."""
    return run_gui_session("session_distance.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_the_analysis_lists_both_balls(results):
    assert results["analysis"] == [[1, "build"], [2, "build"]]


def test_esc_leaves_the_scene_unchanged(results):
    assert results["was_running"], "the build had ended before Esc was pressed"
    assert results["cancelled"]["modifiers"] == [0, 0, 0] and results["scenes"] == ["Scene"]
    assert set(results["cancelled"]["objects"]) <= set(results["before"]["objects"])


def test_all_places_show_levels(results):
    assert_progress(results["fractions"])
    assert results["modifiers"] == [1, 1, 1] and len(results["chains"]) == 2
    assert len(results["instances"]) == 3 and any(not name.endswith("Level 0") for name in results["instances"])


def test_the_button_shows_the_originals(results):
    assert results["originals"] == []


def test_esc_cancels_a_measurement_during_a_render(results):
    assert 0.0 < results["fraction_at_esc"] < 0.5, "Esc was not pressed during the first of the two renders"
    assert results["figures_of_cancelled"] == ""


def test_a_measurement_shows_its_figures_and_leaves_the_levels(results):
    assert set(json.loads(results["figures"])) == {"frames", "flip", "originals", "levels"}
    assert results["instances_after"] == results["instances"]


def test_follow_view_shows_the_far_ball_from_near_until_it_is_switched_off(results):
    assert results["far"] == results["not_followed"] != results["followed"]
    originals = [sum(name.endswith("Level 0") for name in results[key]) for key in ("far", "followed")]
    assert originals == [2, 1], "two balls are near the camera, and one is near the viewer"


def test_undo_removes_the_modifiers(results):
    assert results["after_undo"] == [0, 0, 0]
