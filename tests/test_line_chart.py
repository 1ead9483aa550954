"""Charts show every line, with round numbers around all points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("bpy")

from contact_sheet import PAPER
from line_chart import COLOURS, HEIGHT, WIDTH, line_chart, ticks


@given(st.floats(-1e6, 1e6), st.floats(0.0, 1e6))
def test_ticks_are_round_and_hold_everything(low, span):
    found = ticks(low, low + span)
    steps = np.diff(found)
    assert 2 <= len(found) <= 12
    assert found[0] <= low + 1e-6 * steps[0] and found[-1] >= low + span - 1e-6 * steps[0]
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
    assert round(float(f"{steps[0]:.4e}".split("e")[0]), 3) in {1.0, 2.0, 5.0}


def test_every_line_is_drawn_in_its_colour(extension):
    picture = line_chart("Größe", "x", {"one": [(0.0, 1.0), (1.0, 2.0)], "two": [(0.0, 2.0), (1.0, 1.0)]})
    assert picture.shape == (HEIGHT, WIDTH, 3)
    for colour in COLOURS[:2]:
        assert (np.abs(picture - colour).max(axis=2) < 1e-3).sum() > 300


@pytest.mark.parametrize("points", [[], [(1.0, float("nan"))]])
def test_without_points_there_is_an_empty_chart(extension, points):
    picture = line_chart("Nothing", "x", {"none": points})
    assert picture.shape == (HEIGHT, WIDTH, 3) and (picture == PAPER).mean() > 0.9


def test_a_single_point_is_a_dot(extension):
    assert (np.abs(line_chart("One", "x", {"one": [(3.0, 4.0)]}) - COLOURS[0]).max(axis=2) < 1e-3).sum() > 20
