"""Height maps of the terrain `heights` from TIFF files with every compression, and the size of their pixels."""

import numpy as np
import pytest

from farfield.addon.core.clipbox.files.readers import read_file
from farfield.addon.core.errors import FileError
from tiff_writer import AREA_KEYS, map_tags, write_tiff

pytest.importorskip("tifffile")

HEIGHTS = np.random.default_rng(4).normal(1000.0, 50.0, (30, 40)).astype(np.float32)


@pytest.mark.parametrize("compression", ["none", "deflate", "lzw", "packbits"])
def test_compressions_and_predictors(tmp_path, compression):
    for predictor in (1, 2, 3) if compression in {"deflate", "lzw"} else (1,):
        height_map = read_file(
            write_tiff(tmp_path / "map.tif", HEIGHTS, compression, predictor, (16, 16), tags=map_tags((5.0, 7.0), (0.0, 0.0)))
        )
        assert np.array_equal(height_map.heights, HEIGHTS[::-1]) and height_map.pixel_size == (5.0, 7.0)


def test_maps_that_are_turned(tmp_path):
    """Maps whose rows run to the north are the right way up, and rotated ones are refused, as by the other terrain tool."""
    matrices = {"south_up": (5.0, 0.0, 0.0, 7.0), "rotated": (4.0, 4.2, 3.0, -5.6), "mirrored": (-5.0, 0.0, 0.0, -7.0)}
    for name, (a, b, d, e) in matrices.items():
        path = write_tiff(tmp_path / f"{name}.tif", HEIGHTS, tags={34264: (12, (a, b, 0.0, 100.0, d, e, 0.0, 200.0, *(0.0,) * 7, 1.0))})
        if name == "south_up":
            height_map = read_file(path)
            assert np.array_equal(height_map.heights, HEIGHTS) and height_map.pixel_size == (5.0, 7.0)
        else:
            with pytest.raises(FileError, match=f"is {name} on the map"):
                read_file(path)


@pytest.mark.parametrize("keys", [AREA_KEYS, AREA_KEYS[:4] + AREA_KEYS[4:8]])
def test_degrees_become_meters_at_the_latitude_of_the_center(tmp_path, keys):
    tags = map_tags((0.01, 0.01), (8.0, 60.15), (1, 1, 0, (len(keys) - 4) // 4, *keys[4:]))
    width, depth = read_file(write_tiff(tmp_path / "map.tif", HEIGHTS, tags=tags)).pixel_size
    assert depth == pytest.approx(1113.2) and width == pytest.approx(1113.2 * 0.5, rel=1e-9)
