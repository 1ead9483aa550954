"""Charts show every line, with round ticks around all points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("bpy")

from farfield.addon.bridge.overlays.line_chart import COLORS, HEIGHT, PAPER_GRAY, WIDTH, draw_line_chart, round_ticks


@given(st.floats(-1e6, 1e6), st.floats(0.0, 1e6))
def test_ticks_are_round_and_include_the_range(low, span):
    tick_values = round_ticks(low, low + span)
    steps = np.diff(tick_values)
    assert 2 <= len(tick_values) <= 12
    assert tick_values[0] <= low + 1e-6 * steps[0] and tick_values[-1] >= low + span - 1e-6 * steps[0]
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
    assert round(float(f"{steps[0]:.4e}".split("e")[0]), 3) in {1.0, 2.0, 5.0}


def test_every_line_is_drawn_in_its_color(extension):
    image = draw_line_chart("Größe", "x", {"one": [(0.0, 1.0), (1.0, 2.0)], "two": [(0.0, 2.0), (1.0, 1.0)]})
    assert image.shape == (HEIGHT, WIDTH, 3)
    for color in COLORS[:2]:
        assert (np.abs(image - color).max(axis=2) < 1e-3).sum() > 300


@pytest.mark.parametrize("points", [[], [(1.0, float("nan"))]])
def test_without_points_the_chart_is_empty(extension, points):
    image = draw_line_chart("Nothing", "x", {"none": points})
    assert image.shape == (HEIGHT, WIDTH, 3) and (image == PAPER_GRAY).mean() > 0.9


def test_a_single_point_is_a_dot(extension):
    assert (np.abs(draw_line_chart("One", "x", {"one": [(3.0, 4.0)]}) - COLORS[0]).max(axis=2) < 1e-3).sum() > 20
