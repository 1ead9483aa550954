"""Zones of the step function, the choice of levels, and the physical check of scales that are dropped."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.directions import fibonacci_sphere
from farfield.addon.core.imaging.mipmaps import build_mipmaps
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_choices import (
    CHOICES,
    RANGE_MARGIN,
    LevelBudget,
    LevelOption,
    choose_levels,
    find_major_scales,
    find_red_refinements,
    find_zones,
    keep_visible_scales,
)
from farfield.addon.core.texmesh.perception import views
from farfield.addon.core.texmesh.perception.level_images import LevelImages
from farfield.addon.core.texmesh.perception.switch_distances import SwitchCheck, find_switches
from farfield.addon.core.texmesh.settings import LEVELS, TexmeshSettings
from textured_levels import checkered, textured_sphere

#  scale                0    1    2    3    4    5    6    7
DISTANCES = np.array([0.0, 1.0, 1.0, 1.0, 5.0, 9.0, 9.1, 9.2])
RED = np.array([True, False, False, True, True, False, False])
FLAGS = st.lists(st.booleans(), min_size=1, max_size=20).map(np.array)


def test_steep_parts_are_red_and_flat_parts_are_green():
    assert np.array_equal(find_red_refinements(DISTANCES), RED)


def test_the_coarsest_scale_of_a_green_zone_is_taken_and_every_scale_of_a_red_one():
    assert find_zones(RED) == [(0, 0), (1, 3), (4, 4), (5, 7)]
    assert find_major_scales(RED).tolist() == [0, 3, 3, 3, 4, 7, 7, 7]


@given(FLAGS)
def test_zones_divide_the_scales_and_majors_are_their_own(is_red):
    zones = find_zones(is_red)
    assert [scale for start, end in zones for scale in range(start, end + 1)] == list(range(len(is_red) + 1))
    majors = find_major_scales(is_red)
    assert (majors[majors] == majors).all() and (majors >= np.arange(len(majors))).all() and len(zones) == is_red.sum() + 1


@given(FLAGS, st.integers(0, 20))
def test_the_physical_check_only_adds_red_refinements_and_checks_every_dropped_scale(is_red, reach):
    def looks_same(fine: int, coarse: int) -> bool:
        return coarse - fine <= reach

    checked = keep_visible_scales(is_red, looks_same)
    assert (checked >= is_red).all()
    majors = find_major_scales(checked)
    assert all(looks_same(scale, major) for scale, major in enumerate(majors))
    assert np.array_equal(keep_visible_scales(is_red, lambda *_: True), is_red)


def test_unusable_distances_are_refused():
    for distances in ([1.0, 0.5], [np.nan, 1.0], [-1.0, 1.0], []):
        with pytest.raises(SettingsError, match="distances"):
            find_red_refinements(np.array(distances))


def test_flip_tells_which_scales_can_be_dropped():
    settings = TexmeshSettings(views=2, max_image=64)
    meshes = [textured_sphere(count) for count in (20, 18, 4)]
    frame = views.frame_around(meshes[0].vertices)
    textures = [build_mipmaps(checkered())]
    surfaces = [views.prepare_surface(mesh, textures) for mesh in meshes]
    images = [LevelImages(surface, frame, fibonacci_sphere(2), settings.pixels_per_degree) for surface in surfaces]
    sizes = [switch.pixel_size for switch in run_to_end(find_switches(images, settings))]
    check = SwitchCheck(images, [0.0, *sizes], settings)
    assert check(0, 1) and not check(0, 2) and not check(1, 2)
    assert keep_visible_scales(np.array([False, False]), check).tolist() == [False, True]


def options(count: int = 7) -> list[LevelOption]:
    return [
        LevelOption(1000 // 2**index + 1, 50 * (1000 // 2**index) + 900, 0.0 if index == 0 else 0.01 * 1.7**index) for index in range(count)
    ]


def mean_triangles(chosen: list[int], levels: list[LevelOption]) -> float:
    """Triangles averaged over the logarithm of the distance."""
    sizes = [level.pixel_size for level in levels]
    logs = [math.log(max(size, sizes[1] / RANGE_MARGIN)) for size in sizes]
    ends = [logs[index] for index in chosen[1:]] + [math.log(RANGE_MARGIN * sizes[-1])]
    return sum(levels[index].triangles * (end - logs[index]) for index, end in zip(chosen, ends, strict=True))


@pytest.mark.parametrize(
    "budget", [LevelBudget(), LevelBudget(count=3), LevelBudget(triangles=1500), LevelBudget(byte_count=80_000, count=4)]
)
def test_the_choice_is_the_best_of_all(budget):
    levels = options()
    chosen = choose_levels(levels, budget)
    allowed = []
    for size in range(1, len(levels) + 1):
        for rest in itertools.combinations(range(1, len(levels)), size - 1):
            candidate = [0, *rest]
            fits = (
                (budget.count is None or size <= budget.count)
                and (budget.triangles is None or sum(levels[index].triangles for index in candidate) <= budget.triangles)
                and (budget.byte_count is None or sum(levels[index].byte_count for index in candidate) <= budget.byte_count)
            )
            allowed += [candidate] if fits else []
    assert chosen in allowed and mean_triangles(chosen, levels) <= min(mean_triangles(item, levels) for item in allowed) * (1.0 + 1e-9)


def test_every_choice_of_levels_has_a_function():
    assert set(CHOICES) == set(LEVELS)


def test_limits_of_the_choice():
    levels = options()
    assert choose_levels(levels, LevelBudget(count=1)) == [0]
    assert choose_levels(levels, LevelBudget(triangles=300))[0] == 2  # the finest that fits
    with pytest.raises(SettingsError, match="increase it"):
        choose_levels(levels, LevelBudget(triangles=3))
    with pytest.raises(SettingsError, match="grow"):
        choose_levels(levels[::-1], LevelBudget())
    with pytest.raises(SettingsError, match="at least one"):
        choose_levels(levels, LevelBudget(count=0))
