"""What a bake is said to take grows with what it has to do, and its sizes are those of the arrays."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.btf.estimate import LevelExtent, estimate, side_of
from farfield.addon.core.btf.factors import Factors
from farfield.addon.core.btf.lobes import Lobes, Surface
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.btf.shadows import Shadows

SETTINGS = BtfSettings(views=9, lights=16, components=5, alpha_components=3, refine=False)
LEVEL = LevelExtent(texels=1000, side=40)


def test_sizes_are_those_of_the_arrays():
    said = estimate([LEVEL], SETTINGS, 1)
    known = np.ones(1000, bool)
    colour = Factors(np.zeros((1000, 5)), np.zeros((9, 5, 3 * 17)), known)
    alpha = Factors(np.zeros((1000, 3)), np.zeros((9, 3, 1)), known)
    shadows = Shadows(
        SETTINGS.shadow_grid,
        Factors(np.zeros((1000, SETTINGS.shadow_components)), np.zeros((SETTINGS.shadows, SETTINGS.shadow_components, 1)), known),
    )
    colours, numbers = np.zeros((1000, 3)), np.zeros(1000)
    lobes = Lobes(Surface(colours, numbers), colours, colours, numbers, shadows, openness=numbers)
    assert said.final_bytes == colour.bytes + alpha.bytes + lobes.bytes + 2 * 3 * 1000
    assert said.raw_bytes == 2 * 3 * 1000 * 9 * 17
    assert said.renders == 9 * 17


@pytest.mark.parametrize(
    "more",
    [{"views": 16}, {"lights": 25}, {"samples": 8}, {"components": 9}, {"shadows": 1024}, {"refine": True}],
    ids=lambda more: next(iter(more)),
)
def test_more_to_do_takes_longer(more):
    assert estimate([LEVEL], replace(SETTINGS, **more), 1).seconds > estimate([LEVEL], SETTINGS, 1).seconds


def test_levels_workers_and_pace_count():
    alone = estimate([LEVEL], SETTINGS, 1)
    assert estimate([LEVEL, LEVEL], SETTINGS, 1).renders == 2 * alone.renders
    assert estimate([LEVEL], SETTINGS, 2).seconds < alone.seconds
    assert estimate([LEVEL], SETTINGS, 1, pace=2.0).seconds == pytest.approx(2.0 * alone.seconds)


def test_a_picture_holds_all_within_reach():
    assert side_of(10.0, 0.5) == 42
