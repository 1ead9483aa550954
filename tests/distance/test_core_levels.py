"""Which candidates become levels."""

import pytest

from farfield.addon.core.distance import LevelCandidate, choose_levels, combine_levels, needs_cloud


def candidates(*numbers: tuple[int, float]) -> list[LevelCandidate]:
    return [LevelCandidate(triangles, size) for triangles, size in numbers]


def test_levels_are_sorted_by_size_and_each_is_lighter():
    given = candidates((1000, 0.0), (900, 0.1), (500, 0.2), (490, 0.4), (100, 0.3), (20, 0.8))
    assert choose_levels(given) == [0, 2, 4, 5]


def test_a_cloud_that_is_no_lighter_is_left_out():
    assert choose_levels(candidates((100, 0.0), (76, 0.5))) == [0]
    assert choose_levels(candidates((100, 0.0), (75, 0.5))) == [0, 1]


def test_objects_together_have_the_coarsest_level_that_each_allows():
    parts = [candidates((100, 0.0), (50, 0.2), (10, 0.9)), candidates((30, 0.0), (5, 0.4)), candidates((7, 0.0))]
    combined = combine_levels(parts)
    assert [indices for _, indices in combined] == [(0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 1, 0)]
    assert [(level.triangles, level.pixel_size) for level, _ in combined] == [(137, 0.0), (87, 0.2), (62, 0.4), (22, 0.9)]


def test_the_original_is_always_the_first_level():
    assert choose_levels(candidates((12, 0.0))) == [0]


@pytest.mark.parametrize(("triangles", "pixel_size", "expected"), [(500, 1.0, False), (501, 1.0, True), (500, 1.1, True)])
def test_a_cloud_is_needed_where_no_light_mesh_shows_a_small_object(triangles, pixel_size, expected):
    assert needs_cloud(candidates((9000, 0.0), (triangles, pixel_size)), side=8.0) is expected
