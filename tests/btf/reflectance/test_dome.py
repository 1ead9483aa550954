"""The dome fit recovers sky visibility and Fresnel shape."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.btf.reflectance.lobe_fit import fit_dome
from farfield.addon.core.btf.reflectance.lobes import SCHLICK, GrazingFresnel
from farfield.addon.core.geometry.directions import DirectionGrid
from farfield.addon.core.jobs.progress import run_to_end
from random_textures import random_lobes
from synthetic_views import InMemoryView

VIEWS, ROWS = DirectionGrid(6), 40


@pytest.mark.parametrize("dome_fresnel", [GrazingFresnel(0.5, 2.0), GrazingFresnel(1.5, 4.0)], ids=["broad", "narrow"])
def test_sky_visibility_and_fresnel_shape_are_recovered(dome_fresnel):
    lobes = random_lobes(ROWS)
    count = len(lobes.f90_minus_f0)
    # Dim enough to stay below the radiance at which captured values are clamped.
    dim = replace(lobes, diffuse=0.4 * lobes.diffuse + 0.05, f0=0.4 * lobes.f0, f90_minus_f0=np.full(count, 0.2, np.float32))
    sky_visibility = np.linspace(0.6, 1.2, count).astype(np.float32)
    truth = replace(dim, sky_visibility=sky_visibility, dome_fresnel=dome_fresnel)
    views = [InMemoryView(np.arange(count), truth.radiance_under_dome(direction)) for direction in VIEWS.directions]
    initial = replace(dim, sky_visibility=sky_visibility)
    fitted = run_to_end(fit_dome(views, initial, VIEWS, np.ones((len(VIEWS), count), np.float32)))
    assert fitted.dome_fresnel.power == dome_fresnel.power
    assert fitted.dome_fresnel.strength == pytest.approx(dome_fresnel.strength, rel=0.02)
    np.testing.assert_allclose(fitted.sky_visibility, sky_visibility, rtol=0.03)


def test_without_grazing_reflection_the_shape_is_schlick():
    lobes = random_lobes(ROWS)
    count = len(lobes.f90_minus_f0)
    lobes = replace(lobes, f90_minus_f0=np.zeros(count, np.float32))
    views = [InMemoryView(np.arange(count), lobes.radiance_under_dome(direction)) for direction in VIEWS.directions]
    fitted = run_to_end(fit_dome(views, lobes, VIEWS, np.ones((len(VIEWS), count), np.float32)))
    assert fitted.dome_fresnel == SCHLICK
