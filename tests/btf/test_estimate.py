"""The estimated time of a bake grows with its work, and the estimated sizes are those of the arrays."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.btf.estimate import LevelExtent, estimate_bake, image_resolution
from farfield.addon.core.btf.factorization.factors import Factors
from farfield.addon.core.btf.reflectance.lobes import Lobes, TexelSurface
from farfield.addon.core.btf.reflectance.shadows import Shadows
from farfield.addon.core.btf.settings import BtfSettings

SETTINGS = BtfSettings(model="emission", views_per_side=3, lights_per_side=4, components=5, alpha_components=3, refine=False)
LEVEL = LevelExtent(texels=1000, resolution=40)


def test_sizes_are_those_of_the_arrays():
    estimated = estimate_bake([LEVEL], SETTINGS, 1)
    known = np.ones(1000, bool)
    color = Factors(np.zeros((1000, 5)), np.zeros((9, 5, 3 * 17)), known)
    alpha = Factors(np.zeros((1000, 3)), np.zeros((9, 3, 1)), known)
    components = SETTINGS.shadow_components
    angles = Factors(np.zeros((1000, components)), np.zeros((SETTINGS.shadow_count, components, 1)), known)
    colors, scalars = np.zeros((1000, 3)), np.zeros(1000)
    shadows = Shadows(SETTINGS.shadow_grid, angles)
    lobes = Lobes(TexelSurface(colors, scalars), colors, colors, scalars, shadows, sky_visibility=scalars)
    assert estimated.final_bytes == color.nbytes + alpha.nbytes + lobes.nbytes + 2 * 3 * 1000
    assert estimated.raw_bytes == 2 * 3 * 1000 * 9 * 17
    assert estimated.renders == 9 * 17


@pytest.mark.parametrize(
    "changes",
    [{"views_per_side": 4}, {"lights_per_side": 5}, {"samples": 8}, {"components": 9}, {"shadows_per_side": 32}, {"refine": True}],
    ids=lambda changes: next(iter(changes)),
)
def test_more_work_takes_longer(changes):
    assert estimate_bake([LEVEL], replace(SETTINGS, **changes), 1).seconds > estimate_bake([LEVEL], SETTINGS, 1).seconds


@pytest.mark.parametrize("changes", [{"views_per_side": 4}, {"samples": 8}, {"refine": True}], ids=lambda changes: next(iter(changes)))
def test_more_work_takes_longer_without_lights_too(changes):
    settings = replace(SETTINGS, model="surface")
    assert estimate_bake([LEVEL], replace(settings, **changes), 1).seconds > estimate_bake([LEVEL], settings, 1).seconds


def test_without_lights_a_bake_is_views_only():
    settings = replace(SETTINGS, model="surface")
    estimated, emission = (estimate_bake([LEVEL], values, 1) for values in (settings, SETTINGS))
    assert estimated.renders == 2 * settings.view_count
    assert estimated.final_bytes == 2 * (3 * 1000 + 3 * settings.view_count)
    assert estimated.seconds < emission.seconds
    assert estimated == estimate_bake([LEVEL], replace(settings, lights_per_side=8, components=40, shadows_per_side=30), 1)


def test_time_depends_on_levels_workers_and_pace():
    single = estimate_bake([LEVEL], SETTINGS, 1)
    assert estimate_bake([LEVEL, LEVEL], SETTINGS, 1).renders == 2 * single.renders
    assert estimate_bake([LEVEL], SETTINGS, 2).seconds < single.seconds
    assert estimate_bake([LEVEL], SETTINGS, 1, pace=2.0).seconds == pytest.approx(2.0 * single.seconds)


def test_images_contain_the_sphere():
    assert image_resolution(10.0, 0.5) == 42
