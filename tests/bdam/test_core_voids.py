"""Voids of a build: which are filled, by which heights, and which stay."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.building import height_grid, voids
from farfield.addon.core.bdam.building.height_grid import HeightGrid, encode_heights
from farfield.addon.core.bdam.building.heights import write_heights
from farfield.addon.core.bdam.building.voids import VoidCounts, count_voids, fill_small_voids
from farfield.addon.core.bdam.fields.terrain_field import open_field
from farfield.addon.core.jobs.progress import run_to_end
from tiff_writer import map_tags, write_tiff

SHAPE = 120, 160
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]]
PLANE = 300 * X - 170 * Y + 5000


def fill(folder, steps, is_known):
    """Return the heights and the known samples of a grid after its voids were filled, and their counts."""
    grid = HeightGrid(folder / "heights.raw", *steps.shape)
    encode_heights(steps, is_known).astype("<i4").tofile(grid.path)
    counts = run_to_end(fill_small_voids(grid, folder / "filled.raw"))
    assert run_to_end(count_voids(grid)) == VoidCounts(
        left=counts.filled + counts.left, left_samples=counts.filled_samples + counts.left_samples
    )
    filled = HeightGrid(folder / "filled.raw", *steps.shape)
    return *filled.read(slice(0, steps.shape[0]), slice(0, steps.shape[1])), counts


def test_voids_in_a_plane_get_the_plane(tmp_path):
    is_known = np.hypot(X - 60, Y - 50) > 30
    is_known[100:110, 20:140] = is_known[5, 5] = False
    filled, known, counts = fill(tmp_path, PLANE, is_known)
    assert known.all() and (filled == PLANE).all()
    assert counts == VoidCounts(3, int(np.count_nonzero(~is_known)), 0, 0)


def test_a_void_in_a_harmonic_function_gets_it_and_in_a_smooth_one_nearly(tmp_path):
    is_known = np.hypot(X - 80, Y - 60) > 20
    saddle = (X - 80) ** 2 - (Y - 60) ** 2
    filled, _, _ = fill(tmp_path, saddle, is_known)
    assert (filled == saddle).all()
    waves = np.rint(10_000 * np.sin(X / 60.0) * np.cos(Y / 50.0)).astype(np.int64)
    filled, _, _ = fill(tmp_path, waves, is_known)
    largest = (1 / 60**2 + 1 / 50**2) * 10_000 * 20**2 / 4  # error of a membrane: the Laplacian times a quarter of the squared radius
    assert 0 < np.abs(filled - waves).max() < 0.3 * largest


def test_a_single_known_sample_in_a_void_is_a_hill_and_no_spike(tmp_path):
    is_known = np.hypot(X - 80, Y - 60) > 20
    is_known[60, 80] = True
    peak = np.where((X == 80) & (Y == 60), 100_000, 0)
    filled, known, _ = fill(tmp_path, peak, is_known)
    assert known.all() and filled[60, 80] == 100_000 and filled.max() == 100_000
    assert filled[60, 81] > 95_000 and filled[60, 90] > 30_000  # a membrane has 66,078 and 15,365


def test_a_void_across_the_seam_of_two_files_is_one(tmp_path):
    heights = np.where(np.hypot(X - 80, Y - 60) < 25, np.nan, PLANE / 100.0).astype(np.float32)[::-1]
    paths = []
    for name, columns in (("west", slice(0, 81)), ("east", slice(80, 160))):
        tags = map_tags((10.0, 10.0), (500_000.0 + 10.0 * columns.start, 5_200_000.0))
        paths.append(write_tiff(tmp_path / f"{name}.tif", heights[:, columns], "deflate", tile=(32, 32), tags=tags))
    field = open_field(paths)
    run_to_end(write_heights(field, tmp_path / "heights.raw", 0.01))
    counts = run_to_end(fill_small_voids(HeightGrid(tmp_path / "heights.raw", *SHAPE), tmp_path / "filled.raw"))
    filled, known = HeightGrid(tmp_path / "filled.raw", *SHAPE).read(slice(0, SHAPE[0]), slice(0, SHAPE[1]))
    assert counts.filled == 1 and known.all() and np.abs(filled - PLANE).max() <= 1


@pytest.mark.parametrize(
    ("name", "is_unknown", "is_filled"),
    [
        ("200 by 200", (np.abs(np.arange(260) - 130) < 100)[:, None] & (np.abs(np.arange(300) - 150) < 100), True),
        ("large", (np.abs(np.arange(260) - 130) < 102)[:, None] & (np.abs(np.arange(300) - 150) < 102), False),
        ("bite", (np.arange(260) < 40)[:, None] & (np.abs(np.arange(300) - 150) < 40), True),
        ("strip along the border", (np.arange(260) < 4)[:, None] & (np.abs(np.arange(300) - 150) < 100), False),
        ("corner", np.add.outer(np.arange(260), np.arange(300)) < 30, False),
    ],
)
def test_large_voids_and_borders_of_the_data_stay(tmp_path, name, is_unknown, is_filled):
    steps = np.zeros(is_unknown.shape, np.int64)
    filled, known, counts = fill(tmp_path, steps, ~is_unknown)
    assert (counts.filled, counts.left) == ((1, 0) if is_filled else (0, 1)), name
    assert known.all() if is_filled else (known == ~is_unknown).all()
    assert (filled == 0).all()


def test_a_long_void_and_a_large_one_that_meet_only_at_corners_are_two(tmp_path):
    is_known = np.ones((300, 300), bool)
    is_known[20:260, 20:260] = is_known[260:262, 260:290] = False
    _, known, counts = fill(tmp_path, np.zeros((300, 300), np.int64), is_known)
    assert counts == VoidCounts(1, 60, 1, 240 * 240) and known[260:262].all()
    assert counts.describe(30.0) == "1 void filled, 1 left of 52 km²; Fill Holes can fill all."
    assert counts.all_filled().describe(30.0) == "2 voids filled." and VoidCounts().describe(30.0) == ""
    assert VoidCounts(12, 90, 2, 40).describe(10.0) == "12 voids filled, 2 left of 0.004 km² together; Fill Holes can fill all."


@settings(max_examples=25)
@given(st.integers(2, 50), st.integers(2, 50), st.integers(0, 2**31))
def test_any_voids_are_filled_alike_in_any_bands(tmp_path_factory, rows, columns, seed):
    random = np.random.default_rng(seed)
    steps = random.integers(-1000, 1000, (rows, columns))
    is_known = random.random((rows, columns)) < random.choice([0.3, 0.6, 0.98])
    results = []
    for samples in (height_grid.MAX_BAND_SAMPLES, 3 * columns, columns):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(height_grid, "MAX_BAND_SAMPLES", samples)
            patched.setattr(voids, "SOLVED_SAMPLES", 7 + samples % 11)
            patched.setattr(voids, "MAX_SAMPLES", 60)
            filled, known, counts = fill(tmp_path_factory.mktemp("grid"), steps, is_known)
        assert (filled[is_known] == steps[is_known]).all() and known[is_known].all()
        assert counts.filled_samples == np.count_nonzero(known & ~is_known) and counts.left_samples == np.count_nonzero(~known)
        results.append((filled, known, counts))
    for filled, known, counts in results[1:]:
        assert (filled == results[0][0]).all() and (known == results[0][1]).all() and counts == results[0][2]
