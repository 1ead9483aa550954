"""Unwrapping in a real window: the bar moves, Esc leaves all as it was, stretch is drawn, and one undo takes the map back."""

import pytest

from gui.visits import findings_of

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    """What a visitor who unwraps a ball saw; see drive_unwrap.py."""
    return findings_of("drive_unwrap.py", tmp_path_factory)


def test_the_visit_went_through(seen):
    assert seen["error"] is None, seen["error"]


def test_esc_leaves_everything_as_it_was(seen):
    assert seen["running"], "the unwrap had ended before Esc was pressed"
    assert seen["stopped"] == {"after": seen["before"], "maps": []}


def test_the_bar_moves_and_the_map_is_sound(seen):
    assert seen["fractions"] == sorted(seen["fractions"]) and len(set(seen["fractions"])) > 3
    assert seen["maps"] == ["Unwrap"]
    assert seen["figures"]["flips"] == seen["figures"]["overlaps"] == 0 and seen["figures"]["l2"] < 1.3


def test_stretch_is_switched_on_and_off_by_its_button(seen):
    assert seen["shown"] and seen["hidden"]


def test_one_undo_takes_the_map_back(seen):
    assert seen["undone"] == []
