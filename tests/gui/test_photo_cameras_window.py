"""Blender draws the background images of cameras where Farfield projects the scene to."""

import pytest

from gui.session_runner import NARROW_WINDOW, run_gui_session

pytestmark = pytest.mark.gui
NAMES = [
    *("default", "stretch", "crop", "wide sensor", "high sensor", "portrait", "portrait, crop", "rotated", "rotated, stretch", "flipped"),
    *("flipped twice", "wide pixels", "scaled camera"),
]


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_photo_cameras.py."""
    return run_gui_session("session_photo_cameras.py", tmp_path_factory, NARROW_WINDOW)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]
    assert set(results) == {"error", *NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_marks_lie_on_the_dots_of_the_photograph(results, name):
    assert min(results[name]["dots"], results[name]["marks"]) >= 38
    assert 0.0 <= results[name]["distance"] < 1.0, "in pixels of the screen"
