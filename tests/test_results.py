"""The latest result of a tool: one sentence in the status bar and on its panel, the others under Details."""

from unittest.mock import MagicMock

import bpy
import pytest

from farfield.addon.core.messages import format_number, split_sentences
from farfield.addon.operators.results import STATUS_CHARS, read_result, report_result, store_result, tool_of
from farfield.addon.panels.results import PANEL_CHARS, draw_result

pytestmark = pytest.mark.usefixtures("empty_scene", "coarse_packing")


class Operator:
    """Has the parts of a Blender operator that reports use."""

    def __init__(self) -> None:
        self.reports: list[str] = []

    def report(self, _types: set[str], message: str) -> None:
        self.reports.append(message)


def test_a_short_result_is_reported_once():
    operator = Operator()
    report_result(operator, "Made 3 levels.")
    assert operator.reports == ["Made 3 levels."]


def test_a_long_result_has_its_first_sentence_in_the_status_bar_and_the_number_of_others():
    operator, long = Operator(), f"Made 3 levels. {'A' * STATUS_CHARS}. Nothing else."
    report_result(operator, long)
    assert operator.reports == [long, "Made 3 levels. 2 more under Details."]


def test_each_tool_has_its_own_result_and_undo_takes_it_away():
    scene = bpy.context.scene
    bpy.ops.ed.undo_push(message="before")
    store_result(scene, "billboards", 'Built "Rock No. 5".\nEmission is left out.')
    bpy.ops.ed.undo_push(message="after")
    assert read_result(scene, "billboards") == ['Built "Rock No. 5".', "Emission is left out."]
    assert read_result(scene, "btf") == []
    bpy.ops.ed.undo()
    assert read_result(bpy.context.scene, "billboards") == []


def test_a_panel_shows_the_first_sentences_and_a_button_for_the_others():
    store_result(bpy.context.scene, "bdam", f"7% are holes. The camera shows nothing beyond 1 km. {'A' * PANEL_CHARS}. Nothing else.")
    panel = MagicMock(page="bdam")
    column = panel.layout.box.return_value.column.return_value
    draw_result(panel, bpy.context)
    lines = [call.kwargs["text"] for call in column.column.return_value.label.call_args_list]
    assert " ".join(lines) == "7% are holes. The camera shows nothing beyond 1 km."
    assert column.operator.call_args.kwargs["text"] == "Details (2 more)"


def test_an_operator_stores_the_result_of_its_job():
    bpy.ops.farfield.clipbox_create(terrain="sine", boxes=1, resolution=32)
    (sentence,) = read_result(bpy.context.scene, "clipbox")
    assert sentence.startswith('"Clip-Box Terrain": ') and sentence.endswith(" triangles in 1 box.")


def test_tools_are_found_by_operators():
    assert [tool_of(name) for name in ("farfield.unwrap", "farfield.bdam_build")] == ["unwrap", "bdam"]


def test_sentences_end_outside_of_names():
    assert split_sentences('"No. 5 A" has 1.5 m. 2 objects have levels.') == ['"No. 5 A" has 1.5 m.', "2 objects have levels."]
    assert split_sentences("") == [""]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.000123, "0.000123"), (45.3, "45.3"), (45.0, "45"), (3390.4, "3,390"), (1.02e7, "10,200,000"), (-2.5, "-2.5")],
)
def test_numbers_have_no_exponent(value, text):
    assert format_number(value) == text
