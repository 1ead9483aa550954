"""Copies of a block of voxels on hills: each where its cell says, turned, as large as it should be, and never far from its ground."""

from pathlib import Path

import numpy as np
import pytest

from farfield.addon.core.clipbox.forest import MEAN_CUBE, SMALLEST, Forest
from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains import terrain_of
from farfield.addon.core.clipbox.voxels import block_of
from farfield.addon.core.errors import FileError, SettingsError


def hook() -> np.ndarray:
    """A post with an arm towards x and a shorter one towards y: no turn or mirror image of it is itself."""
    solid = np.zeros((16, 16, 24), bool)
    solid[6:10, 6:10] = True
    solid[10:16, 6:10, 20:] = True
    solid[6:10, 10:13, 8:12] = True
    return solid


def standing(folder: Path, hills: float = 0.0, spacing: float = 48.0, seed: int = 3) -> Forest:
    """Hooks, the largest as high as 24 scene units, one a voxel."""
    np.save(folder / "hook.npy", hook())
    block = block_of(ClipboxSettings(terrain="forest", source=str(folder / "hook.npy"), source_size=24.0))
    return Forest(block, spacing, hills, seed)


def test_copies_stand_where_their_cells_say_turned_and_as_large_as_they_should(tmp_path):
    forest = standing(tmp_path)
    grid = Grid((-96, -96, 0), (192, 192, 30), 1.0)
    copies = forest.copies_about(grid)
    found = forest.densities(grid) > 0
    seen = set()
    for foot, size, turned, signs in zip(copies.feet, copies.sizes, copies.turned, copies.signs, strict=True):
        assert SMALLEST <= size <= 1.0 and foot[2] == 0.0
        if np.abs(foot[:2]).max() > 80.0:
            continue
        seen.add((bool(turned), *signs.tolist()))
        for x, y, z, solid in ((0.0, 0.0, 12.0, True), (5.0, 0.0, 22.0, True), (-5.0, 0.0, 22.0, False), (0.0, 3.5, 10.0, True)):
            local = np.array([x, y]) * signs
            across = local[::-1] if turned else local
            at = np.floor(foot + size * np.array([*across, z])).astype(int) - grid.origin
            assert found[tuple(at)] == solid, (foot, size, turned, signs, x, y, z)
    assert len(seen) >= 4


def test_they_have_their_volume_and_nothing_floats_between(tmp_path):
    forest = standing(tmp_path)
    grid = Grid((-240, -240, 0), (480, 480, 26), 1.0)  # ten cells each way
    solid = int((forest.densities(grid) > 0).sum())
    expected = 100 * hook().sum() * MEAN_CUBE
    assert solid == pytest.approx(expected, rel=0.15)
    assert not (standing(tmp_path, spacing=2000.0).densities(Grid((20, 20, 1), (300, 300, 25), 1.0)) > 0).any()


def test_they_stand_on_the_hills(tmp_path):
    forest = standing(tmp_path, hills=20.0)
    grid = Grid((-96, -96, -30), (192, 192, 90), 1.0)
    found = forest.densities(grid)
    x, y, _ = grid.axes()
    ground = forest.heights(x[:, :, 0], y[:, :, 0])
    assert np.ptp(ground) > 6.0 and np.abs(ground).max() <= 20.0 * (0.5 + 0.25 + 0.125)
    tops = grid.origin[2] + 90 - (found > 0)[:, :, ::-1].argmax(axis=2)
    assert (tops >= ground - 1.0).all() and (tops <= ground + 24.0 + 8.0).all()
    copies = forest.copies_about(grid)
    for foot, size in zip(copies.feet, copies.sizes, strict=True):
        if np.abs(foot[:2]).max() < 90.0:
            i, j = np.floor(foot[:2]).astype(int) + 96
            assert tops[i, j] == pytest.approx(foot[2] + 24.0 * size, abs=1.6)


def test_where_voxels_are_too_large_for_copies_the_ground_is_higher(tmp_path):
    forest = standing(tmp_path, spacing=24.0)
    coarse = forest.densities(Grid((-4, -4, -4), (8, 8, 8), 16.0))
    _, _, z = Grid((-4, -4, -4), (8, 8, 8), 16.0).axes()
    seen_from_above = hook().any(axis=2).sum() * 24.0 - 12 * (24.0 - 12.0)  # the lower arm ends at half the height
    assert np.allclose(coarse + z, MEAN_CUBE * seen_from_above / 24.0**2, atol=1e-3)


def test_what_is_thin_stays_where_it_is_averaged(tmp_path):
    """A lattice of rods fills an eighth of its block: averages are below the threshold everywhere."""
    rods = np.zeros((32, 32, 32), np.uint8)
    for axis in range(3):
        np.moveaxis(rods, axis, 0)[:, 3::8, 3::8] = 200
    np.save(tmp_path / "rods.npy", rods)
    settings = ClipboxSettings(terrain="volume", source=str(tmp_path / "rods.npy"), source_size=32.0)
    function = terrain_of(settings).function
    fine = function(Grid((-20, -20, -4), (40, 40, 40), 1.0)) > 0
    coarse = function(Grid((-5, -5, -1), (10, 10, 10), 4.0)) > 0
    for axis in range(3):
        assert 16 * coarse.any(axis=axis).sum() == pytest.approx(fine.any(axis=axis).sum(), rel=0.5)


def test_another_seed_is_another_forest_and_the_same_one_the_same(tmp_path):
    grid = Grid((-40, -40, -2), (80, 80, 20), 1.5)
    first, again, other = (standing(tmp_path, hills=5.0, seed=seed).densities(grid) for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_it_needs_a_file_with_voxels(tmp_path):
    with pytest.raises(SettingsError, match='The terrain "forest" needs a file'):
        terrain_of(ClipboxSettings(terrain="forest"))
    np.save(tmp_path / "map.npy", np.ones((4, 4)))
    with pytest.raises(FileError, match="holds heights, not voxels"):
        terrain_of(ClipboxSettings(terrain="forest", source=str(tmp_path / "map.npy")))
