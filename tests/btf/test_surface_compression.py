"""Two-sided texels, and the settings of the model *surface*."""

import numpy as np
import pytest

from farfield.addon.core.billboards.texels import QuadPolygons, texels_under_quads
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.btf.surface_compression import TwoSidedTexels


@pytest.fixture
def sides() -> TwoSidedTexels:
    """Two quads that face up, the second one of a solid; fronts are 1, backs are 0."""
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    uv = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    texels = texels_under_quads(QuadPolygons([square, square + 2.0], [uv, uv + [4.0, 0.0]]), (8, 4))
    count = len(texels)
    return TwoSidedTexels(texels, np.ones((count, 6)), np.zeros((count, 6)), np.ones(count), np.array([False, True]))


def test_each_viewer_sees_the_side_that_faces_it(sides):
    up, down = np.array([0.3, 0.2, 0.9]), np.array([0.3, 0.2, -0.9])
    assert sides.faces_viewer(up).all() and not sides.faces_viewer(down).any()
    assert (sides.colors(up) == 1.0).all() and (sides.colors(down) == 0.0).all()


def test_backs_of_solids_are_not_drawn(sides):
    is_solid = sides.texels.quad_indices == 1
    assert sides.is_drawn(np.array([0.0, 0.0, 1.0])).all()
    np.testing.assert_array_equal(sides.is_drawn(np.array([0.0, 0.0, -1.0])), ~is_solid)


def test_views_are_enough():
    settings = BtfSettings()
    assert not settings.bakes_emission and settings.images_per_view == 2
    assert settings.shadow_count == 0 and settings.shadow_grid is None
    assert BtfSettings(model="emission").images_per_view == 65
    assert settings.capture_fingerprint == BtfSettings(lights_per_side=3, shadows_per_side=4).capture_fingerprint
    assert settings.capture_fingerprint != BtfSettings(model="emission").capture_fingerprint
    BtfSettings(views_per_side=32, lights_per_side=32, components=64).check_table_size()
