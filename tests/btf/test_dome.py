"""What a dome makes of lobes is found again: how open texels are, and how bright their rim is."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.btf.dome import under_dome
from farfield.addon.core.btf.lobes import SCHLICK, Grazing
from farfield.addon.core.direction_grids import DirectionGrid
from farfield.addon.core.progress import finish
from known_views import Known
from made_atlases import made_lobes

VIEWS, ROWS = DirectionGrid(6), 40


@pytest.mark.parametrize("grazing", [Grazing(0.5, 2.0), Grazing(1.5, 4.0)], ids=["broad", "narrow"])
def test_openness_and_rim_are_found_again(grazing):
    lobes = made_lobes(ROWS)
    count = len(lobes.rim)
    # Dim enough to stay below white, at which what is seen is cut.
    shining = replace(lobes, diffuse=0.4 * lobes.diffuse + 0.05, specular=0.4 * lobes.specular, rim=np.full(count, 0.2, np.float32))
    openness = np.linspace(0.6, 1.2, count).astype(np.float32)
    truth = replace(shining, openness=openness, grazing=grazing)
    views = [Known(np.arange(count), truth.of_dome(direction)) for direction in VIEWS.directions]
    guess = replace(shining, openness=openness)
    found = finish(under_dome(views, guess, VIEWS, np.ones((len(VIEWS), count), np.float32)))
    assert found.grazing.power == grazing.power
    assert found.grazing.strength == pytest.approx(grazing.strength, rel=0.02)
    np.testing.assert_allclose(found.openness, openness, rtol=0.03)


def test_without_rims_the_shape_is_that_of_suns():
    lobes = replace(made_lobes(ROWS), rim=np.zeros(len(made_lobes(ROWS).rim), np.float32))
    views = [Known(np.arange(len(lobes.rim)), lobes.of_dome(direction)) for direction in VIEWS.directions]
    found = finish(under_dome(views, lobes, VIEWS, np.ones((len(VIEWS), len(lobes.rim)), np.float32)))
    assert found.grazing == SCHLICK
