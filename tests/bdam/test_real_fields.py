"""Real elevation models become fields."""

import numpy as np
import pytest

from farfield.addon.core.bdam.fields.terrain_field import check_heights, open_field
from lib import environment

tifffile = pytest.importorskip("tifffile")
FOLDER = environment.ROOT.parent / "shared" / "data" / "dem"
pytestmark = pytest.mark.skipif(not (FOLDER / "N46E008.tif").exists(), reason="the elevation models in ../shared/data/dem are missing")


def test_neighbors_are_one_field():
    field = open_field([FOLDER / "N49W123.tif", FOLDER / "N49W124.tif"])
    assert field.shape == (1201, 2401) and field.height_step == 1.0
    assert field.frame.origin == (-123.0, 49.5)
    assert check_heights(field) == (), "common samples are equal"
    heights = field.read(slice(0, 1201), slice(0, 2401))
    for name, columns in (("N49W124", slice(0, 1201)), ("N49W123", slice(1200, 2401))):
        stored = tifffile.imread(FOLDER / f"{name}.tif")[::-1]
        assert np.array_equal(np.nan_to_num(heights[:, columns], nan=-32767.0), stored)
    x, y = field.frame.to_local(np.array([0.0, 2400.0]), np.array([600.0, 600.0]))
    assert x[1] - x[0] == pytest.approx(2.0 * 111_320.0 * np.cos(np.radians(49.5)), rel=3e-3)
    assert y[0] == pytest.approx(y[1])


def test_voids_are_unknown():
    field = open_field([FOLDER / "N46E008.tif"])
    heights = field.read(slice(0, 1201), slice(0, 1201))
    stored = tifffile.imread(FOLDER / "N46E008.tif")[::-1]
    assert np.array_equal(np.isnan(heights), stored == -32767) and np.isnan(heights).any()
    assert np.nanmin(heights) > 100.0 and np.nanmax(heights) < 4700.0
