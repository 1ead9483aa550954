"""Presets and results in a real window."""

import json

import pytest

from farfield.addon.core.presets import list_presets
from farfield.addon.operators.documentation import ROOT
from gui.session_runner import run_gui_session

pytestmark = pytest.mark.gui
BUILT_IN = ROOT / "addon" / "presets" / "clipbox"
SMALL_WINDOW = 1280, 720


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict:
    """The results of session_presets.py."""
    return run_gui_session("session_presets.py", tmp_path_factory, SMALL_WINDOW)


def test_the_session_ran_to_its_end(results):
    assert results["error"] is None, results["error"]


def test_a_preset_is_one_undo_step(results):
    assert (results["applied"], results["undone"], results["redone"]) == ("islands", "mesas", "islands")


def test_the_panel_shows_a_preset_while_the_menu_is_open(results):
    assert results["by_name"] == ["canyon", "canyon"]


def test_a_preset_is_chosen_by_its_picture(results):
    second = list_presets(BUILT_IN)[1]
    terrain = json.loads(second.read_text(encoding="utf-8"))["settings"]["terrain"]
    assert results["by_picture"] == {"terrain": terrain, "name": second.stem} and results["by_picture_undone"] == "islands"


def test_a_new_terrain_is_within_the_clipping_range_and_reported(results):
    assert results["clip_end"] > 20_000.0 > results["clip_end_before"]
    first, reach, colors = results["sentences"]
    assert "triangles" in first and "raise Clip End" in reach and "Material Preview" in colors


def test_preferences_are_those_of_the_extension(results):
    assert results["processes"] == 0
