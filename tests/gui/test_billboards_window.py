"""The Build button in a real window: progress, Esc, a finished cloud, undo."""

import pytest

from gui.session_runner import assert_progress, run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_billboards.py."""
    return run_gui_session("session_billboards.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_the_progress_increases(results):
    assert_progress(results["fractions"])


@pytest.mark.parametrize("half", ["core", "scene"])
def test_esc_cancels_the_job_and_leaves_the_scene_unchanged(results, half):
    cancelled = results["cancelled"][half]
    assert cancelled["was_running"], "the job had ended before Esc was pressed"
    assert 0.0 < cancelled["fractions"][-1] < 1.0
    assert cancelled["after"] == results["before"]


def test_the_finished_job_creates_a_cloud_with_levels(results):
    assert results["levels"] == ["Tree Cloud L0", "Tree Cloud L1", "Tree Cloud L2"]


def test_the_message_says_how_to_look_at_the_cloud(results):
    assert results["sentences"][0].startswith("Built ") and "Material Preview" in results["sentences"][1]


def test_one_undo_reverts_show_original(results):
    assert "Tree" not in results["visible"]["built"] and "Tree Cloud L0" in results["visible"]["built"]
    assert results["visible"]["original"] == ["Tree"]
    assert results["visible"]["undone"] == results["visible"]["built"]


def test_levels_and_source_crossfade_and_one_undo_reverts_it(results):
    assert results["crossfading"] == ["Tree Cloud L0", "Tree Cloud L1", "Tree Cloud L2", "Tree Cloud Tree"]
    assert results["after_undo_of_crossfade"]["objects"] == results["built"]["objects"]


def test_one_undo_reverts_the_build(results):
    assert results["after_undo_of_build"]["objects"] == results["before"]["objects"]
    assert results["after_undo_of_build"]["collections"] == results["before"]["collections"]
