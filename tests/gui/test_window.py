"""The button in a real window: a tree, the bar, Esc, a finished cloud, undo."""

import pytest

from gui.visits import findings_of

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    """What a visitor who builds a cloud saw; see drive.py."""
    return findings_of("drive.py", tmp_path_factory)


def test_the_visit_went_through(seen):
    assert seen["error"] is None, seen["error"]


def test_the_bar_moved_forwards(seen):
    fractions = seen["fractions"]
    assert len(set(fractions)) >= 3
    assert fractions == sorted(fractions) and fractions[0] >= 0.0 and fractions[-1] <= 1.0


@pytest.mark.parametrize("half", ["core", "scene"])
def test_esc_stopped_the_job_with_the_scene_as_it_was(seen, half):
    stopped = seen["stopped"][half]
    assert stopped["running"], "the job had ended before Esc was pressed"
    assert 0.0 < stopped["fractions"][-1] < 1.0
    assert stopped["after"] == seen["before"]


def test_the_finished_job_left_a_cloud_in_levels(seen):
    assert seen["levels"] == ["Tree Cloud L0", "Tree Cloud L1", "Tree Cloud L2"]


def test_levels_and_original_fade_and_one_undo_ends_it(seen):
    assert seen["fading"] == ["Tree Cloud L0", "Tree Cloud L1", "Tree Cloud L2", "Tree Cloud Tree"]
    assert seen["after_fading"]["objects"] == seen["built"]["objects"]


def test_one_undo_takes_all_of_it_back(seen):
    assert seen["after_undo"]["objects"] == seen["before"]["objects"]
    assert seen["after_undo"]["collections"] == seen["before"]["collections"]
