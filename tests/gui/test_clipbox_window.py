"""Terrain in a real window: the bar moves, Esc leaves all as it was, the ground follows the view, and undo takes freezing back."""

import pytest

from gui.visits import findings_of

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    """What a visitor who flies over terrain saw; see drive_clipbox.py."""
    return findings_of("drive_clipbox.py", tmp_path_factory)


def test_the_visit_went_through(seen):
    assert seen["error"] is None, seen["error"]


def test_esc_leaves_everything_as_it_was(seen):
    assert seen["running"], "the terrain was made before Esc was pressed"
    assert seen["stopped"] == {"after": seen["before"], "terrains": []}


def test_the_bar_moves_and_a_terrain_stands(seen):
    assert seen["fractions"] == sorted(seen["fractions"]) and len(set(seen["fractions"])) > 2
    assert len(seen["made"]) == 1 and seen["active"] == seen["made"][0]


def test_it_follows_the_view_until_esc(seen):
    assert seen["follows"] and seen["follows_after_esc"] == 0
    assert seen["moves"] > 1 and seen["last_place"] != seen["first_place"]
    assert seen["distance_to_eye"] < 8.0


def test_it_is_frozen_and_undo_brings_it_back(seen):
    assert seen["frozen"] == ["Ground"] and seen["terrains_after_freeze"] == []
    assert seen["terrains_after_undo"] == seen["made"]
