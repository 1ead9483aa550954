"""UV maps in which triangles share texels are found."""

import numpy as np
import pytest

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.photos.texels.pages import check_overlaps, find_overlapping
from photo_scenes import box, grid


@pytest.mark.parametrize("cells", [1, 4, 64, 100])
def test_neighbors_and_islands_do_not_overlap(cells):
    _, uvs = grid(cells)
    assert not find_overlapping(uvs).any()
    check_overlaps(box()[1])


def test_stacked_islands_are_found_and_others_are_not():
    _, uvs = grid(8)
    stacked = uvs.copy()
    stacked[:10] = uvs[20:30]
    found = find_overlapping(stacked)
    assert np.flatnonzero(found).tolist() == [*range(10), *range(20, 30)]
    with pytest.raises(GeometryError, match="overlaps itself: 20 triangles share texels"):
        check_overlaps(stacked)


def test_a_mirrored_triangle_counts_too():
    _, uvs = grid(2)
    stacked = uvs.copy()
    stacked[0] = uvs[3][::-1]
    assert np.flatnonzero(find_overlapping(stacked)).tolist() == [0, 3]


def test_few_shared_texels_are_no_overlap():
    _, uvs = grid(30)
    stacked = uvs.copy()
    stacked[0] = uvs[1000]
    assert not find_overlapping(stacked).any()


def test_degenerate_and_outer_triangles():
    _, uvs = grid(2)
    assert not find_overlapping(np.zeros((4, 3, 2))).any()
    assert not find_overlapping(uvs + 5.0).any()
