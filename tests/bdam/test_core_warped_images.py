"""Images in another projection than the elevation model lie where they belong."""

import numpy as np
import pytest
from PIL import Image

from farfield.addon.core.bdam.building.ground_images import open_image, place_images
from farfield.addon.core.bdam.building.warped_images import WarpedPixels
from farfield.addon.core.files.segment_cache import SegmentCache
from farfield.addon.core.geometry.placements import Placement
from farfield.addon.core.geometry.reprojection import find_projection, reproject
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from tiff_writer import AREA_KEYS, UTM_KEYS, map_tags, write_tiff

pytest.importorskip("tifffile")
CENTER = 8.2, 46.6  # longitude and latitude
MAPS = {  # keys of the file, placement of a field of about 4 km
    "degrees": (AREA_KEYS, Placement((CENTER[0] - 0.025, CENTER[1] - 0.018), (0.0005, 0.00036), True, "EPSG:4326")),
    "UTM": (UTM_KEYS, None),
    "next zone": (UTM_KEYS[:-5] + (32631, *UTM_KEYS[-4:]), None),
    "Web Mercator": (UTM_KEYS[:-5] + (3857, *UTM_KEYS[-4:]), None),
}
NEXT = dict(zip(MAPS, (*list(MAPS)[1:], "degrees"), strict=True))  # Each map is an image and a field; other pairs take the same paths.
WARPS = [
    pytest.param(image, field, marks=() if NEXT[image] == field else pytest.mark.exhaustive)
    for image in MAPS
    for field in MAPS
    if image != field
]
SHAPE = 101, 101


def placement(name):
    keys, known = MAPS[name]
    if known is not None:
        return known
    empty = Placement((0.0, 0.0), (1.0, 1.0), False, f"EPSG:{keys[-5]}")
    x, y = (float(number) for number in find_projection(empty).project(*CENTER))
    return Placement((x - 2000.0, y - 2000.0), (40.0, 40.0), False, empty.code)


def pattern(longitudes, latitudes):
    """Return colors (N, 3), 0 to 255, that tell longitude, latitude, and neither."""
    east, north = (np.asarray(longitudes) - CENTER[0]) / 0.06, (np.asarray(latitudes) - CENTER[1]) / 0.05
    return np.clip(np.stack([127.5 + 120.0 * east, 127.5 + 120.0 * north, np.full(east.shape, 90.0)], axis=-1), 0.0, 255.0)


def draw(name, size=400):
    """Return an image (size, size, 3) uint8 of `pattern` over a map somewhat smaller than the field, and its place."""
    placed = placement(name)
    step = placed.step[0] * 80 / size, placed.step[1] * 80 / size
    west, north = placed.position(10.0, 90.0)
    x, y = np.meshgrid(west + step[0] * (np.arange(size) + 0.5), north - step[1] * (np.arange(size) + 0.5))
    return np.round(pattern(*find_projection(placed).unproject(x, y))).astype(np.uint8), step, (west, north)


@pytest.mark.parametrize(("name", "field"), WARPS)
def test_pixels_are_where_they_belong(tmp_path, name, field):
    pixels, step, north_west = draw(name)
    path = write_tiff(tmp_path / "ground.tif", pixels, "deflate", tile=(64, 64), tags=map_tags(step, north_west, MAPS[name][0]))
    target = placement(field)
    (image,) = place_images([path], target, SHAPE)
    assert image.warnings == (f'"{path}" is warped from {placement(name).crs} to {target.crs}.',)
    placed = open_image(image, tmp_path, SegmentCache())
    assert isinstance(placed.source, WarpedPixels)
    rows, columns, _ = placed.source.shape
    window = placed.source.read(slice(0, rows), slice(0, columns))
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    x, y = placed.corner[0] + placed.step[0] * x, placed.corner[1] + placed.step[1] * y
    longitudes, latitudes = find_projection(target).unproject(target.first[0] + target.step[0] * x, target.first[1] + target.step[1] * y)
    u, v = find_projection(placement(name)).project(longitudes, latitudes)
    u, v = (u - north_west[0]) / step[0], (north_west[1] - v) / step[1]
    is_inside = (np.minimum(u, v) > 1.0) & (np.maximum(u, v) < 399.0)
    is_outside = (np.minimum(u, v) < -0.1) | (np.maximum(u, v) > 400.1)
    assert is_inside.mean() > 0.8 and (window[is_inside, 3] == 1.0).all() and (window[is_outside] == 0.0).all()
    expected = pattern(longitudes, latitudes)[is_inside]
    found = np.interp(window[is_inside, :3], LINEAR_OF_BYTE, np.arange(256))
    assert np.abs(found - expected).max() < 0.75  # half a step of 8 bits, and what bilinear interpolation in linear light adds
    sizes = [np.hypot(np.diff(u, axis=axis), np.diff(v, axis=axis)).max() for axis in range(2)]
    assert max(sizes) == pytest.approx(1.0, abs=0.01), "the resolution is that of the image"
    assert np.array_equal(placed.source.read(slice(70, 180), slice(33, 300)), window[70:180, 33:300])


def test_a_world_file_with_a_prj_file_is_warped_too(tmp_path):
    pixels, step, north_west = draw("degrees")
    Image.fromarray(pixels).save(tmp_path / "ground.png")
    numbers = step[0], 0.0, 0.0, -step[1], north_west[0] + 0.5 * step[0], north_west[1] - 0.5 * step[1]
    (tmp_path / "ground.pgw").write_text("\n".join(f"{number:.12f}" for number in numbers), encoding="ascii")
    (tmp_path / "ground.prj").write_text('GEOGCS["WGS 84",DATUM["WGS_1984"],UNIT["degree",0.0174532925199433]]', encoding="ascii")
    (image,) = place_images([tmp_path / "ground.png"], placement("UTM"), SHAPE)
    assert image.warp is not None
    longitude, latitude = (np.array(number) for number in (CENTER[0] + 0.004, CENTER[1] + 0.007))
    target = placement("UTM")
    x, y = reproject((longitude, latitude), find_projection(image.warp.image), find_projection(target), CENTER[0])
    on_image = image.warp.to_image((x - target.first[0]) / target.step[0], (y - target.first[1]) / target.step[1])
    south = north_west[1] - 400 * step[1]
    assert on_image == pytest.approx(((longitude - north_west[0]) / step[0], (latitude - south) / step[1]), abs=1e-3)


def test_images_of_the_same_projection_by_another_code_are_not_resampled(tmp_path):
    pixels, step, north_west = draw("UTM")
    path = write_tiff(tmp_path / "ground.tif", pixels, tags=map_tags(step, north_west, UTM_KEYS[:-5] + (25832, *UTM_KEYS[-4:])))
    (image,) = place_images([path], placement("UTM"), SHAPE)
    assert image.warp is None and image.corner == pytest.approx((10.0, 90.0))
