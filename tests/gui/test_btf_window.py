"""Baking in a real window: it responds while workers render, Esc cancels them, and the next bake resumes from the finished views."""

import pytest

from gui.session_runner import run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_btf.py."""
    return run_gui_session("session_btf.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_the_window_responds_while_workers_render(results):
    assert results["was_running"], "the bake had ended before Esc was pressed"
    assert results["view_rotated"]
    assert results["label"].startswith("View ") and results["label"].endswith(" of 16")


def test_esc_leaves_the_scene_unchanged_and_keeps_finished_views(results):
    assert results["cancelled"]["after"] == results["before"]
    assert 3 <= results["cancelled"]["views"] < 16


def test_the_next_bake_keeps_them_and_renders_the_rest(results):
    assert results["kept"] and results["max_views"] == 16
    assert results["materials"] == ["Tree Cloud L0 BTF"]
    assert results["remaining_views"] == 0, "finished views are not removed after the bake"
