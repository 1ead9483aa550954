"""Baking in a real window: workers render while the window is free, Esc stops them, Resume goes on from what stands."""

import pytest

from gui.visits import findings_of

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    """What a visitor who bakes a cloud saw; see drive_bake.py."""
    return findings_of("drive_bake.py", tmp_path_factory)


def test_the_visit_went_through(seen):
    assert seen["error"] is None, seen["error"]


def test_the_window_is_free_while_workers_render(seen):
    assert seen["running"], "the bake had ended before Esc was pressed"
    assert seen["view_turned"]
    assert seen["label"].startswith("View ") and seen["label"].endswith(" of 16")


def test_esc_leaves_the_scene_as_it_was_and_the_views_that_stand(seen):
    assert seen["stopped"]["after"] == seen["before"]
    assert 5 <= seen["stopped"]["views"] < 16


def test_resume_keeps_them_and_bakes_the_rest(seen):
    assert seen["kept"] and seen["most"] == 16
    assert seen["materials"] == ["Tree Cloud L0 BTF"]
    assert seen["left"] == 0, "finished views stay when the bake is done"
