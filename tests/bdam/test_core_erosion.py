"""Erosion of terrains: water finds its way out, rivers only lower, sliding ground keeps its mass, and tiles meet without seams."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.building import erosion, erosion_steps
from farfield.addon.core.bdam.building.drainage import find_drainage
from farfield.addon.core.bdam.building.erosion_steps import HALO, deposit, erode, erode_window, slide
from farfield.addon.core.bdam.building.height_grid import HeightGrid, encode_heights
from farfield.addon.core.bdam.building.terrain_build import EROSION_END, READ_END, build_terrain
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import ArrayField, hills

ROWS, COLUMNS = 230, 301
VOID = slice(60, 90), slice(100, 160)


def rough_hills(rows=ROWS, columns=COLUMNS, has_void=True):
    heights = (20.0 * hills(rows, columns)).astype(np.float32)
    if has_void:
        heights[VOID] = np.nan
    return heights


def count_pits(heights):
    """The number of samples inside of a grid that are lower than all eight neighbors."""
    center = heights[1:-1, 1:-1]
    rows, columns = center.shape
    around = [heights[i : i + rows, j : j + columns] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    return int((center < np.min(around, axis=0)).sum())


def measure_concavity(heights):
    """The power of the drained area by which gradients of rivers fall."""
    drainage = find_drainage(heights, 0)
    areas, flat = drainage.accumulate(), heights.reshape(-1)
    gradients = (flat - flat[drainage.receivers]) / drainage.lengths
    edges = 2.0 ** np.arange(4, 12)
    means = [gradients[(areas >= low) & (areas < 2.0 * low) & (gradients > 0.0)].mean() for low in edges]
    return -np.polyfit(np.log(edges), np.log(means), 1)[0]


def read_files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_water_on_a_plane_flows_straight_down():
    plane = np.tile(np.arange(12, dtype=np.float32), (5, 1))
    areas = find_drainage(plane, 1).accumulate().reshape(plane.shape)
    assert (areas[:, 1:] == 12 - np.arange(1, 12)).all()
    assert areas[:, 0].max() == plane.size  # The lowest edge is one flat with one outlet.


def test_a_lake_is_one_basin_however_many_samples_it_has():
    lake = np.full((40, 50), 3.0, np.float32)
    lake[5:-5, 5:-5] = 1.0
    lake[20, :5] = 2.0
    drainage = find_drainage(lake, 1)
    assert drainage.accumulate()[20 * 50] == lake.size
    assert (np.diff(drainage.starts) > 0).all() and len(drainage.starts) < 100  # Flow crosses it on short paths.


def test_all_water_of_a_bowl_leaves_through_its_lowest_border_sample():
    bowl = np.full((9, 11), 10.0, np.float32)
    bowl[1:-1, 1:-1] = 0.0
    bowl[4, 10] = 5.0
    drainage = find_drainage(bowl, 1)
    assert drainage.accumulate().reshape(bowl.shape)[4, 10] == bowl.size
    assert drainage.receivers[4 * 11 + 10] == 4 * 11 + 10


@settings(max_examples=30)
@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 2**31))
def test_all_water_reaches_the_border_of_the_known_samples(rows, columns, seed):
    random = np.random.default_rng(seed)
    heights = random.integers(0, random.choice([2, 1000]), (rows, columns)).astype(np.float32)
    heights[random.random(heights.shape) < random.choice([0.0, 0.05])] = np.nan
    drainage = find_drainage(heights, seed)
    areas, known = drainage.accumulate(), ~np.isnan(heights).reshape(-1)
    is_outlet = known & (drainage.receivers == np.arange(heights.size))
    assert areas[is_outlet].sum() == known.sum()
    padded = np.pad(heights, 1, constant_values=np.nan)
    for row, column in zip(*np.divmod(np.flatnonzero(is_outlet), columns), strict=True):
        assert np.isnan(padded[row : row + 3, column : column + 3]).any()


def test_rivers_only_lower_the_ground_and_dig_no_pits(monkeypatch):
    monkeypatch.setattr(erosion_steps, "SLIDES", 0)
    monkeypatch.setattr(erosion_steps, "FLOOR_ROUNDS", 0)
    y, x = np.mgrid[-1:1:81j, -1:1:81j]
    cone = (1000.0 - 700.0 * np.hypot(x, y + 0.1)).astype(np.float32)
    eroded, areas = erode(cone, 100.0, 0.3, 1)
    assert (eroded <= cone).all() and (cone - eroded).max() > 20.0
    assert count_pits(eroded) == 0
    assert areas.max() < cone.size and eroded.max() == cone.max()


def test_sliding_ground_keeps_its_mass_and_comes_to_rest_below_the_angle_of_repose(monkeypatch):
    monkeypatch.setattr(erosion_steps, "CREEP_RATE", 0.0)
    pile = np.zeros((41, 51), np.float32)
    pile[15:25, 20:30] = 30.0
    slid = slide(pile, 1.5, 2000)
    assert slid.sum(dtype=np.float64) == pytest.approx(pile.sum(), rel=1e-5)
    assert max(np.abs(np.diff(slid, axis=axis)).max() for axis in (0, 1)) < 1.5 * 1.01
    assert np.abs(slid[1:, 1:] - slid[:-1, :-1]).max() < 1.5 * 2**0.5 * 1.01
    gentle = pile / 25.0
    assert np.array_equal(slide(gentle, 1.5, 10), gentle)


def test_rivers_get_less_steep_downstream():
    """Real rivers have gradients that fall with a power of about 0.3 of their area; those of a fractal do not depend on it."""
    heights = rough_hills(has_void=False)
    eroded, _ = erode(heights, 8.0, 0.3, 1)
    assert measure_concavity(heights) < 0.2
    assert 0.3 < measure_concavity(eroded) < 0.6
    assert count_pits(eroded) < 0.5 * count_pits(heights)


def test_windows_do_not_depend_on_what_lies_beyond_the_halo():
    heights, inherited = rough_hills(), np.random.default_rng(1).uniform(4.0, 2000.0, (ROWS // 2, (COLUMNS + 1) // 2)).astype(np.float32)
    complete = erode_window(heights, inherited, (0, 0), 8.0, 0.3, 2)
    top, left = 20, 70
    part = erode_window(heights[top:, left:], inherited[top // 2 :, left // 2 :], (top, left), 8.0, 0.3, 2)
    for values, expected in zip(part, complete, strict=True):
        assert np.array_equal(values[HALO:, HALO:], expected[top + HALO :, left + HALO :], equal_nan=True)
    assert np.array_equal(np.isnan(complete[0]), np.isnan(heights))


def test_tiles_meet_without_seams_and_voids_stay(tmp_path, monkeypatch):
    steps = np.nan_to_num(100.0 * rough_hills()).astype(np.int32)
    is_known = ~np.isnan(rough_hills())
    encode_heights(steps, is_known).astype("<i4").tofile(tmp_path / "source.raw")
    source = HeightGrid(tmp_path / "source.raw", ROWS, COLUMNS)
    monkeypatch.setattr(erosion, "MAX_COMPLETE", 5000)
    results = []
    for tile in (1024, 64, 96):
        monkeypatch.setattr(erosion, "TILE", tile)
        run_to_end(erosion.erode_heights(source, tmp_path / "eroded.raw", 1000.0, 1.0))
        assert sorted(path.name for path in tmp_path.iterdir()) == ["eroded.raw", "source.raw"]
        results.append((tmp_path / "eroded.raw").read_bytes())
    assert results[0] == results[1] == results[2]
    eroded, is_still_known = HeightGrid(tmp_path / "eroded.raw", ROWS, COLUMNS).read(slice(0, ROWS), slice(0, COLUMNS))
    assert np.array_equal(is_still_known, is_known) and np.array_equal(eroded[~is_known], steps[~is_known])
    assert (eroded != steps)[is_known].mean() > 0.9


def erode_steps(steps, folder):
    """Heights (H, W) int32 in steps after erosion."""
    source, out = (HeightGrid(folder / name, *steps.shape) for name in ("source.raw", "eroded.raw"))
    encode_heights(steps, np.ones(steps.shape, bool)).astype("<i4").tofile(source.path)
    run_to_end(erosion.erode_heights(source, out.path, 100.0, 1.0))
    return out.read(slice(0, steps.shape[0]), slice(0, steps.shape[1]))[0]


@pytest.mark.parametrize(("sea", "floor"), [(0, -300), (0, 0), (700, 700)])
@pytest.mark.parametrize("max_complete", [pytest.param(1_000_000, marks=pytest.mark.exhaustive), 5000])
def test_the_sea_keeps_its_heights_exactly(tmp_path, monkeypatch, sea, floor, max_complete):
    monkeypatch.setattr(erosion, "MAX_COMPLETE", max_complete)
    monkeypatch.setattr(erosion, "TILE", 96)
    ground = 20.0 * hills(ROWS, COLUMNS)
    ground = np.maximum(100.0 * (ground - np.quantile(ground, 0.4)) + sea, sea).astype(np.int32)
    ground[:, 200:] += 4000  # a coast that is steeper than any ground rests
    ground[:, 190:200] = sea
    ground[5:9, 192:196] = floor
    eroded = erode_steps(ground, tmp_path)
    assert np.array_equal(eroded[ground <= sea], ground[ground <= sea])
    assert (eroded != ground)[ground > sea].mean() > 0.8 and eroded[ground > sea].min() >= sea


def test_ground_without_a_sea_has_none(tmp_path):
    ground = (100.0 * rough_hills(has_void=False)).astype(np.int32)
    grid = HeightGrid(tmp_path / "grid.raw", *ground.shape)
    encode_heights(ground, np.ones(ground.shape, bool)).astype("<i4").tofile(grid.path)
    assert erosion.find_sea_level(grid) == -np.inf


def test_rivers_fill_the_bottom_of_their_valleys_only():
    y, x = np.mgrid[0:80, -40:41].astype(np.float32)
    valley = 6.0 * np.abs(x) + 0.2 * y
    areas = np.where(x == 0, 1e5, 1.0)
    filled = deposit(valley, areas.ravel(), 8.0)
    inner = slice(30, 50)
    assert np.array_equal(filled[inner][:, np.abs(x[0]) > 20], valley[inner][:, np.abs(x[0]) > 20])
    assert np.abs(np.diff(filled[inner, 39:42])).max() < 3.0 and (filled[inner, 40] > valley[inner, 40] + 3.0).all()
    assert np.array_equal(deposit(valley, np.ones(valley.size), 8.0)[inner, 40] > valley[inner, 40] + 0.1, np.zeros(20, bool))


def build_steps(out, **options):
    field = ArrayField(rough_hills(97, 129, has_void=False), height_step=1.0)
    return build_terrain(field, [], out, BdamSettings(**{"patch_size": "16", "executor": "serial", "erosion": 1.0} | options))


@pytest.mark.slow
def test_builds_with_erosion_have_the_same_bytes_however_they_run(tmp_path, monkeypatch):
    monkeypatch.setattr(erosion, "MAX_COMPLETE", 3000)
    monkeypatch.setattr(erosion, "TILE", 64)
    report = run_to_end(build_steps(tmp_path / "store"))
    assert report.seconds["erosion"] > 0.0
    files = read_files(tmp_path / "store")
    run_to_end(build_steps(tmp_path / "processes", executor="processes:2"))
    assert read_files(tmp_path / "processes") == files
    for fraction in (0.5 * READ_END, 0.5 * (READ_END + EROSION_END), EROSION_END, 0.6):
        out = tmp_path / f"{fraction:g}"
        steps = build_steps(out)
        while next(steps).fraction < fraction:
            pass
        steps.close()
        assert not out.exists()
        run_to_end(build_steps(out))
        assert read_files(out) == files
    run_to_end(build_steps(tmp_path / "plain", erosion=0.0))
    assert read_files(tmp_path / "plain") != files
    with TerrainStore(tmp_path / "store") as eroded, TerrainStore(tmp_path / "plain") as plain:
        assert eroded.header.height_step < plain.header.height_step == 1.0
        assert eroded.height_range[1] <= plain.height_range[1] + 1.0
