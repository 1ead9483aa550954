"""Perceptual levels in a real window: features, preview, flicker and calibration."""

import pytest

from gui.session_runner import assert_progress, run_gui_session

pytestmark = pytest.mark.gui
TALL_WINDOW = 1400, 1200  # in which the open sub-panels fit
LEVELS = ["Ball L0", "Ball L1", "Ball L2", "Ball L3"]


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_texmesh.py."""
    return run_gui_session("session_texmesh.py", tmp_path_factory, TALL_WINDOW)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_features_are_shown(results):
    assert results["overlay_shown"]


def test_levels_are_made_and_cross_fade(results):
    assert results["levels"] == LEVELS == results["crossfading"]
    assert_progress(results["fractions"])


def test_one_level_shows_in_all_views_after_the_run(results):
    assert list(results["after_run"]) == ["RENDERED", "MATERIAL", "SOLID"]
    shown = {tuple(names) for names in results["after_run"].values()}
    assert len(shown) == 1 and {*shown.pop()} < {*LEVELS}


def test_undo_shows_the_original_and_redo_one_level_again(results):
    assert results["undone"] == ["Ball"]
    assert results["redone"] == results["after_run"]["SOLID"]


def test_a_chosen_level_shows_although_the_preview_has_started(results):
    assert len(results["chosen"]) == 1 and {*results["chosen"]} < {*LEVELS}
    assert results["chosen"] != results["after_run"]["SOLID"]


def test_the_preview_shows_one_level_by_distance(results):
    assert all(len(names) == 1 for names in results["preview"])
    shown = [names[0] for names in results["preview"]]
    assert shown == sorted(shown) and len(set(shown)) > 1


def test_flicker_alternates_and_ends_with_esc(results):
    assert len(results["flicker"]) == 2
    assert not results["flickers_after_esc"] and results["follows_after_esc"]


def test_everything_is_visible_again_afterwards(results):
    assert results["after_preview"] == LEVELS and results["rings_hidden"]


def test_the_calibration_records_answers_and_leaves_nothing_else(results):
    assert results["calibrating"] and results["after_calibration"] and results["overlays_again"]
    assert (results["perspective_of_calibration"], results["perspective_afterwards"]) == ("PERSP", "ORTHO")
    assert len(results["preview_after_calibration"]) == 1
    nearer, farther = results["answers"]
    assert nearer["accepted_distance"] <= nearer["start_distance"] and farther["accepted_distance"] > farther["start_distance"]
