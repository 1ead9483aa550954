"""Jobs in a real window end without a defect while their input is deleted or undone, or another file is loaded."""

import pytest

from gui.session_runner import run_gui_session

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_interruptions.py."""
    return run_gui_session("session_interruptions.py", tmp_path_factory)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]
    assert len(results["runs"]) >= 6 * 3


def test_jobs_were_interrupted(results):
    assert sum(run["was_running"] for run in results["runs"]) >= 14, "most jobs had ended before"


def test_all_jobs_end(results):
    assert [run for run in results["runs"] if not run["has_ended"]] == []


def test_previews_that_started_by_themselves_leave_no_state(results):
    previews = results["previews"]
    assert set(previews) == {"delete", "load", "undo"}
    for kind, state in previews.items():
        assert state["had_started"] and len(state["shown"]) == 1, kind
        assert (state["states"], state["defects"]) == (0, 0), kind
    assert previews["undo"]["visible"] == ["Ball"] and not previews["load"]["rings"]


def test_nothing_is_a_defect(results):
    assert {f"{run['job']} {run['interruption']}": run["defects"] for run in results["runs"] if run["defects"]} == {}
