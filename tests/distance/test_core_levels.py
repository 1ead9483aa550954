"""Which candidates become levels."""

import numpy as np
import pytest

from farfield.addon.core.distance import LevelCandidate, choose_levels, choose_vanishing, combine_levels, is_light


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


@pytest.mark.parametrize(
    ("triangles", "pixel_size", "places", "expected"),
    [
        (10_000, 1.0, 2, True),
        (10_001, 1.0, 2, False),
        (10_000, 1.1, 2, False),
        (2_500, 1.0, 40, True),
        (2_500, 1.0, 41, False),
        (2_501, 1.0, 8, False),
    ],
)
def test_an_object_is_light_by_what_all_its_places_show_where_it_is_small(triangles, pixel_size, places, expected):
    assert is_light(candidates((4 * 2_500 + 1, 0.0), (triangles, pixel_size)), side=32.0, places=places) is expected


def test_small_parts_vanish_as_long_as_they_are_few():
    sizes = np.array([[10.0, 10.0, 10.0], [1.0, 1.0, 1.0], [0.5, 0.5, 0.5], [1.0, 1.0, 4.0]])
    assert choose_vanishing(sizes).tolist() == [False, True, True, True]
    assert not choose_vanishing(np.ones((10, 3))).any(), "a fence of posts does not vanish one after the other"
    assert not choose_vanishing(np.ones((1, 3))).any()


def test_a_level_of_opaque_pieces_is_cheaper_than_fewer_transparent_triangles():
    cards, pieces = LevelCandidate(1000, 0.0, transparent=600), LevelCandidate(1500, 1.0)
    assert choose_levels([cards, pieces]) == [0, 1] and choose_levels([LevelCandidate(1000, 0.0), pieces]) == [0]
    (fine, _), (coarse, _) = combine_levels([[cards, pieces], [LevelCandidate(10, 0.0)]])
    assert (fine.triangles, fine.transparent, coarse.triangles, coarse.transparent) == (1010, 600, 1510, 0)
